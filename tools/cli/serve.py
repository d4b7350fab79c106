"""``cogsplat serve``: an HTTP server for scenes, with an adjustable link."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import click

from cogsplat.codec.errors import StorageError
from cogsplat.formats.scenes.registry import is_cogs
from cogsplat.formats.storage.atomic import exists, is_file
from cogsplat.tools.delivery.file_app import FileApp
from cogsplat.tools.delivery.file_server import Certificate, FileServer
from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink
from cogsplat.tools.delivery.threaded_server import HOST
from cogsplat.tools.delivery.viewer_pages import linked_page, relative_url
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import display_title, print_json, print_line
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber

_LARGEST_PORT: Final = 65535

_RATE: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([kmg]?)(?:bit/s|bps|bit)?", re.IGNORECASE)
_THOUSANDS: Final = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}


class BitRate(click.ParamType["float"]):
    """Parameter type of a bit rate, such as ``10M``, ``500k`` or ``10Mbit/s``."""

    name = "rate"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the rate in bits per second."""
        match = _RATE.fullmatch(str(value).strip())
        rate = float(match[1]) * _THOUSANDS[match[2].lower()] if match else 0.0
        if not rate:
            self.fail(f"{value!r}, expected bits a second such as 10M or 500k", param, ctx)
        return rate


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat serve scene.cogs --throttle 10M --latency 50\n"
    "  cogsplat serve public --port 8080 --fail-rate 0.1"
)
@click.argument("path", type=PATH, metavar="PATH")
@click.option(
    "--port",
    type=click.IntRange(0, _LARGEST_PORT),
    default=0,
    metavar="N",
    help="Port to listen on, 0 (default) for any free port.",
)
@click.option(
    "--host",
    default=HOST,
    show_default=True,
    metavar="ADDRESS",
    help="Address to listen on; 0.0.0.0 accepts other machines.",
)
@click.option(
    "--certificate",
    nargs=2,
    type=PATH,
    metavar="CERT.pem KEY.pem",
    help="Certificate and key for HTTPS with HTTP/2.",
)
@click.option(
    "--throttle",
    type=BitRate(),
    metavar="BITS",
    help="Bandwidth of all answers, bits per second, such as 10M.",
)
@click.option(
    "--latency",
    type=FiniteNumber(0, 60_000),
    default=0.0,
    metavar="MS",
    help="Time from a request to the first byte of its answer, milliseconds.",
)
@click.option(
    "--loss",
    type=FiniteNumber(0, 1),
    default=0.0,
    metavar="SHARE",
    help="Share of the answers that end early.",
)
@click.option(
    "--fail-rate",
    type=FiniteNumber(0, 1),
    default=0.0,
    metavar="SHARE",
    help="Share of the requests answered with status 503.",
)
@click.option("--seed", type=int, default=0, metavar="N", help="Seed of --loss and --fail-rate.")
@quiet_option
@json_option
def serve(
    path: Path,
    port: int,
    host: str,
    certificate: tuple[Path, Path] | None,
    throttle: float | None,
    latency: float,
    loss: float,
    fail_rate: float,
    seed: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Serve a file or a folder over HTTP.

    Answers have byte ranges, ETags, and CORS headers for all origins. The address of a .cogs file
    is a page that shows it. All files of a folder are served except names that begin with a dot.
    --throttle, --latency, --loss and --fail-rate simulate a slow or faulty link. Ctrl-C stops the
    server. Needs the extra serve.

    At most 640 connections are open, 150 with --certificate, fewer where ulimit -n is below 704.
    Peers that send no request and read nothing are disconnected after 60 s, or after 5 s while
    others wait.
    """
    if not exists(path):
        raise StorageError("not-found", f"{path}: is not there, expected a file or a folder")
    pages = {}
    if is_file(path) and is_cogs(path):
        pages = linked_page(display_title(path), path.name)
    quality = LinkQuality(throttle, latency / 1000, loss, fail_rate, seed)
    app = FileApp(path, ShapedLink(quality), pages)
    server = FileServer(app, port, host, None if certificate is None else Certificate(*certificate))
    scene = server.url + (relative_url(path.name) if is_file(path) else "")
    url = server.url if pages else scene
    try:
        if as_json:
            print_json({"url": url, "source": str(path), "scene_url": scene})
        elif quiet:
            print_line(url)
        else:
            print_line(f"{path}: {url}" + (f" shows {scene}" if pages else ""))
            print_line("Ctrl-C stops the server")
        server.serve_forever()
    except KeyboardInterrupt:
        # Ctrl-C is the regular end of the server.
        return
    finally:
        server.close()
