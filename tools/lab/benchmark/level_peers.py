"""Comparison of detail levels with single-scale, multi-scale and untrained models.

Run ``python -m cogsplat.tools.lab.benchmark.level_peers SCENE --cameras CAMERAS --eval-every
8``. For every model it prints the bytes fetched and the quality in held-out views at the model's
own picture size, then the PSNR at all sizes. The ground truth is a full-size render of the source
scene, downscaled. The models are:

- the levels of one file;
- per level, a file of the same number of splats, trained only for the picture size of the level;
- per level, the same number of splats of largest contribution, without training;
- one file trained on pictures of all sizes;
- the scene itself, not stored.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.fit.level_encoding import encode_levels
from cogsplat.codec.fit.level_training import (
    LevelledSplats,
    train_jointly,
    train_levels,
)
from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.tools.evaluation.level_figures import PictureFigures, level_sizes, picture_figures
from cogsplat.tools.evaluation.lpips import Lpips, read_lpips
from cogsplat.tools.pictures.svg_charts import Series, line_chart
from cogsplat.tools.terminal.output import print_line, print_table

Row = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Model:
    """Splats made for one picture size by one training method.

    Parameters
    ----------
    way : str
        Training method.
    scale : int
        Downscaling factor of the pictures for which the model is made.
    splats : Splats
        Decoded splats.
    bytes_fetched : int
        Bytes fetched for the model; 0 for the scene itself.
    opacity_bytes : int
        Part of `bytes_fetched` for opacities of the level.
    """

    way: str
    scale: int
    splats: Splats
    bytes_fetched: int = 0
    opacity_bytes: int = 0


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """A model, and its picture quality by downscaling factor of the pictures."""

    model: Model
    figures: dict[int, PictureFigures]


def _stored(levels: LevelledSplats, cameras: Sequence[Camera], way: str) -> list[Model]:
    """Encode levels to a file, decode it, and return a model for each level."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "levels.cogs"
        cogs.save(encode_levels(levels, cameras), path, writer="benchmark")
        with cogsplat.open(path) as file:
            return [
                Model(
                    way,
                    int(sizes.scale),
                    file.decode(level=sizes.level),
                    sizes.bytes_fetched,
                    sizes.opacity_bytes,
                )
                for sizes in level_sizes(file)
            ]


def models(splats: Splats, cameras: Sequence[Camera], config: LevelsConfig) -> list[Model]:
    """Return the levels of a scene, trained as one file, and the models for comparison.

    Parameters
    ----------
    splats : Splats
        Source scene.
    cameras : sequence of Camera
        Training views.
    config : LevelsConfig
        Scales, shares of splats and training steps of the levels.
    """
    found = _stored(train_levels(splats, cameras, config), cameras, "level")
    for scale, share in zip(config.scales, config.shares, strict=True):
        alone = replace(config, scales=(scale,), shares=(share,))
        found += _stored(train_levels(splats, cameras, alone), cameras, "single-scale")
        cut = train_levels(splats, cameras, replace(alone, steps=0))
        found += _stored(cut, cameras, "cut, not trained")
    found += _stored(train_jointly(splats, cameras, config), cameras, "multi-scale")
    return [*found, Model("the scene", config.scales[-1], splats)]


def measure_quality(
    splats: Splats,
    of: Sequence[Model],
    tests: Sequence[Camera],
    config: LevelsConfig,
    *,
    lpips: Lpips | None = None,
) -> list[ModelQuality]:
    """Measure every model at all scales against downscaled full-size renders of the source.

    Parameters
    ----------
    splats : Splats
        Source scene.
    of : sequence of Model
        Models to measure.
    tests : sequence of Camera
        Test views at full size.
    config : LevelsConfig
        Configuration whose scales are measured.
    lpips : Lpips, optional
        Network that also measures LPIPS; by default only PSNR and SSIM are measured.
    """
    drawing = RenderConfig()
    full = [render(splats, camera, drawing) for camera in tests]
    small = {scale: [camera.downscaled(scale) for camera in tests] for scale in config.scales}
    targets = {
        scale: [downscale_picture(picture, scale) for picture in full] for scale in config.scales
    }
    return [
        ModelQuality(
            model,
            {
                scale: picture_figures(model.splats, small[scale], targets[scale], lpips=lpips)
                for scale in config.scales
            },
        )
        for model in of
    ]


