"""Reference views: small renders of the full scene, which prefixes of it are compared with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from cogsplat.codec.views.view_sets import jitter

PICTURE_PIXELS = 48_000
"""Most pixels of one reference view. Bounds time and memory, as `MOST_VIEWS` does."""
MOST_VIEWS = 192
"""Most reference views, jittered copies included."""


@dataclass(frozen=True, eq=False)
class ReferenceViews:
    """Views of a scene and its render in each of them.

    Parameters
    ----------
    cameras : sequence of Camera
        Reduced to at most `PICTURE_PIXELS` px, or fewer.
    kernels : sequence of float
        Variance added to projected covariances, px² of each reduced picture.
    pictures : sequence of (H, W, 3) float32
        0 to 1, over black.
    weights : (V,) float64
        Of each view in means over views. Those of the given views sum to 1, and so do those of
        their jittered copies.
    given : int
        How many views are given ones; they stand before the jittered copies.
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.
    """

    cameras: Sequence[Camera]
    kernels: Sequence[float]
    pictures: Sequence[NDArray[np.float32]]
    weights: NDArray[np.float64]
    given: int
    near_plane: float

    def sample(self, count: int, iteration: int) -> list[int]:
        """Return the numbers of about `count` views, others in every iteration.

        Parameters
        ----------
        count : int
            At least 1; all views where there are no more.
        iteration : int
            From 0. Over many iterations all views come equally often.

        Returns
        -------
        list of int
            Given views and jittered copies in proportion, each spread evenly over its sequence.
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


def _reduced(camera: Camera, pixels: int) -> tuple[Camera, int]:
    """Return a camera of the same view in at most so many pixels, and the reduction factor."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / pixels))
    factor = max(1, min(factor, camera.width, camera.height))
    small = replace(
        camera,
        width=camera.width // factor,
        height=camera.height // factor,
        fx=camera.fx / factor,
        fy=camera.fy / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )
    return small, factor


def _thinned(views: Sequence[Camera], most: int) -> list[Camera]:
    """Return at most `most` views, spread evenly over the sequence."""
    if len(views) <= most:
        return list(views)
    return [views[k * len(views) // most] for k in range(most)]


def _picture(
    view: tuple[Camera, float], splats: Splats, *, near_plane: float, threads: int
) -> NDArray[np.float32]:
    """Return the picture of a camera with its kernel, px²."""
    camera, kernel_px = view
    config = RenderConfig(
        kernel_px, splats.info.antialiased, near_plane=near_plane, threads=threads
    )
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
    """Render the full scene in its reference views.

    Parameters
    ----------
    splats : Splats
        Drawn with the kernel and anti-aliasing of ``splats.info``.
    cameras : sequence of Camera
        In the frame of the means, at least one. Where they and their copies are more than
        `MOST_VIEWS`, evenly spread ones are taken.
    jittered : bool
        Whether jittered copies of the cameras (`view_sets.jitter`) are drawn as well.
    pixels : int
        Most pixels of one picture, at least 1.
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.
    threads : int
        0 for every core this process may use. The pictures do not depend on it.
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.
    progress : Progress
        Called with ``("reference views", views done, views)``; raising from it stops the work.

    Returns
    -------
    ReferenceViews

    Raises
    ------
    ValueError
        No cameras, or no pixels.

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
        chosen = _thinned(cameras, MOST_VIEWS // 3)
        copies = jitter(splats, chosen)
    else:
        chosen, copies = _thinned(cameras, MOST_VIEWS), []
    reduced = [_reduced(camera, pixels) for camera in [*chosen, *copies]]
    info = splats.info
    views = [camera for camera, _ in reduced]
    kernels = [info.kernel_px / (factor * factor) for _, factor in reduced]
    threads = thread_count(threads)
    by_view = executor is not None or len(views) >= threads
    if executor is None:
        executor = LocalThreads(threads if by_view else 1)
    pictures: list[NDArray[np.float32]] = []
    progress("reference views", 0, len(views))
    drawn = executor.map(
        partial(_picture, near_plane=near_plane, threads=1 if by_view else threads),
        zip(views, kernels, strict=True),
        splats,
    )
    for picture in drawn:
        pictures.append(picture)
        progress("reference views", len(pictures), len(views))
    weights = np.concatenate(
        [np.full(len(members), 1.0 / len(members)) for members in (chosen, copies) if members]
    )
    return ReferenceViews(views, kernels, pictures, weights, len(chosen), near_plane)
