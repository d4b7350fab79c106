"""Comparison of levels with prefixes of an ordinary file and with files trained for one size.

Run ``python -m cogsplat.tools.lab.benchmark.level_peers SCENE --cameras CAMERAS --eval-every
8``. For every model it prints splats, the bytes fetched and the quality in held-out views at the
model's own picture size. The ground truth is a full-size render of the source scene, downscaled.
All models are drawn as thick as trained, with the cameras as capture viewpoints. The models are:

- the levels of one file;
- per level, the beginning of a file of ``encode`` with the bytes of the level;
- per level, the first chunks of that file with the splats of the level;
- per level, a file of the same share of splats, trained only for the picture size of the level.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.fit.level_encoding import encode_levels
from cogsplat.codec.fit.level_training import train_levels
from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.tools.evaluation.level_figures import PictureFigures, level_sizes, picture_figures
from cogsplat.tools.evaluation.lpips import Lpips, read_lpips
from cogsplat.tools.evaluation.prefix_quality import decode_prefix
from cogsplat.tools.terminal.output import print_line, print_table

Row = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Model:
    """Splats for one picture size.

    Parameters
    ----------
    way : str
        How the splats are made.
    scale : int
        Downscaling factor of the pictures for which the model is made.
    splats : Splats
        Decoded splats.
    bytes_fetched : int
        Bytes fetched for the model; 0 where they are not counted.
    """

    way: str
    scale: int
    splats: Splats
    bytes_fetched: int = 0


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """A model, and its picture quality at its own size."""

    model: Model
    figures: PictureFigures


def _trained(splats: Splats, cameras: Sequence[Camera], config: LevelsConfig) -> list[Model]:
    """Return a model for each level of a trained file, decoded."""
    levels = train_levels(splats, cameras, config)
    way = "level" if len(config.scales) > 1 else "a file for this size"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "levels.cogs"
        cogs.save(encode_levels(levels, cameras), path, writer="benchmark")
        with cogsplat.open(path) as file:
            return [
                Model(way, int(sizes.scale), file.decode(level=sizes.level), sizes.bytes_fetched)
                for sizes in level_sizes(file)
            ]


def _prefixes(path: Path, levels: Sequence[Model]) -> list[Model]:
    """Return the prefixes of an ordinary file that have the bytes, or the splats, of each level."""
    found: list[Model] = []
    with cogsplat.open(path) as file:
        counts = np.cumsum(file.chunks.splats, dtype=np.int64)
        for level in levels:
            size = min(level.bytes_fetched, file.file_length)
            prefix = decode_prefix(path, size, compensate=True)
            found.append(Model("prefix, same bytes", level.scale, prefix, size))
            chunks = int(np.argmin(np.abs(counts - len(level.splats)))) + 1
            prefix = file.decode(range(chunks), compensate=True)
            found.append(Model("prefix, same splats", level.scale, prefix))
    return found


def models(
    splats: Splats, cameras: Sequence[Camera], config: LevelsConfig, preset: str = DEFAULT_PRESET
) -> list[Model]:
    """Return the levels of a scene, trained as one file, and the models for comparison.

    Parameters
    ----------
    splats : Splats
        Source scene, with capture viewpoints.
    cameras : sequence of Camera
        Training views.
    config : LevelsConfig
        Scales, shares of splats and training steps of the levels.
    preset : str
        Preset of the ordinary file.
    """
    found = _trained(splats, cameras, config)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "ordinary.cogs"
        plain = cogsplat.EncodeConfig(threads=config.threads)
        cogsplat.encode(splats, path, cameras=cameras, preset=preset, config=plain)
        found += _prefixes(path, found)
    for scale, share in zip(config.scales, config.shares, strict=True):
        found += _trained(splats, cameras, replace(config, scales=(scale,), shares=(share,)))
    return sorted(found, key=lambda model: -model.scale)


def measure_quality(
    splats: Splats, of: Sequence[Model], tests: Sequence[Camera], *, lpips: Lpips | None = None
) -> list[ModelQuality]:
    """Measure every model at its own size against downscaled full-size renders of the source.

    Parameters
    ----------
    splats : Splats
        Source scene.
    of : sequence of Model
        Models to measure.
    tests : sequence of Camera
        Test views at full size.
    lpips : Lpips, optional
        Network that also measures LPIPS; by default only PSNR and SSIM are measured.
    """
    full = [render(splats, camera, RenderConfig()) for camera in tests]
    found = []
    for model in of:
        small = [camera.downscaled(model.scale) for camera in tests]
        targets = [downscale_picture(picture, model.scale) for picture in full]
        figures = picture_figures(model.splats, small, targets, lpips=lpips)
        found.append(ModelQuality(model, figures))
    return found


def rows(found: Sequence[ModelQuality]) -> list[Row]:
    """Return a table row per model with the quality at its own picture size."""
    return [
        (
            f"1/{model.scale}",
            model.way,
            f"{len(model.splats):,}",
            f"{model.bytes_fetched:,}" if model.bytes_fetched else "-",
            f"{figures.psnr_db:.2f}",
            f"{figures.worst_psnr_db:.2f}",
            f"{figures.ssim:.4f}",
            "-" if figures.lpips is None else f"{figures.lpips:.4f}",
        )
        for one in found
        for model, figures in [(one.model, one.figures)]
    ]


def main() -> None:
    """Measure the models for a scene given on the command line and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, prog="level_peers")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--eval-every", type=int, default=8)
    parser.add_argument("--scales", default="8,4,2,1", help="downscaling factor of each level")
    parser.add_argument("--shares", default="8%,25%,60%,100%", help="splats of each level")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--preset", choices=list(PRESETS), default=DEFAULT_PRESET)
    parser.add_argument("--lpips-weights", type=Path, help="also print LPIPS, with these weights")
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    train, tests = hold_out(cogsplat.read_cameras(given.cameras), given.eval_every)
    splats = cogsplat.read(given.scene).without_extras().drop_invalid()
    splats = splats.with_capture(capture_of_cameras(train))
    config = LevelsConfig(
        tuple(int(scale) for scale in given.scales.split(",")),
        tuple(float(share.removesuffix("%")) / 100 for share in given.shares.split(",")),
        steps=given.steps,
        threads=given.threads,
    )
    lpips = None if given.lpips_weights is None else read_lpips(given.lpips_weights)
    found = models(splats, train, config, given.preset)
    measured = measure_quality(splats, found, tests or train, lpips=lpips)
    print_line(f"{given.scene}: {len(tests or train)} views, {given.steps} steps a level")
    heads = ("pictures", "drawn from", "splats", "fetched B", "PSNR", "worst", "SSIM", "LPIPS")
    print_table(heads, rows(measured), left=2)


if __name__ == "__main__":
    main()
