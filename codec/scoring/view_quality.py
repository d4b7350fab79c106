"""PSNR and SSIM between renders of two scenes, in held-out and roaming views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import roam

# SSIM's window (Wang et al. 2004) must fit.
_SMALLEST_SIDE = 11


@dataclass(frozen=True)
class ViewQuality:
    """PSNR and SSIM between two scenes in one view.

    Parameters
    ----------
    view : str
        The camera's name.
    psnr_db : float
        At most 100, which stands for identical.
    ssim : float
    """

    view: str
    psnr_db: float
    ssim: float


@dataclass(frozen=True, repr=False)
class Comparison:
    """PSNR and SSIM between two scenes in several views.

    Parameters
    ----------
    held_out, roaming : tuple of ViewQuality
        Of the cameras given, and of views off the capture path made from them (`view_sets.roam`).
    """

    held_out: tuple[ViewQuality, ...]
    roaming: tuple[ViewQuality, ...]

    def __repr__(self) -> str:
        worst = f"lowest {self.worst.psnr_db:.2f} dB in {self.worst.view!r}"
        held_out = f"{mean_psnr_db(self.held_out):.2f} dB, SSIM {mean_ssim(self.held_out):.4f}"
        return f"Comparison({held_out}, {worst}; roaming {mean_psnr_db(self.roaming):.2f} dB)"

    def _repr_html_(self) -> str:
        """Return a table of the given views for notebooks."""
        rows = "".join(
            f"<tr><td>{escape(one.view)}</td><td>{one.psnr_db:.2f}</td><td>{one.ssim:.4f}</td></tr>"
            for one in self.held_out
        )
        return f"<table><tr><th>view</th><th>PSNR, dB</th><th>SSIM</th></tr>{rows}</table>"

    @property
    def worst(self) -> ViewQuality:
        """The held-out view of the lowest PSNR."""
        return min(self.held_out, key=lambda quality: quality.psnr_db)


def mean_psnr_db(qualities: Sequence[ViewQuality]) -> float:
    """Return the mean of the views' dB."""
    return sum(quality.psnr_db for quality in qualities) / len(qualities)


def mean_ssim(qualities: Sequence[ViewQuality]) -> float:
    """Return the mean of the views' SSIM."""
    return sum(quality.ssim for quality in qualities) / len(qualities)


def view_qualities(
    reference: Splats,
    other: Splats,
    cameras: Sequence[Camera],
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ssim_border: str = "valid",
    threads: int = 0,
    progress: Progress = silent,
    stage: str = "compare",
) -> tuple[ViewQuality, ...]:
    """Compare two scenes view by view, each rendered with the kernel that it states.

    Parameters
    ----------
    reference, other : Splats
    cameras : sequence of Camera
        In the frame of the means; at least one, of 11 px a side or more.
    background : tuple of float
        RGB behind the splats.
    ssim_border : str
        One of `metrics.SSIM_BORDERS`.
    threads : int
        0 for all cores; the figures do not depend on it.
    progress : Progress
        Called with `stage`, views done and views.

    Returns
    -------
    tuple of ViewQuality
        In the order of the cameras.

    Raises
    ------
    DataError
        ``no-cameras``; ``view-too-small``; ``cameras-see-nothing``: no view of the reference
        shows anything but background.
    """
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    if not cameras:
        raise DataError("no-cameras", "0 cameras to compare with, expected at least 1")
    for camera in cameras:
        if min(camera.width, camera.height) < _SMALLEST_SIDE:
            raise DataError(
                "view-too-small",
                f"camera {camera.name!r}: {camera.width}x{camera.height} px, expected at least "
                f"{_SMALLEST_SIDE} a side to compare by",
            )
    configs = [
        RenderConfig(
            kernel_px=splats.info.kernel_px,
            antialiased=splats.info.antialiased,
            background=background,
            threads=1,
        )
        for splats in (reference, other)
    ]

    def measure(camera: Camera) -> tuple[ViewQuality, bool]:
        expected = render(reference, camera, configs[0])
        found = render(other, camera, configs[1])
        shows = bool((expected != np.array(background, np.float32)).any())
        likeness = ssim(expected, found, border=ssim_border)
        return ViewQuality(camera.name, psnr(expected, found), likeness), shows

    qualities: list[ViewQuality] = []
    seen = False
    progress(stage, 0, len(cameras))
    for quality, shows in ordered_map(measure, cameras, thread_count(threads)):
        qualities.append(quality)
        seen |= shows
        progress(stage, len(qualities), len(cameras))
    if not seen:
        raise DataError(
            "cameras-see-nothing",
            f"{len(cameras)} views of the reference show nothing but background, expected some "
            "splats in them",
        )
    return tuple(qualities)


def compare(
    reference: Splats,
    other: Splats,
    cameras: Sequence[Camera],
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ssim_border: str = "valid",
    threads: int = 0,
    progress: Progress = silent,
) -> Comparison:
    """Compare two scenes on held-out cameras and on roaming views made from them.

    Parameters
    ----------
    reference, other, cameras, background, ssim_border, threads
        See `view_qualities`.
    progress : Progress
        Called with the stages ``held-out`` and ``roam``.

    Returns
    -------
    Comparison

    Raises
    ------
    DataError
        See `view_qualities`.
    """
    sets = {"held-out": list(cameras), "roam": roam(reference, cameras)}
    held_out, roaming = (
        view_qualities(
            reference,
            other,
            views,
            background=background,
            ssim_border=ssim_border,
            threads=threads,
            progress=progress,
            stage=stage,
        )
        for stage, views in sets.items()
    )
    return Comparison(held_out, roaming)
