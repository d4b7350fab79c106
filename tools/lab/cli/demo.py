"""``cogsplat demo``: a synthetic scene encoded, and its prefixes decoded and measured."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from cogsplat.codec.compiling import kernels_in
from cogsplat.codec.streams.decoding_tiers import KERNEL_MODULES
from cogsplat.codec.threads import thread_count
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    print_table,
    size_text,
)
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import WRITTEN_PATH
from cogsplat.tools.workflow.compile_ahead import CompileAhead

from .synth import MOST_SPLATS

# Enough for every object to be whole. On two cores the demonstration took 50 s at a first run,
# which compiles kernels, and up to 135 s on a busy machine.
_DEMO_SPLATS: Final = 60_000


@click.command(epilog="\b\nExample:\n  cogsplat demo --out demo --force")
@click.option(
    "--out",
    type=WRITTEN_PATH,
    default="demo",
    show_default=True,
    metavar="DIR",
    help="Folder for the files.",
)
@click.option(
    "--splats",
    type=click.IntRange(1000, MOST_SPLATS),
    default=_DEMO_SPLATS,
    show_default=True,
    metavar="N",
    help="Splats of the scene.",
)
@threads_option
@force_option
@quiet_option
@json_option
def demo(out: Path, splats: int, threads: int, force: bool, quiet: bool, as_json: bool) -> None:
    """Encode a synthetic scene and compare its prefixes.

    The first 3, 6, 12, 25 and 100 % of the bytes are decoded, compared with the original and drawn
    as a film strip.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.needed_kernels import needed_kernels

    from . import demonstration

    kernels = needed_kernels(EncodeConfig()) + kernels_in(KERNEL_MODULES)
    with (
        Stages(shown=not (quiet or as_json)) as stages,
        CompileAhead(kernels, thread_count(threads)) as ahead,
    ):
        stages.plan(demonstration.stage_costs(splats))
        made = demonstration.run(
            out,
            splats=splats,
            threads=threads,
            force=force,
            before_encoding=ahead.finish,
            progress=stages,
        )
    files = made.files
    if as_json:
        print_json(
            {
                "splats": made.splats,
                "scene": display_name(files.scene),
                "scene_bytes": made.scene_bytes,
                "cameras": display_name(files.cameras),
                "cogs": display_name(files.cogs),
                "cogs_bytes": made.cogs_bytes,
                "decoded": display_name(files.decoded),
                "filmstrip": display_name(files.strip),
                "prefixes": [
                    {
                        "share": prefix.share,
                        "bytes": prefix.size_bytes,
                        "splats": prefix.splats,
                        "held_out_db": prefix.held_out_db,
                        "worst_db": prefix.worst_db,
                        "roam_db": prefix.roam_db,
                    }
                    for prefix in made.prefixes
                ],
                "seconds": stages.rounded_seconds(),
                "cpu_seconds": stages.rounded_cpu_seconds(),
            }
        )
        return
    if quiet:
        return
    smaller = made.scene_bytes / made.cogs_bytes
    print_line(
        f"{made.splats:,} splats, {size_text(made.scene_bytes)} as PLY, "
        f"{size_text(made.cogs_bytes)} as COGS: {smaller:.1f} times smaller"
    )
    print_line("")
    rows = [
        (
            f"{prefix.share:.0%}",
            size_text(prefix.size_bytes),
            f"{prefix.splats:,}",
            f"{prefix.held_out_db:.1f}",
            f"{prefix.worst_db:.1f}",
            f"{prefix.roam_db:.1f}",
        )
        for prefix in made.prefixes
    ]
    print_table(("prefix", "bytes", "splats", "held-out dB", "worst dB", "roam dB"), rows, left=0)
    print_line("")
    print_facts(
        ("scene", display_name(files.scene)),
        ("cameras", display_name(files.cameras)),
        ("encoded", display_name(files.cogs)),
        ("decoded", display_name(files.decoded)),
        ("film-strip", display_name(files.strip)),
        ("time", stages.summary()),
    )
