"""``cogsplat decimate``: a number or share of a scene's splats, by contribution."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import CogsplatWarning
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
from cogsplat.tools.terminal.output import display_name, print_facts, print_json, print_line
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.descriptions import notes_of
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    plan_cameras,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_output import OUTPUT_FORMATS, output_format, write_any

_CONTRIBUTION: Final = "contribution"
_ANTIMATTER: Final = "antimatter"
_COUNT: Final = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,9})?)(%?)")


@dataclass(frozen=True)
class SplatCount:
    """A number of splats, or a share of a scene's splats.

    Parameters
    ----------
    amount : Fraction
        Number of splats, or share.
    is_share : bool
        Whether `amount` is a share, above 0 and at most 1.
    """

    amount: Fraction
    is_share: bool

    def of(self, splats: int) -> int:
        """Return the number of splats to keep of `splats`, rounded up."""
        return min(math.ceil(self.amount * splats if self.is_share else self.amount), splats)


def splat_count(text: str) -> SplatCount:
    """Parse a number of splats or a share, such as ``20000`` or ``25%``.

    Raises
    ------
    click.BadParameter
        The text is neither.
    """
    match = _COUNT.fullmatch(text.strip())
    amount = Fraction(match[1]) if match else Fraction(0)
    if match and match[2] and 0 < amount <= 100:
        return SplatCount(amount / 100, is_share=True)
    if match and not match[2] and amount >= 1 and amount.denominator == 1:
        return SplatCount(amount, is_share=False)
    raise click.BadParameter(f"{text!r}, expected splats such as 20000, or a share such as 25%")


@click.command(epilog="\b\nExample:\n  cogsplat decimate scene.ply small.ply --to 25%")
@click.argument("path", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(), metavar="OUT")
@writing_options(OUTPUT_FORMATS, "Without it, OUT's extension names the format.")
@click.option(
    "--to",
    "count",
    type=splat_count,
    required=True,
    metavar="N|P%",
    help="Number or percentage of splats to keep.",
)
@click.option(
    "--by",
    type=click.Choice((_CONTRIBUTION, _ANTIMATTER)),
    default=_CONTRIBUTION,
    show_default=True,
    help="contribution keeps the splats that contribute most to the pictures; antimatter, without "
    "rendering, those of the largest volume times opacity.",
)
@cameras_option("Without it, views are planned around the scene.")
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def decimate(
    path: Path,
    out: Path,
    writing: SceneWriting,
    count: SplatCount,
    by: str,
    cameras: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Keep the splats of SCENE with the largest contribution.

    The splats keep the order of the file and all attributes. Splats with invalid values are left
    out first.
    """
    name = output_format(out, writing)
    if cameras is not None and by == _ANTIMATTER and name != "cogs":
        raise click.UsageError(
            f"--cameras with --by {by} and {out}, expected an option or output that uses them"
        )
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, 0)
            given = read_any(path, threads=threads).splats
            usable = drop_invalid_splats(given, path)
        target = count.of(len(usable))
        if not count.is_share and target < count.amount:
            warnings.warn(
                f"{path}: has {len(usable):,} valid splats, fewer than --to "
                f"{int(count.amount):,}; all are kept",
                CogsplatWarning,
                stacklevel=1,
            )
        if by == _CONTRIBUTION and target < len(usable):
            from cogsplat.codec.scoring.contribution import score
            from cogsplat.codec.scoring.score_config import ScoreConfig

            scored_in = views or plan_cameras(usable, threads=threads, progress=stages)
            scores = score(usable, scored_in, ScoreConfig(threads=threads), progress=stages)
            priority = scores.contribution
        else:
            priority = antimatter(usable)
        kept = _keep_highest(usable, priority, target)
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
    if as_json:
        print_json(
            {
                **written.report(out),
                "source": display_name(path),
                "source_splats": len(given),
                "kept_by": by,
                "kept_share_of_contribution": _share(priority, target, by),
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(written.line(out))
        share = _share(priority, target, by)
        print_facts(
            ("splats", f"{written.splats:,} of {len(given):,}"),
            ("kept", "" if share is None else f"{share:.1%} of the contribution"),
            ("time", stages.summary()),
        )


def _keep_highest(splats: Splats, priority: NDArray[np.float64], count: int) -> Splats:
    """Return the `count` splats of highest priority, in the order of the file."""
    if count == len(splats):
        return splats
    return splats.take(np.sort(sort_descending(priority)[:count]))


def _share(priority: NDArray[np.float64], count: int, by: str) -> float | None:
    """Return the share of the contribution in the `count` kept splats; None if not measured."""
    if by != _CONTRIBUTION or count == len(priority):
        return None
    total = float(priority.sum())
    return round(float(np.sort(priority)[::-1][:count].sum()) / total, 5) if total else None
