"""What each level of a file takes, and how its pictures compare with what they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile

from .lpips import Lpips

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class LevelSizes:
    """What a reader of one level fetches.

    Parameters
    ----------
    level : int
    scale : float
    splats : int
        That the level draws.
    bytes_fetched : int
        Preamble, root and pages, and the segments that the level takes.
    opacity_bytes : int
        Of these, opacities that differ from those of lower levels.
    left_out : int
        Splats of lower levels that this one does not draw.
    """

    level: int
    scale: float
    splats: int
    bytes_fetched: int
    opacity_bytes: int
    left_out: int

    def report(self) -> dict[str, object]:
        """Return the fields as JSON output has them."""
        return asdict(self)


def level_sizes(file: CogsFile) -> list[LevelSizes]:
    """Return what each level of an open file takes."""
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
        taken = of_chunk & drawn[np.minimum(segments.owner, file.num_chunks - 1)]
        books = np.isin(segments.kind, [3, 4, 5, 6])
        opacities = 0
        for chunk in np.flatnonzero(drawn).tolist():
            first = sum(entry.chunks <= chunk for entry in file.root.levels)
            rows = file.rows_of(chunk).opacities[: max(number - first, 0)]
            opacities += int(segments.length[rows[-1]]) if rows else 0
        found.append(
            LevelSizes(
                level=number,
                scale=level.scale,
                splats=splats,
                bytes_fetched=index + int(segments.length[taken | books].sum()) + opacities,
                opacity_bytes=opacities,
                left_out=int(file.chunks.splats[own & ~drawn].sum()),
            )
        )
    return found


@dataclass(frozen=True)
class PictureFigures:
    """How pictures compare with what they stand for.

    Parameters
    ----------
    psnr_db, worst_psnr_db : float
        Mean and least over the views.
    ssim : float
        Mean over the views.
    lpips : float or None
        Mean over the views; None without weights, and for pictures that are too small for them.
    """

    psnr_db: float
    worst_psnr_db: float
    ssim: float
    lpips: float | None = None

    def report(self) -> dict[str, object]:
        """Return the fields that were measured as JSON output has them, rounded."""
        fields = asdict(self).items()
        return {name: round(value, 4) for name, value in fields if value is not None}


def compared(
    splats: Splats,
    cameras: Sequence[Camera],
    targets: Sequence[F32],
    threads: int = 0,
    *,
    lpips: Lpips | None = None,
) -> PictureFigures:
    """Return how the pictures of a scene compare with others of the same cameras.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
    targets : sequence of (H, W, 3) float32
        At least 11 px wide and high.
    threads : int
    lpips : Lpips, optional
        Weights of the network to measure LPIPS with.
    """
    info = splats.info
    config = RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased, threads=threads)
    pairs = [
        (render(splats, camera, config), target)
        for camera, target in zip(cameras, targets, strict=True)
    ]
    decibels = [psnr(picture, target) for picture, target in pairs]
    alike = [ssim(picture, target) for picture, target in pairs]
    distance = None
    if lpips is not None and min(min(target.shape[:2]) for target in targets) >= (
        lpips.smallest_side
    ):
        distance = float(np.mean([_distance(lpips, *pair) for pair in pairs]))
    return PictureFigures(float(np.mean(decibels)), min(decibels), float(np.mean(alike)), distance)


def _distance(lpips: Lpips, picture: F32, target: F32) -> float:
    return lpips.distance(lpips.features(picture), lpips.features(target))
