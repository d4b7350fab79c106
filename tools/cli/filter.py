"""``cogsplat filter``: leave out splats by opacity, size, place, and isolation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import Splats
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    cameras_option,
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.terminal.values import Box, FiniteNumber, box
from cogsplat.tools.workflow.descriptions import notes_of
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    plan_cameras,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_edits import inside_box
from cogsplat.tools.workflow.scene_output import OUTPUT_FORMATS, output_format, write_any

Marks = dict[str, NDArray[np.bool_]]


@click.command(
    "filter",
    epilog="\b\nExample:\n  cogsplat filter scene.ply clean.ply --min-opacity 0.02 --floaters 3",
)
@click.argument("path", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(), metavar="OUT")
@writing_options(OUTPUT_FORMATS, "Without it, OUT's extension names the format.")
@click.option(
    "--min-opacity",
    type=FiniteNumber(0, 1),
    metavar="A",
    help="Leave out splats of lower opacity, 0 to 1.",
)
@click.option(
    "--min-size",
    type=FiniteNumber(min=0),
    metavar="S",
    help="Leave out splats whose largest standard deviation is below this, scene units.",
)
@click.option(
    "--max-size",
    type=FiniteNumber(min=0),
    metavar="S",
    help="Leave out splats whose largest standard deviation is above this, scene units.",
)
@click.option(
    "--crop",
    type=box,
    metavar="XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX",
    help="Leave out splats centred outside this box.",
)
@click.option(
    "--floaters",
    type=FiniteNumber(min=0),
    metavar="D",
    help="Leave out floaters: splats with less contribution than the median whose log distance to "
    "their neighbours exceeds the median by D standard deviations. 3 is cautious, 2 finds more.",
)
@cameras_option("For --floaters and COGS output. Without it, views are planned.")
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def filter_scene(
    path: Path,
    out: Path,
    writing: SceneWriting,
    min_opacity: float | None,
    min_size: float | None,
    max_size: float | None,
    crop: Box | None,
    floaters: float | None,
    cameras: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Leave out splats by opacity, size, place or isolation.

    The other splats keep their order, values and attributes. Splats with invalid values are left
    out as well.
    """
    name = output_format(out, writing)
    if all(limit is None for limit in (min_opacity, min_size, max_size, crop, floaters)):
        raise click.UsageError(
            "nothing to leave out, expected one of --min-opacity, --min-size, --max-size, --crop "
            "and --floaters"
        )
    if cameras is not None and floaters is None and name != "cogs":
        raise click.UsageError(
            f"--cameras with {out} and without --floaters, expected COGS output or --floaters"
        )
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, 0)
            given = read_any(path, threads=threads).splats
            usable = drop_invalid_splats(given, path)
        marks = _by_values(usable, min_opacity, min_size, max_size, crop)
        if floaters is not None:
            marks["floaters"] = _floaters(usable, views, floaters, threads, stages)
        drop = np.logical_or.reduce(list(marks.values()))
        if drop.all() and len(usable):
            raise DataError(
                "nothing-left", f"{path}: none of {len(usable):,} splats is left, expected some"
            )
        kept = usable.take(~drop)
        written = write_any(
            kept,
            out,
            name,
            force=force,
            cameras=views,
            threads=threads,
            stages=stages,
            writing=writing,
            notes=notes_of(path),
        )
    invalid = len(given) - len(usable)
    if as_json:
        print_json(
            {
                **written.report(out),
                "source": display_name(path),
                "source_splats": len(given),
                "left_out": {
                    "invalid": invalid,
                    **{reason: int(rows.sum()) for reason, rows in marks.items()},
                },
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(written.line(out))
        print_facts(
            ("splats", f"{written.splats:,} of {len(given):,}"),
            ("invalid", count_text(invalid, "splat") if invalid else ""),
            ("left out", ", ".join(f"{rows.sum():,} by --{name}" for name, rows in marks.items())),
            ("time", stages.summary()),
        )


def _by_values(
    splats: Splats,
    min_opacity: float | None,
    min_size: float | None,
    max_size: float | None,
    crop: Box | None,
) -> Marks:
    """Return a mask of the splats that each limit leaves out, by the name of its option."""
    marks: Marks = {}
    # Deviations that overflow float64 are infinite, above any limit.
    with np.errstate(over="ignore"):
        size = np.exp(splats.scales.astype(np.float64).max(axis=1, initial=-np.inf))
    if min_opacity is not None:
        # σ(o) from its logarithm, which does not overflow.
        marks["min-opacity"] = (
            np.exp(-np.logaddexp(0.0, -splats.opacities.astype(np.float64))) < min_opacity
        )
    if min_size is not None:
        marks["min-size"] = size < min_size
    if max_size is not None:
        marks["max-size"] = size > max_size
    if crop is not None:
        marks["crop"] = ~inside_box(splats, crop)
    return marks


def _floaters(
    splats: Splats,
    views: Sequence[Camera] | None,
    deviations: float,
    threads: int,
    stages: Stages,
) -> NDArray[np.bool_]:
    """Return a mask of floaters: isolated splats of low contribution."""
    from cogsplat.codec.geometry import floaters
    from cogsplat.codec.scoring.contribution import score
    from cogsplat.codec.scoring.score_config import ScoreConfig

    scored_in = views or plan_cameras(splats, threads=threads, progress=stages)
    scores = score(splats, scored_in, ScoreConfig(threads=threads), progress=stages)
    return floaters.floaters(splats.means, scores.contribution, deviations, threads=threads)
