"""``cogsplat join``: the files of neighbouring parts of a scene as one, without decoding."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

import cogsplat
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import force_option, json_option, quiet_option
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.output_files import check_outputs


@click.command(epilog="\b\nExample:\n  cogsplat join parts/*.cogs city.cogs")
@click.argument("parts", type=INPUT, nargs=-1, required=True, metavar="A.cogs B.cogs…")
@click.argument("out", type=OutputPath(".cogs"), metavar="OUT.cogs")
@limits_option
@force_option
@quiet_option
@json_option
def join(parts: Sequence[Path], out: Path, force: bool, quiet: bool, as_json: bool) -> None:
    """Join COGS files of neighbouring parts of a scene into one, without decoding.

    `cogsplat split` makes such parts, `cogsplat batch` encodes them. Parts have the same SH degree,
    axes, origin, attributes and codebooks: encode all but one with --codebooks-of. To replace a
    part, encode it again, and join all again. First view, direction against gravity and description
    are those of the first file; `cogsplat describe` changes them.
    """
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        made = cogsplat.join(parts, out, force=force, limits=current_limits(), progress=stages)
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "bytes": made.size_bytes,
                "parts": [display_name(part) for part in parts],
                "splats": made.splats,
                "chunks": made.chunks,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{out}: {size_text(made.size_bytes)}, {count_text(made.parts, 'part')}")
        print_facts(
            ("splats", f"{made.splats:,}"),
            ("chunks", f"{made.chunks:,}"),
            ("time", stages.summary()),
        )
