"""``cogsplat view``: a scene in the browser."""

from __future__ import annotations

import threading
import webbrowser
from contextlib import ExitStack
from pathlib import Path

import click

from cogsplat.tools.delivery.local_server import SceneServer
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option, threads_option
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    display_title,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.standard_streams import INPUT
from cogsplat.tools.workflow.viewable import drawable

_LARGEST_PORT = 65535


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat view scene.cogs\n"
    "  cogsplat view scene.cogs --against scene.ply\n"
    "  cogsplat view scene.ply --no-open --port 8080"
)
@click.argument("scene", type=INPUT, metavar="SCENE")
@click.option(
    "--against",
    type=INPUT,
    metavar="OTHER",
    help="Compare with another scene of any format, side by side at a movable line.",
)
@click.option(
    "--port",
    type=click.IntRange(0, _LARGEST_PORT),
    default=0,
    metavar="N",
    help="Port to listen on, 0 (default) for any free port.",
)
@click.option("--no-open", is_flag=True, help="Print the address without opening a browser.")
@partial_option
@limits_option
@threads_option
@quiet_option
@json_option
def view(
    scene: Path,
    against: Path | None,
    port: int,
    no_open: bool,
    threads: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Show a scene in the browser.

    A server on 127.0.0.1 serves the viewer and the scene to browsers of this machine until Ctrl-C.
    Scenes of other formats than COGS are not encoded.

    At most 640 connections are open, fewer where ulimit -n is below 704.
    """
    shown = not (quiet or as_json)
    with ExitStack() as open_things:
        given = open_things.enter_context(drawable(scene, threads=threads, shown=shown))
        other = other_title = None
        if against is not None:
            drawn = drawable(against, threads=threads, shown=shown)
            other, other_title = open_things.enter_context(drawn).path, display_title(against)
        server = open_things.enter_context(
            SceneServer(
                given.path, display_title(scene), port, against=other, against_title=other_title
            )
        )
        if as_json:
            print_json({"url": server.url, "source": display_name(scene), "splats": given.splats})
        elif quiet:
            print_line(server.url)
        else:
            print_line(f"{scene}: {count_text(given.splats, 'splat')} at {server.url}")
            print_line("Ctrl-C stops the server")
        if not no_open:
            # A text browser in the terminal returns only when it is closed.
            threading.Thread(target=webbrowser.open, args=[server.url], daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            # Ctrl-C is the regular end of the server.
            return
