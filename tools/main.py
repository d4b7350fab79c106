"""The program ``cogsplat``: its commands."""

from __future__ import annotations

import sys
from typing import Final

import click

import cogsplat
from cogsplat.formats.cogs import layout
from cogsplat.tools.terminal.command_line import CommandLine

# Longest time that a Python thread holds the interpreter while another waits for it, s. Our
# threads need it only between compiled kernels that take 3 ms. With Python's default of 5 ms, two
# threads took as long as one to measure gains.
_SWITCH_SECONDS: Final = 0.0003

# Module and attribute of each command, below `cogsplat.tools`. Only `demo` and `lab` may name
# modules of the lab.
_MODULES: Final = {
    "encode": "cli.encode.encode",
    "split": "cli.split.split",
    "batch": "cli.batch.batch",
    "tune": "cli.tune.tune",
    "layers": "cli.layers.layers",
    "decode": "cli.decode.decode",
    "convert": "cli.convert.convert",
    "merge": "cli.merge.merge",
    "filter": "cli.filter.filter_scene",
    "view": "cli.view.view",
    "export-html": "cli.export_html.export_html",
    "serve": "cli.serve.serve",
    "upload": "cli.upload.upload",
    "info": "cli.info.info",
    "describe": "cli.describe.describe",
    "check": "cli.check.check",
    "compare": "cli.compare.compare",
    "render": "cli.render.render",
    "demo": "lab.cli.demo.demo",
    "lab": "lab.cli.lab.lab",
}


@click.group(
    cls=CommandLine,
    modules={name: f"{__package__}.{place}" for name, place in _MODULES.items()},
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="\b\nExample:\n"
    "  cogsplat demo\n\n"
    "A scene called - is read from standard input, an output called - is written to standard "
    "output.\n\n"
    "Exit status: 0 done, 2 misuse, 3 invalid data, 4 input or output failed or an extra is not "
    "installed, 5 a limit was exceeded, 130 interrupted. A command that fails leaves no "
    "half-written file.",
)
@click.version_option(
    cogsplat.__version__,
    message=f"cogsplat %(version)s, COGS {layout.MAJOR}.{layout.MINOR}",
)
def cli() -> None:
    """Turn 3D Gaussian splatting scenes into progressive COGS files and back."""


def main() -> None:
    """Run the command line."""
    sys.setswitchinterval(_SWITCH_SECONDS)
    cli(prog_name="cogsplat")


if __name__ == "__main__":
    main()
