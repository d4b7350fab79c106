"""PSNR and SSIM between renders of two scenes, in test, close and roaming views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from html import escape

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.close_views import ViewDistance, close_views, view_distances
from cogsplat.codec.views.roam_views import roam

# Side of SSIM's window (Wang et al. 2004), px.
_SMALLEST_SIDE = 11


@dataclass(frozen=True)
class ViewQuality:
    """PSNR and SSIM between two scenes in one view.

    Parameters
    ----------
    view : str
        Name of the camera.
    psnr_db : float
        PSNR, dB; 100 for identical images.
    ssim : float
        SSIM.
    distance : float or None
        Distance of the camera from what it shows, scene units; None where it was not measured.
    """

    view: str
    psnr_db: float
    ssim: float
    distance: float | None = None


@dataclass(frozen=True, repr=False)
class Comparison:
    """PSNR and SSIM between two scenes in several views.

    Parameters
    ----------
    test : tuple of ViewQuality
        Quality in the given cameras.
    close : tuple of ViewQuality
        Quality in close views of some cameras (`close_views.view_distances`).
    roaming : tuple of ViewQuality
        Quality in views off the capture path, derived from the cameras (`roam_views.roam`).
    """

    test: tuple[ViewQuality, ...]
    close: tuple[ViewQuality, ...]
    roaming: tuple[ViewQuality, ...]

    def __repr__(self) -> str:
        worst = f"lowest {self.worst.psnr_db:.2f} dB in {self.worst.view!r}"
        test = f"{mean_psnr_db(self.test):.2f} dB, SSIM {mean_ssim(self.test):.4f}"
        close = f"close {mean_psnr_db(self.close):.2f} dB; " if self.close else ""
        roaming = f"roaming {mean_psnr_db(self.roaming):.2f} dB"
        return f"Comparison({test}, {worst}; {close}{roaming})"

    def _repr_html_(self) -> str:
        """Return an HTML table of the test views for notebooks."""
        rows = "".join(
            f"<tr><td>{escape(one.view)}</td><td>{one.psnr_db:.2f}</td><td>{one.ssim:.4f}</td></tr>"
            for one in self.test
        )
        return f"<table><tr><th>view</th><th>PSNR, dB</th><th>SSIM</th></tr>{rows}</table>"

    @property
    def worst(self) -> ViewQuality:
        """The test view with the lowest PSNR."""
        return worst_view(self.test)


def mean_psnr_db(qualities: Sequence[ViewQuality]) -> float:
    """Return the mean PSNR of some views, dB."""
    return sum(quality.psnr_db for quality in qualities) / len(qualities)


def mean_ssim(qualities: Sequence[ViewQuality]) -> float:
    """Return the mean SSIM of some views."""
    return sum(quality.ssim for quality in qualities) / len(qualities)


def worst_view(qualities: Sequence[ViewQuality]) -> ViewQuality:
    """Return the view with the lowest PSNR, the first of several."""
    return min(qualities, key=lambda quality: quality.psnr_db)


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
    """Measure PSNR and SSIM between two scenes in each view.

    Each scene is rendered with the kernel in its `Splats.info`. Where one of them knows its capture
    viewpoints, they are used for both.

    Parameters
    ----------
    reference, other : Splats
        Scenes to compare.
    cameras : sequence of Camera
        Views in the scenes' world frame; at least one, with sides of at least 11 px.
    background : tuple of float
        RGB colour of the background.
    ssim_border : str
        One of `metrics.SSIM_BORDERS`.
    threads : int
        Number of threads, 0 for all cores; the results are equal for any number.
    progress : Progress
        Called with `stage`, views done and views.
    stage : str
        Name of the stage for `progress`.

    Returns
    -------
    tuple of ViewQuality
        Quality in the order of the cameras.

    Raises
    ------
    DataError
        ``no-cameras``; ``view-too-small``; ``cameras-see-nothing``: every view of the reference
        shows background only.
    """
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    if not cameras:
        raise DataError("no-cameras", "0 cameras to compare with, expected at least 1")
    for camera in cameras:
        if min(camera.width, camera.height) < _SMALLEST_SIDE:
            raise DataError(
                "view-too-small",
                f"camera {camera.name!r}: {camera.width}x{camera.height} px, expected sides of "
                f"at least {_SMALLEST_SIDE} px",
            )
    config = RenderConfig(background=background, threads=1)
    reference, other = share_capture(reference, other)

    def measure(camera: Camera) -> tuple[ViewQuality, bool]:
        expected = render(reference, camera, config)
        found = render(other, camera, config)
        has_splats = bool((expected != np.array(background, np.float32)).any())
        similarity = ssim(expected, found, border=ssim_border)
        return ViewQuality(camera.name, psnr(expected, found), similarity), has_splats

    qualities: list[ViewQuality] = []
    any_splats = False
    progress(stage, 0, len(cameras))
    for quality, has_splats in ordered_map(measure, cameras, thread_count(threads)):
        qualities.append(quality)
        any_splats |= has_splats
        progress(stage, len(qualities), len(cameras))
    if not any_splats:
        raise DataError(
            "cameras-see-nothing",
            f"{len(cameras)} views of the reference show background only, expected some splats",
        )
    return tuple(qualities)


def share_capture(reference: Splats, other: Splats) -> tuple[Splats, Splats]:
    """Return two versions of a scene, both with the capture viewpoints that either knows.

    A file says how large the pixels of training were and the PLY that it was made of may not: their
    pictures would differ by the drawing and not by the splats.
    """
    return (
        reference.with_capture(other.info.capture),
        other.with_capture(reference.info.capture),
    )


def compare(
    reference: Splats,
    other: Splats,
    cameras: Sequence[Camera],
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ssim_border: str = "valid",
    close: bool = True,
    threads: int = 0,
    progress: Progress = silent,
) -> Comparison:
    """Measure PSNR and SSIM between two scenes in test, close and roaming views.

    Parameters
    ----------
    reference, other, cameras, background, ssim_border, threads
        See `view_qualities`.
    close : bool
        Whether to measure in close views as well, and the distance of every test view.
    progress : Progress
        Called with the stages ``test``, ``close`` and ``roam``.

    Returns
    -------
    Comparison
        Quality in every view.

    Raises
    ------
    DataError
        See `view_qualities`.
    """
    distances = view_distances(reference, cameras, threads=threads) if close else []
    near = close_views(distances)
    measure = partial(
        view_qualities,
        reference,
        other,
        background=background,
        ssim_border=ssim_border,
        threads=threads,
        progress=progress,
    )
    test = measure(cameras, stage="test")
    closer = measure([view.camera for view in near], stage="close") if near else ()
    roaming = measure(roam(reference, cameras), stage="roam")
    return Comparison(_at(test, distances), _at(closer, near), roaming)


def _at(
    qualities: tuple[ViewQuality, ...], views: Sequence[ViewDistance]
) -> tuple[ViewQuality, ...]:
    """Return qualities with the distance of each view, as far as distances were measured."""
    if not views:
        return qualities
    return tuple(
        replace(quality, distance=view.distance)
        for quality, view in zip(qualities, views, strict=True)
    )
