"""``cogsplat lab score``: the contribution of each splat to the pictures of its cameras."""

from __future__ import annotations

import warnings
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    cameras_option,
    device_option,
    eval_every_option,
    force_option,
    jitter_option,
    json_option,
    quiet_option,
    threads_option,
    top_k_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.output_names import NPY, check_name
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.inputs import plan_cameras, read_any, scoring_cameras
from cogsplat.tools.workflow.output_files import check_outputs

from .npy_output import write_npy


@click.command(
    epilog="\b\nExample:\n  cogsplat lab score scene.ply contribution.npy --cameras cameras.json"
)
@click.argument("path", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(".npy"), metavar="OUT.npy")
@cameras_option("Without it, views are planned around the scene.")
@jitter_option
@top_k_option(20)
@eval_every_option(0, "do not score in it.")
@partial_option
@limits_option
@device_option("Device that renders.")
@threads_option
@force_option
@quiet_option
@json_option
def score(
    path: Path,
    out: Path,
    cameras: Path | None,
    no_jitter: bool,
    top_k: int,
    eval_every: int,
    device: str,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Measure the contribution of each splat of SCENE.

    OUT.npy holds a float64 for each splat in the order of the file: its blending weights summed
    over the pixels of a view, averaged over the cameras, plus the average over their jittered
    copies.
    """
    from cogsplat.codec.scoring.contribution import score as score_splats
    from cogsplat.codec.scoring.score_config import ScoreConfig

    check_name(out, NPY)
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, eval_every)
            splats = read_any(path, threads=threads).splats
        views = views or plan_cameras(splats, threads=threads, progress=stages)
        config = ScoreConfig(top_k=top_k, jitter=not no_jitter, threads=threads, device=device)
        scores = score_splats(splats, views, config, progress=stages)
        write_npy(scores.contribution, out, force=force)
        stages("write", 1, 1)
    invalid = int(splats.invalid_rows().sum())
    if invalid:
        warnings.warn(
            f"{path}: {invalid:,} of {len(splats):,} splats have invalid values and score 0",
            CogsplatWarning,
            stacklevel=1,
        )
    unseen = int((scores.shown == 0).sum())
    shares = {goal: _share_holding(scores.contribution, goal) for goal in (0.5, 0.9, 0.99)}
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(path),
                "splats": len(splats),
                "unseen": unseen,
                "scored_views": stages.totals["score"],
                "contribution": float(scores.contribution.sum()),
                "share_of_splats_holding": {f"{goal:g}": s for goal, s in shares.items()},
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(
            f"{out}: contributions of {count_text(len(splats), 'splat')}, float64, in file order"
        )
        held = [f"{goal:.0%} lie in {share:.1%}" for goal, share in shares.items()]
        print_facts(
            ("views", f"{stages.totals['score']}" + ("" if no_jitter else ", jittered included")),
            ("unseen", count_text(unseen, "splat")),
            ("of all", f"{', '.join(held)} of the splats"),
            ("time", stages.summary()),
        )


def _share_holding(contribution: NDArray[np.float64], goal: float) -> float:
    """Return the smallest share of the splats with a given share of the contribution."""
    so_far = np.cumsum(np.sort(contribution)[::-1])
    return round((int(np.searchsorted(so_far, goal * so_far[-1])) + 1) / len(so_far), 5)
