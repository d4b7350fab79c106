"""Ablation of tuning: scenes tuned to one file size with one part of tuning changed or left out.

Run ``python -m cogsplat.tools.lab.benchmark.tuning_ablation SCENE --cameras CAMERAS --size
60KB``, or without a scene for a synthetic one. For each variant it prints the splats and bytes of
the file, and the PSNR in held-out and roaming views against the source, with ``--images`` also
against photos. ``--only`` names a variant to run and may be repeated.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import Target
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.fit.splat_budget import count_for_size
from cogsplat.codec.fit.tune_config import TuneConfig, TuneRequest
from cogsplat.codec.fit.tuning import tune
from cogsplat.codec.fit.tuning_views import TuningViews
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.roam_views import roam
from cogsplat.codec.views.view_sets import hold_out, sample_evenly
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.storage.byte_counts import parse_bytes
from cogsplat.tools.evaluation.photos import read_ground_truth
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.terminal.output import print_line, print_table
from cogsplat.tools.terminal.values import FiniteNumber

F32 = NDArray[np.float32]
Row = tuple[str, ...]


@dataclass(frozen=True)
class Variant:
    """Tuning with one part changed or left out, for the ablation.

    Parameters
    ----------
    name : str
        Name for the table.
    config : TuneConfig
        Tuning parameters.
    photos : bool
        Whether photos are the ground truth instead of renders of the source.
    views_share : float
        Share of the cameras used as training views.
    """

    name: str
    config: TuneConfig
    photos: bool = False
    views_share: float = 1.0


def variants(config: TuneConfig, share: float, *, photos: bool) -> list[Variant]:
    """Return the default tuning, then variants with one part changed or left out.

    Parameters
    ----------
    config : TuneConfig
        Default parameters, without `TuneConfig.keep` and `TuneConfig.seconds`.
    share : float
        Share of the splats that the default variant keeps.
    photos : bool
        Whether photos are available.
    """
    train = config.train
    rounds = max(1, math.ceil(math.log(share) / math.log(config.round_keep)))
    untrained = replace(
        config,
        round_steps=1,
        recovery_steps=1,
        quantised_steps=1,
        encode_interval=1,
        round_keep=0.01,
    )
    found = [
        Variant("default", config),
        Variant("1.5 times as many splats", replace(config, keep=min(1.0, 1.5 * share))),
        Variant("0.67 times as many splats", replace(config, keep=share / 1.5)),
        Variant(
            "one pruning step instead of rounds",
            replace(config, round_keep=0.01, round_steps=rounds * config.round_steps),
        ),
        Variant("pruned, not trained", untrained),
        Variant(
            "no quantisation-aware training",
            replace(config, quantised_steps=1, encode_interval=1),
        ),
        Variant(
            "noise instead of quantisers",
            replace(config, train=replace(train, noise=True)),
        ),
        Variant("no rate term", replace(config, rate_weight=0.0)),
        Variant("half of the views", config, views_share=0.5),
        Variant("a quarter of the views", config, views_share=0.25),
    ]
    if photos:
        found.append(Variant("photos as ground truth", config, photos=True))
    return found


def measure(
    splats: Splats,
    cameras: Sequence[Camera],
    tests: Sequence[Camera],
    size_bytes: int,
    config: TuneConfig,
    *,
    photos: tuple[Sequence[F32], Sequence[F32]] | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    only: Sequence[str] = (),
) -> list[Row]:
    """Tune a scene to one file size by every variant; return a table row for each variant.

    Parameters
    ----------
    splats : Splats
        Source scene.
    cameras : sequence of Camera
        Training views.
    tests : sequence of Camera
        Test views.
    size_bytes : int
        Target size of every file.
    config : TuneConfig
        Tuning parameters of the default variant.
    photos : tuple of sequences of (H, W, 3) float32, optional
        Photos of the training and of the test views, 0 to 1.
    background : tuple of float
        RGB behind the splats, in training and in measurements.
    only : sequence of str
        Names of the variants to run; empty for all.
    """
    drawing = RenderConfig(background=background)

    def figures(scene: Splats, views: Sequence[Camera], expected: Sequence[F32]) -> list[float]:
        drawn = (np.clip(render(scene, view, drawing), 0.0, 1.0) for view in views)
        return [float(psnr(*pair)) for pair in zip(expected, drawn, strict=True)]

    away = roam(splats, tests)
    shown = {
        name: [np.clip(render(splats, view, drawing), 0.0, 1.0) for view in views]
        for name, views in (("tests", tests), ("away", away))
    }

    def size_of(encoded: EncodedScene) -> int:
        return cogs.size_bytes(encoded, writer="benchmark")

    rows: list[Row] = []
    share = count_for_size(size_bytes, splats.sh_degree, len(splats)) / len(splats)
    for variant in variants(config, share, photos=photos is not None):
        if only and variant.name not in only:
            continue
        numbers = sample_evenly(
            range(len(cameras)), max(2, round(variant.views_share * len(cameras)))
        )
        views = [cameras[number] for number in numbers]
        ground_truth = None
        if variant.photos and photos is not None:
            ground_truth = [photos[0][number] for number in numbers]
        request = TuneRequest(
            TuningViews(views),
            Target(size_bytes=size_bytes),
            variant.config,
            photos=ground_truth,
            background=background,
        )
        made = tune(splats, request, size_of=size_of).encoded
        held = figures(made.decoded, tests, shown["tests"])
        row: Row = (
            variant.name,
            f"{made.splats:,}",
            f"{size_of(made):,}",
            f"{np.mean(held):.2f}",
            f"{min(held):.2f}",
            f"{np.mean(figures(made.decoded, away, shown['away'])):.2f}",
        )
        if photos is not None:
            row = (*row, f"{np.mean(figures(made.decoded, tests, photos[1])):.2f}")
        rows.append(row)
    return rows


def main() -> None:
    """Run the ablation for the scene given on the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, prog="tuning_ablation")
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--images", type=Path)
    parser.add_argument(
        "--background",
        type=FiniteNumber(),
        nargs=3,
        metavar=("R", "G", "B"),
        default=[0.0, 0.0, 0.0],
        help="behind the splats, 0 to 1 each",
    )
    parser.add_argument("--only", action="append", default=[], help="name of a variant to run")
    parser.add_argument("--size", default="40KB")
    parser.add_argument("--eval-every", type=int, default=8)
    parser.add_argument(
        "--steps",
        type=int,
        default=100,
        help="training steps per round; other stages in proportion",
    )
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    if (given.scene is None) != (given.cameras is None):
        parser.error("SCENE and --cameras: expected both or none")
    config = TuneConfig(
        round_steps=given.steps, recovery_steps=15 * given.steps, quantised_steps=6 * given.steps
    )
    config = replace(config, train=replace(config.train, threads=given.threads))
    names = [variant.name for variant in variants(config, 1.0, photos=given.images is not None)]
    unknown = sorted(set(given.only) - set(names))
    if unknown:
        parser.error(f"--only {unknown}, expected some of {names}")
    if given.scene is None:
        splats, cameras = synth(12_000), synth_cameras(32, 160, 120)
    else:
        splats = cogsplat.read(given.scene).without_extras()
        splats = splats.take(~splats.invalid_rows())
        cameras = cogsplat.read_cameras(given.cameras)
    train, tests = hold_out(cameras, given.eval_every)
    red, green, blue = given.background
    background = red, green, blue
    photos = None
    if given.images is not None:
        photos = read_ground_truth(given.images, train), read_ground_truth(given.images, tests)
    size = parse_bytes(given.size)
    rows = measure(
        splats, train, tests, size, config, photos=photos, background=background, only=given.only
    )
    of = given.scene or "synthetic scene"
    print_line(
        f"{of}: {len(splats):,} splats, {len(tests)} held-out views, {given.steps} steps a round"
    )
    heads = ["variant", "splats", "bytes", "held-out", "worst", "roam"]
    print_table([*heads, "photos"] if photos else heads, rows, left=1)


if __name__ == "__main__":
    main()
