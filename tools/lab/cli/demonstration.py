"""Demonstration: a synthetic scene is encoded, and its prefixes are measured and drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, StageCost, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.roam_views import roam
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.workflow.output_files import check_outputs

SHARES: Final = (0.03, 0.06, 0.12, 0.25, 1.0)
"""Prefixes in the film strip, as shares of the file."""

EVERY: Final = 8
"""Interval of the held-out cameras, which the encoder does not get."""

# Index of the held-out camera whose picture shows all objects.
_SHOWN: Final = 3

# Costs per splat of generating and writing, and of decoding and writing, in the unit of
# `codec.encode.stage_costs`; and renders per view of a comparison, including its roaming views.
_SECONDS_A_SPLAT: Final = (1.5e-5, 5e-6)
_RENDERS: Final = 4


@dataclass(frozen=True)
class DemoFiles:
    """Paths of the files of a demonstration in its folder."""

    folder: Path

    @property
    def scene(self) -> Path:
        """Path of the synthetic scene, PLY."""
        return self.folder / "scene.ply"

    @property
    def cameras(self) -> Path:
        """Path of the cameras of the scene."""
        return self.folder / "cameras.json"

    @property
    def cogs(self) -> Path:
        """Path of the encoded scene."""
        return self.folder / "scene.cogs"

    @property
    def decoded(self) -> Path:
        """Path of the decoded scene, PLY."""
        return self.folder / "decoded.ply"

    @property
    def strip(self) -> Path:
        """Path of the film strip, PNG."""
        return self.folder / "filmstrip.png"

    def all(self) -> tuple[Path, ...]:
        """Return the paths of all files."""
        return self.scene, self.cameras, self.cogs, self.decoded, self.strip


@dataclass(frozen=True)
class DemoPrefix:
    """Splats and PSNR of a prefix of the file.

    Parameters
    ----------
    share : float
        Share of the file.
    size_bytes, splats : int
        Bytes and splats of the prefix.
    held_out_db, worst_db, roam_db : float
        PSNR against the synthetic scene, dB: mean and worst of the held-out views, mean of the
        roaming views.
    """

    share: float
    size_bytes: int
    splats: int
    held_out_db: float
    worst_db: float
    roam_db: float


@dataclass(frozen=True)
class Demo:
    """Results of a demonstration.

    Parameters
    ----------
    files : DemoFiles
    splats : int
        Splats of the synthetic scene.
    scene_bytes, cogs_bytes : int
        Sizes of the PLY and of the COGS file.
    prefixes : tuple of DemoPrefix
        One for each of `SHARES`.
    """

    files: DemoFiles
    splats: int
    scene_bytes: int
    cogs_bytes: int
    prefixes: tuple[DemoPrefix, ...]


def stage_costs(splats: int) -> list[StageCost]:
    """Return the expected costs of the stages of `run`."""
    from cogsplat.codec.encode import stage_costs as encoding
    from cogsplat.codec.encode.request import EncodeRequest

    train, held = hold_out(synth_cameras(), EVERY)
    encoded = encoding.stage_costs(splats, EncodeRequest(cameras=train))
    compared = len(SHARES) * _RENDERS * encoding.render_cost(splats, held)
    made, decoded = (seconds * splats for seconds in _SECONDS_A_SPLAT)
    return [
        StageCost("synth", made),
        *encoded,
        StageCost("decode", decoded),
        StageCost("compare", compared),
    ]


def run(
    folder: Path,
    *,
    splats: int,
    threads: int = 0,
    force: bool = False,
    before_encoding: Callable[[Progress], None] | None = None,
    progress: Progress = silent,
) -> Demo:
    """Make a scene, encode it, measure its prefixes and draw the film strip.

    Parameters
    ----------
    folder : Path
        Folder for the files; created if missing.
    splats : int
        Size of the scene.
    threads : int
        Number of threads; 0 for all cores.
    force : bool
        Whether files of an earlier run are replaced.
    before_encoding : callable, optional
        Function called with `progress` after the scene is made.
    progress : Progress
        Receives the stages.

    Returns
    -------
    Demo

    Raises
    ------
    CogsplatError
        A file cannot be written, or exists without `force`.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.quality_prediction import PrefixEvaluator
    from cogsplat.tools.evaluation.prefix_quality import decode_prefix
    from cogsplat.tools.pictures.filmstrip import filmstrip
    from cogsplat.tools.pictures.png import write_png

    files = DemoFiles(folder)
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    check_outputs(*files.all(), force=force)

    progress("synth", 0, 1)
    scene, cameras = synth(splats), synth_cameras()
    cogsplat.write(scene, files.scene, force=force)
    write_cameras_json(cameras, files.cameras, force=force)
    progress("synth", 1, 1)

    if before_encoding is not None:
        before_encoding(progress)
    train, held = hold_out(cameras, EVERY)
    config = EncodeConfig(threads=threads)
    size = cogsplat.encode(
        scene, files.cogs, cameras=train, config=config, force=force, progress=progress
    ).size_bytes
    progress("write", 1, 1)

    decoded = cogsplat.decode(files.cogs, threads=threads, progress=progress)
    cogsplat.write(decoded, files.decoded, force=force)
    progress("decode", 1, 1)

    draw = _renderer(held[_SHOWN], threads)
    evaluator = PrefixEvaluator(scene, [*held, *roam(scene, held)], threads)
    prefixes, pictures = [], []
    for step, share in enumerate(SHARES):
        progress("compare", step, len(SHARES))
        part = decoded
        if share < 1.0:
            part = decode_prefix(files.cogs, int(share * size), compensate=True, threads=threads)
        prefixes.append(
            _prefix_result(evaluator.views_db(part), len(held), part, share, int(share * size))
        )
        pictures.append(draw(part))
    progress("compare", len(SHARES), len(SHARES))

    scene_bytes = files.scene.stat().st_size
    captions = [_caption(prefix) for prefix in prefixes]
    captions.append([f"original, {_size(scene_bytes)}", f"{splats:,} splats", "PLY"])
    strip = filmstrip(
        [*pictures, draw(scene)],
        captions,
        title=f"One .cogs file of {_size(size)} as its bytes arrive, with compensation, in "
        "a held-out view",
    )
    write_png(strip, files.strip, force=force)
    progress("film-strip", 1, 1)
    return Demo(files, splats, scene_bytes, size, tuple(prefixes))


def _prefix_result(
    views_db: list[float], held: int, part: Splats, share: float, size: int
) -> DemoPrefix:
    """Return a prefix with its PSNRs: `views_db` has `held` held-out views, then roaming views."""
    return DemoPrefix(
        share=share,
        size_bytes=size,
        splats=len(part),
        held_out_db=float(np.mean(views_db[:held])),
        worst_db=min(views_db[:held]),
        roam_db=float(np.mean(views_db[held:])),
    )


def _renderer(camera: Camera, threads: int) -> Callable[[Splats], NDArray[np.float32]]:
    """Return a function that renders splats in a camera."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    def draw(splats: Splats) -> NDArray[np.float32]:
        config = RenderConfig(threads=threads)
        return render(splats, replace(camera, name=""), config)

    return draw


def _caption(prefix: DemoPrefix) -> list[str]:
    """Return the lines under the picture of a prefix."""
    return [
        f"{prefix.share:.0%}, {_size(prefix.size_bytes)}",
        f"{prefix.splats:,} splats",
        f"PSNR {prefix.held_out_db:.1f} dB held-out",
    ]


def _size(size_bytes: int) -> str:
    """Return a byte count as text."""
    from cogsplat.tools.terminal.output import size_text

    return size_text(size_bytes)
