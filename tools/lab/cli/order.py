"""``cogsplat lab order``: an order of a scene's splats, written as a permutation."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.order import objects
from cogsplat.codec.order.chunk_plan import DEFAULT_CHUNK_SPLATS
from cogsplat.codec.order.orders import OrderInputs, needs_scores, order_rows
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.option_groups import GroupedCommand
from cogsplat.tools.terminal.options import (
    cameras_option,
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
    print_table,
)
from cogsplat.tools.terminal.output_names import NPY, check_name
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.inputs import (
    load_cameras,
    plan_cameras,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.order_options import OrderChoice, order_options
from cogsplat.tools.workflow.output_files import check_outputs

from .npy_output import write_npy

# `--help` shows the first group.
_GROUPS: Final = {
    "Most used": (
        "--cameras",
        "--order",
        "--view",
        "--objects",
        "--threads",
        "--force",
        "--config",
        "--json",
        "--help-all",
        "--help",
    ),
    "Parameters of the orders": (
        "--first-view-share",
        "--first-view-mix",
        "--frustum-share",
        "--frustum-margin",
        "--octree-depth",
        "--octree-capacity",
        "--seed",
        "--object-budgets",
        "--masks",
    ),
    "Scoring": ("--no-jitter", "--top-k", "--eval-every"),
}


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog="\b\nExample:\n"
    "  cogsplat lab order scene.ply rows.npy --cameras cameras.json\n"
    "  cogsplat lab order scene.ply rows.npy --cameras cameras.json \\\n"
    "    --order gain+first-view --view 3",
)
@click.argument("path", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(".npy"), metavar="OUT.npy")
@cameras_option("Without it, views are planned around the scene.")
@order_options
@jitter_option
@top_k_option(20)
@eval_every_option(0, "do not score in it.")
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def order(
    path: Path,
    out: Path,
    cameras: Path | None,
    choice: OrderChoice,
    no_jitter: bool,
    top_k: int,
    eval_every: int,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Write an order of the splats of SCENE as a permutation.

    OUT.npy holds the row numbers of all splats, int64, first splat first. No splat is pruned.
    """
    from cogsplat.codec.scoring.contribution import score, zero_scores
    from cogsplat.codec.scoring.score_config import ScoreConfig

    check_name(out, NPY)
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            given = read_any(path, threads=threads).splats
            views = scoring_cameras(cameras, eval_every)
            numbered = load_cameras(cameras) if cameras else []
        splats = choice.with_labels(given, cameras, threads=threads, progress=stages)
        # Objects are ranked by their contribution.
        scored = needs_scores(choice.name) or choice.by_object
        if views is None and scored:
            views = plan_cameras(splats, threads=threads, progress=stages)
        config = choice.config(splats, numbered, threads)
        scores = zero_scores(len(splats))
        if scored:
            settings = ScoreConfig(top_k=top_k, jitter=not no_jitter, threads=threads)
            scores = score(splats, views or (), settings, progress=stages)
        with stages.stage("order"):
            scene = OrderInputs(splats, scores, views or (), threads, stages, jitter=not no_jitter)
            rows = order_rows(choice.name, scene, config)
            labels: NDArray[np.uint32] | None = None
            if choice.by_object:
                labels = objects.labels_of(splats)
                rows = objects.chunk_by_object(
                    rows, labels, scores.contribution, DEFAULT_CHUNK_SPLATS, config.object_budgets
                ).rows
        write_npy(rows, out, force=force)
        stages("write", 1, 1)
    invalid = int(splats.invalid_rows().sum())
    if invalid:
        warnings.warn(
            f"{path}: {invalid:,} of {len(splats):,} splats have invalid values",
            CogsplatWarning,
            stacklevel=1,
        )
    held = [] if labels is None else _objects(labels, scores.contribution)
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(path),
                "splats": len(splats),
                "order": choice.name,
                "scored_views": stages.totals.get("score", 0),
                "objects": [
                    {"object": label, "splats": count, "share_of_contribution": round(share, 6)}
                    for label, count, share in held
                ],
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{out}: {choice.name} order of {count_text(len(splats), 'splat')}, int64")
        jittered = "" if no_jitter else ", jittered included"
        seen = (
            f"{stages.totals['score']}{jittered}" if scored else "none: this order needs no scores"
        )
        print_facts(("views", seen), ("time", stages.summary()))
        if held:
            print_line("")
            cells = [(f"{label}", f"{count:,}", f"{share:.1%}") for label, count, share in held]
            print_table(("object", "splats", "of contribution"), cells, left=0)


def _objects(
    labels: NDArray[np.uint32], contribution: NDArray[np.float64]
) -> list[tuple[int, int, float]]:
    """Return label, splats and share of all contribution of every object, as they rank."""
    found, total = objects.rank_objects(labels, contribution)
    whole = float(total.sum()) or 1.0
    counts = dict(
        zip(*(part.tolist() for part in np.unique(labels, return_counts=True)), strict=True)
    )
    return [
        (label, counts[label], share / whole)
        for label, share in zip(found.tolist(), total.tolist(), strict=True)
    ]
