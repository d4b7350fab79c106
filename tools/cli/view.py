"""``cogsplat view``: a scene in the browser."""

from __future__ import annotations

import threading
import webbrowser
from pathlib import Path

import click

from cogsplat.tools.delivery.local_server import SceneServer
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.options import PATH, json_option, quiet_option, threads_option
from cogsplat.tools.terminal.output import counted, name_of, say, say_json
from cogsplat.tools.terminal.partial import partial_option

from .viewable import viewable

_LARGEST_PORT = 65535


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat view scene.cogs\n"
    "  cogsplat view scene.ply --no-open --port 8080"
)
@click.argument("scene", type=PATH, metavar="SCENE")
@click.option(
    "--port",
    type=click.IntRange(0, _LARGEST_PORT),
    default=0,
    metavar="N",
    help="Port to listen on; 0 (default) takes a free one.",
)
@click.option("--no-open", is_flag=True, help="Print the address only; open no browser.")
@partial_option
@limits_option
@threads_option
@quiet_option
@json_option
def view(scene: Path, port: int, no_open: bool, threads: int, quiet: bool, as_json: bool) -> None:
    """Show a scene in the browser.

    A server on 127.0.0.1 gives the viewer and the scene, and nothing else, to browsers of this
    machine until Ctrl-C. A scene that is no .cogs is encoded first, into a temporary file.
    """
    shown = not (quiet or as_json)
    with (
        viewable(scene, threads=threads, shown=shown) as given,
        SceneServer(given.path, scene.name, port) as server,
    ):
        if as_json:
            say_json({"url": server.url, "scene": name_of(scene), "splats": given.splats})
        elif quiet:
            say(server.url)
        else:
            say(f"{scene}: {counted(given.splats, 'splat')} at {server.url}")
            say("Ctrl-C stops the server")
        if not no_open:
            # Some browsers of terminals return only when they are left.
            threading.Thread(target=webbrowser.open, args=[server.url], daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            # The way to stop it, not an interrupted piece of work.
            return