def own_rows(found: Sequence[ModelQuality]) -> list[Row]:
    """Return a table row per model with the quality at its own picture size."""
    rows: list[Row] = []
    for one in found:
        model, figures = one.model, one.figures[one.model.scale]
        rows.append(
            (
                f"1/{model.scale}",
                model.way,
                f"{len(model.splats):,}",
                f"{model.bytes_fetched:,}" if model.bytes_fetched else "-",
                f"{model.opacity_bytes:,}" if model.opacity_bytes else "-",
                f"{figures.psnr_db:.2f}",
                f"{figures.worst_psnr_db:.2f}",
                f"{figures.ssim:.4f}",
                "-" if figures.lpips is None else f"{figures.lpips:.4f}",
            )
        )
    return rows


def size_rows(found: Sequence[ModelQuality]) -> list[Row]:
    """Return a table row per model with the mean PSNR at every size, dB."""
    return [
        (
            f"1/{one.model.scale}",
            one.model.way,
            *(f"{figures.psnr_db:.2f}" for figures in one.figures.values()),
        )
        for one in found
    ]


def chart(found: Sequence[ModelQuality], width: int) -> str:
    """Return an SVG chart of PSNR by picture width, one line per model.

    Parameters
    ----------
    found : sequence of ModelQuality
    width : int
        Width of the full-size pictures, px.
    """
    series = [
        Series(
            f"{one.model.way} 1/{one.model.scale}",
            tuple((width / scale, figures.psnr_db) for scale, figures in one.figures.items()),
            style=style,
        )
        for style, one in enumerate(found)
    ]
    return line_chart("Quality at display sizes", "width of the picture, px", "PSNR, dB", series)


def main() -> None:
    """Measure the models for a scene given on the command line and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__, prog="level_peers")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--eval-every", type=int, default=8)
    parser.add_argument("--scales", default="8,4,2,1", help="downscaling factor of each level")
    parser.add_argument("--shares", default="8%,25%,60%,100%", help="splats of each level")
    parser.add_argument(
        "--smaller", type=int, default=1, help="downscale all pictures by this factor first"
    )
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--lpips-weights", type=Path, help="also print LPIPS, with these weights")
    parser.add_argument("--chart", type=Path, help="write PSNR by size as SVG")
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    splats = cogsplat.read(given.scene).without_extras()
    splats = splats.take(~splats.invalid_rows())
    cameras = [camera.downscaled(given.smaller) for camera in cogsplat.read_cameras(given.cameras)]
    train, tests = hold_out(cameras, given.eval_every)
    config = LevelsConfig(
        tuple(int(scale) for scale in given.scales.split(",")),
        tuple(float(share.removesuffix("%")) / 100 for share in given.shares.split(",")),
        steps=given.steps,
        threads=given.threads,
    )
    lpips = None if given.lpips_weights is None else read_lpips(given.lpips_weights)
    found = measure_quality(
        splats, models(splats, train, config), tests or train, config, lpips=lpips
    )
    print_line(f"{given.scene}: {len(tests or train)} views, {given.steps} steps a level")
    heads = (
        "pictures", "drawn from", "splats", "fetched B", "opacities B", "PSNR", "worst", "SSIM",
        "LPIPS",
    )  # fmt: skip
    print_table(heads, own_rows(found), left=2)
    print_line("PSNR by the size of the pictures:")
    print_table(
        ("made for", "drawn from", *(f"1/{s}" for s in config.scales)), size_rows(found), left=2
    )
    if given.chart is not None:
        given.chart.write_text(chart(found, cameras[0].width), encoding="utf-8")


if __name__ == "__main__":
    main()
