"""Levels of one file against models of one size, against cuts, and against the scene drawn small.

Run ``python -m cogsplat.tools.benchmark.level_peers SCENE --cameras CAMERAS --eval-every 8``. For
each level it prints what is fetched and how the pictures of the held-out views compare with the
scene's full pictures averaged to their size: of the level; of a file that was trained for pictures
of this size alone, from as many splats; of as many splats that contribute most, stored without
training; and of the scene itself drawn at this size.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.fit.level_encoding import encode_levels
from cogsplat.codec.fit.levels import (
    LevelledSplats,
    LevelsConfig,
    averaged,
    scaled_camera,
    train_levels,
)
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cogs import scene as cogs
from cogsplat.tools.evaluation.level_figures import compared, level_sizes
from cogsplat.tools.terminal.output import say, table

Row = tuple[str, ...]


def _stored(levels: LevelledSplats, cameras: Sequence[Camera]) -> list[tuple[int, int, Splats]]:
    """Return for each level what is fetched, what of this are opacities, and what is decoded."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "levels.cogs"
        cogs.save(encode_levels(levels, cameras), path, writer="benchmark")
        with cogsplat.open(path) as file:
            return [
                (sizes.bytes_fetched, sizes.opacity_bytes, file.decode(level=sizes.level))
                for sizes in level_sizes(file)
            ]


def measure(
    splats: Splats, cameras: Sequence[Camera], tests: Sequence[Camera], config: LevelsConfig
) -> list[Row]:
    """Return a row for each level and way of making its pictures.

    Parameters
    ----------
    splats : Splats
    cameras, tests : sequence of Camera
        To train in, and to judge in.
    config : LevelsConfig
    """
    info = splats.info
    drawing = RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased)
    full = [render(splats, camera, drawing) for camera in tests]
    rows: list[Row] = []

    def judge(scale: int, way: str, size: int, opacities: int, scene: Splats) -> None:
        small = [scaled_camera(camera, scale) for camera in tests]
        targets: list[NDArray[np.float32]] = [averaged(picture, scale) for picture in full]
        figures = compared(scene, small, targets)
        rows.append(
            (
                f"1/{scale}", way, f"{len(scene):,}", f"{size:,}" if size else "-",
                f"{opacities:,}" if opacities else "-", f"{figures.psnr_db:.2f}",
                f"{figures.worst_psnr_db:.2f}", f"{figures.ssim:.4f}",
            )
        )  # fmt: skip

    levels = _stored(train_levels(splats, cameras, config), cameras)
    for scale, share, (size, opacities, scene) in zip(
        config.scales, config.shares, levels, strict=True
    ):
        judge(scale, "level", size, opacities, scene)
        alone = replace(config, scales=(scale,), shares=(share,))
        ((size, _, scene),) = _stored(train_levels(splats, cameras, alone), cameras)
        judge(scale, "single-scale model", size, 0, scene)
        cut = train_levels(splats, cameras, replace(alone, steps=0))
        ((size, _, scene),) = _stored(cut, cameras)
        judge(scale, "cut, not trained", size, 0, scene)
        judge(scale, "the scene", 0, 0, splats)
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, prog="level_peers")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--eval-every", type=int, default=8)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    splats = cogsplat.read(given.scene).without_extras()
    splats = splats.take(~splats.invalid_rows())
    train, tests = hold_out(cogsplat.read_cameras(given.cameras), given.eval_every)
    config = LevelsConfig(steps=given.steps, threads=given.threads)
    rows = measure(splats, train, tests or train, config)
    say(f"{given.scene}: {len(tests or train)} views, {given.steps} steps a level")
    heads = (
        "pictures",
        "drawn from",
        "splats",
        "fetched B",
        "opacities B",
        "PSNR",
        "worst",
        "SSIM",
    )
    table(heads, rows, left=2)


if __name__ == "__main__":
    main()
