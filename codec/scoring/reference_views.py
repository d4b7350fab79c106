"""Reference views: small renders of the full scene, to compare its prefixes with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.low_discrepancy import STEP_1D
from cogsplat.codec.views.roam_views import jitter

PICTURE_PIXELS = 48_000
"""Pixels of one reference view at most; bounds time and memory."""
MAX_VIEWS = 192
"""Number of reference views at most, jittered copies included; bounds time and memory."""


@dataclass(frozen=True, eq=False)
class ReferenceViews:
    """Reference views of a scene: reduced cameras and the scene's render in each.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras whose pictures are reduced, by default to at most `PICTURE_PIXELS`: the given
        cameras, then their jittered copies.
    reductions : sequence of float
        Factor by which each picture is reduced, per axis.
    pictures : sequence of (H, W, 3) float32
        Renders over black, 0 to 1.
    weights : (V,) float64
        Weight of each view in a mean over views. The weights of the given views sum to 1, and so
        do those of the jittered copies.
    given : int
        Number of given cameras.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    """

    cameras: Sequence[Camera]
    reductions: Sequence[float]
    pictures: Sequence[NDArray[np.float32]]
    weights: NDArray[np.float64]
    given: int
    near_plane: float

    def sample(self, count: int, iteration: int) -> list[int]:
        """Return the numbers of the views to draw in one iteration of an optimisation.

        Parameters
        ----------
        count : int
            Approximate number of views, at least 1; all views if there are no more.
        iteration : int
            Number of the iteration, from 0. Over many iterations all views occur equally often.

        Returns
        -------
        list of int
            Numbers spread evenly over the given views, then over the jittered copies. Each
            group gets a part of `count` proportional to its size, at least one view.
        """
        total = len(self.cameras)
        if count >= total:
            return list(range(total))
        phase = iteration * STEP_1D % 1.0
        chosen: list[int] = []
        for first, size in ((0, self.given), (self.given, total - self.given)):
            if size:
                wanted = max(1, round(count * size / total))
                chosen += [first + int((k + phase) * size / wanted) for k in range(wanted)]
        return chosen


def _reduce(camera: Camera, pixels: int) -> tuple[Camera, int]:
    """Reduce a camera's picture to at most `pixels`; return it and the integer reduction factor."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / pixels))
    factor = max(1, min(factor, camera.width, camera.height))
    return camera.downscaled(factor), factor


def _evenly_spaced(views: Sequence[Camera], max_views: int) -> list[Camera]:
    """Return at most `max_views` views, at equal distances in the sequence."""
    if len(views) <= max_views:
        return list(views)
    return [views[k * len(views) // max_views] for k in range(max_views)]


def _picture(
    view: tuple[Camera, float], splats: Splats, *, near_plane: float, threads: int
) -> NDArray[np.float32]:
    """Render one view; `view` is its camera and the factor by which its picture is reduced."""
    camera, reduction = view
    config = RenderConfig(near_plane=near_plane, reduction=reduction, threads=threads)
    picture = render(splats, camera, config)
    return np.clip(picture, np.float32(0.0), np.float32(1.0), out=picture)


def render_references(
    splats: Splats,
    cameras: Sequence[Camera],
    *,
    jittered: bool = True,
    pixels: int = PICTURE_PIXELS,
    near_plane: float = NEAR,
    threads: int = 0,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> ReferenceViews:
    """Render the full scene in reduced views of given cameras.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel of ``splats.info``.
    cameras : sequence of Camera
        Cameras in the frame of the means, at least one. If the cameras and their copies exceed
        `MAX_VIEWS`, an evenly spread sample of the cameras is used.
    jittered : bool
        Whether to draw jittered copies of the cameras (`roam_views.jitter`) too.
    pixels : int
        Pixels of one picture at most, at least 1.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    threads : int
        Number of threads; 0 for every core this process may use. Pictures do not depend on it.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("reference views", views done, views)``; raising from it stops the work.

    Returns
    -------
    ReferenceViews

    Raises
    ------
    ValueError
        There are no cameras, or `pixels` is below 1.

    Examples
    --------
    >>> from cogsplat.codec.scoring.reference_views import render_references
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> references = render_references(splats, cameras)
    >>> len(references.pictures), references.given
    (6, 2)
    """
    if not cameras:
        raise ValueError("0 cameras, expected at least 1")
    if pixels < 1:
        raise ValueError(f"{pixels} pixels, expected at least 1")
    if jittered:
        # Each camera has two jittered copies.
        chosen = _evenly_spaced(cameras, MAX_VIEWS // 3)
        copies = jitter(splats, chosen)
    else:
        chosen, copies = _evenly_spaced(cameras, MAX_VIEWS), []
    reduced = [_reduce(camera, pixels) for camera in [*chosen, *copies]]
    views = [camera for camera, _ in reduced]
    reductions = [float(factor) for _, factor in reduced]
    threads = thread_count(threads)
    by_view = executor is not None or len(views) >= threads
    if executor is None:
        executor = LocalThreads(threads if by_view else 1)
    pictures: list[NDArray[np.float32]] = []
    progress("reference views", 0, len(views))
    drawn = executor.map(
        partial(_picture, near_plane=near_plane, threads=1 if by_view else threads),
        zip(views, reductions, strict=True),
        splats,
    )
    for picture in drawn:
        pictures.append(picture)
        progress("reference views", len(pictures), len(views))
    weights = np.concatenate(
        [np.full(len(members), 1.0 / len(members)) for members in (chosen, copies) if members]
    )
    return ReferenceViews(views, reductions, pictures, weights, len(chosen), near_plane)
