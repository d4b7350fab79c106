"""``cogsplat filter``: leave out splats by opacity, size, place, isolation and contribution."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.geometry.floaters import floaters as find_floaters
from cogsplat.codec.order.baselines import antimatter, sort_descending
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
from cogsplat.tools.terminal.values import Box, FiniteNumber, SplatCount, box, splat_count
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

F64 = NDArray[np.float64]
Marks = dict[str, NDArray[np.bool_]]

_CONTRIBUTION: Final = "contribution"
_ANTIMATTER: Final = "antimatter"


@click.command(
    "filter",
    epilog="\b\nExample:\n"
    "  cogsplat filter scene.ply clean.ply --min-opacity 0.02 --floaters 3\n"
    "  cogsplat filter scene.ply small.ply --keep 25%",
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
@click.option(
    "--keep",
    type=splat_count,
    metavar="N|P%",
    help="Number or percentage of splats to keep, of those that the other limits leave.",
)
@click.option(
    "--by",
    type=click.Choice((_CONTRIBUTION, _ANTIMATTER)),
    help="For --keep. contribution (default) keeps the splats that contribute most to the "
    "pictures; antimatter, without rendering, those of the largest volume times opacity.",
)
@cameras_option("For --floaters, --keep and COGS output. Without it, views are planned.")
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
    keep: SplatCount | None,
    by: str | None,
    cameras: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Leave out splats by value, place, isolation or contribution.

    The other splats keep their order, values and attributes. Splats with invalid values are left
    out as well.
    """
    name = output_format(out, writing)
    if all(limit is None for limit in (min_opacity, min_size, max_size, crop, floaters, keep)):
        raise click.UsageError(
            "nothing to leave out, expected one of --min-opacity, --min-size, --max-size, --crop, "
            "--floaters and --keep"
        )
    if by is not None and keep is None:
        raise click.UsageError(f"--by {by} without --keep, expected --keep as well")
    scores_kept = keep is not None and by != _ANTIMATTER
    if cameras is not None and floaters is None and not scores_kept and name != "cogs":
        raise click.UsageError(
            f"--cameras with {out}, expected COGS output, --floaters or --keep by contribution"
        )
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, 0)
            given = read_any(path, threads=threads).splats
            usable = drop_invalid_splats(given, path)
        marks = _by_values(usable, min_opacity, min_size, max_size, crop)
        out_by_values = any(rows.any() for rows in marks.values())
        contribution: F64 | None = None
        if floaters is not None:
            contribution = _contribution(usable, views, threads, stages)
            marks["floaters"] = find_floaters(usable.means, contribution, floaters, threads=threads)
        left = ~np.logical_or.reduce([np.zeros(len(usable), bool), *marks.values()])
        if len(usable) and not left.any():
            raise DataError(
                "nothing-left", f"{path}: none of {len(usable):,} splats is left, expected some"
            )
        kept = usable.take(left)
        left_out = {reason: int(rows.sum()) for reason, rows in marks.items()}
        share: float | None = None
        if keep is not None:
            # Splats that were hidden by those left out contribute more without them. Floaters
            # hide little.
            scored = None if contribution is None or out_by_values else contribution[left]
            count = _count(keep, len(kept), path)
            left_out["keep"] = len(kept) - count
            rows, share = _highest(kept, count, by, scored, views, threads, stages)
            kept = kept.take(rows)
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
                "left_out": {"invalid": invalid, **left_out},
                "kept_share_of_contribution": share,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(written.line(out))
        print_facts(
            ("splats", f"{written.splats:,} of {len(given):,}"),
            ("invalid", count_text(invalid, "splat") if invalid else ""),
            ("left out", ", ".join(f"{count:,} by --{name}" for name, count in left_out.items())),
            ("kept", "" if share is None else f"{share:.1%} of the contribution"),
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


def _contribution(
    splats: Splats, views: Sequence[Camera] | None, threads: int, stages: Stages
) -> F64:
    """Return the contribution of each splat in the cameras, or in planned views, (N,) float64."""
    from cogsplat.codec.scoring.contribution import score
    from cogsplat.codec.scoring.score_config import ScoreConfig

    scored_in = views or plan_cameras(splats, threads=threads, progress=stages)
    return score(splats, scored_in, ScoreConfig(threads=threads), progress=stages).contribution


def _count(keep: SplatCount, splats: int, path: Path) -> int:
    """Return the number of splats to keep of `splats`; warn if there are fewer than asked for."""
    count = keep.of(splats)
    if not keep.is_share and count < keep.amount:
        warnings.warn(
            f"{path}: {splats:,} splats left, fewer than --keep {int(keep.amount):,}; all are kept",
            CogsplatWarning,
            stacklevel=2,
        )
    return count


def _highest(
    splats: Splats,
    count: int,
    by: str | None,
    contribution: F64 | None,
    views: Sequence[Camera] | None,
    threads: int,
    stages: Stages,
) -> tuple[NDArray[np.int64], float | None]:
    """Return the rows to keep, ascending, and their share of the contribution.

    `contribution` is None where the splats are not scored yet. The share is None where it is not
    measured: by antimatter, or because all splats are kept.
    """
    if count == len(splats):
        return np.arange(count), None
    if by == _ANTIMATTER:
        return np.sort(sort_descending(antimatter(splats))[:count]), None
    if contribution is None:
        contribution = _contribution(splats, views, threads, stages)
    rows = np.sort(sort_descending(contribution)[:count])
    total = float(contribution.sum())
    return rows, round(float(contribution[rows].sum()) / total, 5) if total else None
