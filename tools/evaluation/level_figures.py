"""Sizes of a file's levels, and the quality of their renders and of prefixes of another file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.layout import CODEBOOK_KINDS, SegmentKind
from cogsplat.formats.cogs.reader import CogsFile

from .lpips import Lpips
from .prefix_quality import decode_prefix

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class LevelSizes:
    """Splats and bytes that a reader of one level fetches.

    Parameters
    ----------
    level : int
        Number of the level; 0 is the coarsest.
    scale : float
        Width of full images divided by that of the level (SPEC 5.11).
    splats : int
        Splats drawn at the level.
    bytes_fetched : int
        Bytes of the preamble, root and pages, and of the level's segments.
    opacity_bytes : int
        Bytes among `bytes_fetched` of opacities that replace those of lower levels.
    left_out : int
        Splats of lower levels that are not drawn at this level.
    """

    level: int
    scale: float
    splats: int
    bytes_fetched: int
    opacity_bytes: int
    left_out: int

    def report(self) -> dict[str, object]:
        """Return the fields by their names in JSON output."""
        return asdict(self)


def level_sizes(file: CogsFile) -> list[LevelSizes]:
    """Return the splats and bytes of each level of an open file."""
    segments, until = file.segments, file.chunks.until
    index = file.file_length - int(segments.length.sum(dtype=np.uint64))
    chunk_kinds = (
        SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL, SegmentKind.ATTRIBUTES,
    )  # fmt: skip
    found: list[LevelSizes] = []
    for number, level in enumerate(file.root.levels):
        own = np.arange(file.num_chunks) < level.chunks
        drawn = own & ((until == 0) | (until > level.chunks))
        splats = int(file.chunks.splats[drawn].sum())
        of_chunk = np.isin(segments.kind, chunk_kinds)
        of_drawn = of_chunk & drawn[np.minimum(segments.owner, file.num_chunks - 1)]
        codebooks = np.isin(segments.kind, CODEBOOK_KINDS)
        opacities = 0
        for chunk in np.flatnonzero(drawn).tolist():
            first = sum(entry.chunks <= chunk for entry in file.root.levels)
            rows = file.chunk_rows(chunk).opacities[: max(number - first, 0)]
            opacities += int(segments.length[rows[-1]]) if rows else 0
        found.append(
            LevelSizes(
                level=number,
                scale=level.scale,
                splats=splats,
                bytes_fetched=index + int(segments.length[of_drawn | codebooks].sum()) + opacities,
                opacity_bytes=opacities,
                left_out=int(file.chunks.splats[own & ~drawn].sum()),
            )
        )
    return found


@dataclass(frozen=True)
class PictureFigures:
    """Quality of renders against target images, over several views.

    Parameters
    ----------
    psnr_db : float
        Mean PSNR, dB.
    worst_psnr_db : float
        Lowest PSNR, dB.
    ssim : float
        Mean SSIM.
    lpips : float or None
        Mean LPIPS; None without weights, or if an image is too small for the network.
    """

    psnr_db: float
    worst_psnr_db: float
    ssim: float
    lpips: float | None = None

    def report(self) -> dict[str, object]:
        """Return the measured fields by their names in JSON output, rounded."""
        fields = asdict(self).items()
        return {name: round(value, 4) for name, value in fields if value is not None}


def picture_figures(
    splats: Splats,
    cameras: Sequence[Camera],
    targets: Sequence[F32],
    threads: int = 0,
    *,
    lpips: Lpips | None = None,
) -> PictureFigures:
    """Render a scene and measure its quality against target images of the same cameras.

    Parameters
    ----------
    splats : Splats
        Scene to render.
    cameras : sequence of Camera
        Views.
    targets : sequence of (H, W, 3) float32
        Target image of each view, at least 11 px wide and high.
    threads : int
        Number of threads; 0 for all cores.
    lpips : Lpips, optional
        Network of LPIPS; None to skip LPIPS.
    """
    config = RenderConfig(threads=threads)
    pairs = [
        (render(splats, camera, config), target)
        for camera, target in zip(cameras, targets, strict=True)
    ]
    decibels = [psnr(picture, target) for picture, target in pairs]
    similarities = [ssim(picture, target) for picture, target in pairs]
    distance = None
    if lpips is not None and min(min(target.shape[:2]) for target in targets) >= (
        lpips.smallest_side
    ):
        distance = float(np.mean([_distance(lpips, *pair) for pair in pairs]))
    mean_ssim = float(np.mean(similarities))
    return PictureFigures(float(np.mean(decibels)), min(decibels), mean_ssim, distance)


@dataclass(frozen=True)
class LevelQuality:
    """Size and quality of a level, and the quality of a prefix of an ordinary file.

    Parameters
    ----------
    sizes : LevelSizes
    figures : PictureFigures
        Quality in pictures of the level's size.
    prefix : PictureFigures or None
        Quality, in the same pictures, of the prefix of an ordinary file with as many bytes as the
        level fetches, compensated; None without an ordinary file.
    prefix_splats : int or None
        Splats of this prefix.
    """

    sizes: LevelSizes
    figures: PictureFigures
    prefix: PictureFigures | None = None
    prefix_splats: int | None = None

    @property
    def is_beaten(self) -> bool:
        """Whether the prefix has at least the PSNR of the level."""
        return self.prefix is not None and self.prefix.psnr_db >= self.figures.psnr_db

    def report(self) -> dict[str, object]:
        """Return the figures by their names in JSON output."""
        return {
            **self.sizes.report(),
            **self.figures.report(),
            "prefix_psnr_db": None if self.prefix is None else round(self.prefix.psnr_db, 4),
            "prefix_splats": self.prefix_splats,
        }


def measure_levels(
    path: Path,
    cameras: Sequence[Camera],
    pictures: Sequence[F32],
    ordinary: Path | None = None,
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> list[LevelQuality]:
    """Measure each level of a file at its own picture size.

    Parameters
    ----------
    path : Path
        File with levels.
    cameras : sequence of Camera
        Test views of full size.
    pictures : sequence of (H, W, 3) float32
        Ground truth of each test view; it is averaged to the size of each level.
    ordinary : Path, optional
        File of the same scene without levels, to compare its prefixes.
    threads : int
        Number of threads, 0 for all cores.
    progress : Progress
        Called with ``measure``, levels done and levels.
    """
    found: list[LevelQuality] = []
    with cogsplat.open(path) as file:
        for sizes in level_sizes(file):
            scale = int(sizes.scale)
            targets = [downscale_picture(picture, scale) for picture in pictures]
            small = [camera.downscaled(scale) for camera in cameras]
            drawn = file.decode(level=sizes.level, threads=threads)
            quality = LevelQuality(sizes, picture_figures(drawn, small, targets, threads))
            if ordinary is not None:
                prefix = decode_prefix(
                    ordinary, sizes.bytes_fetched, compensate=True, threads=threads
                )
                beside = picture_figures(prefix, small, targets, threads)
                quality = replace(quality, prefix=beside, prefix_splats=len(prefix))
            found.append(quality)
            progress("measure", len(found), len(file.root.levels))
    return found


def _distance(lpips: Lpips, picture: F32, target: F32) -> float:
    """Return the LPIPS distance of two images."""
    return lpips.distance(lpips.features(picture), lpips.features(target))
