"""The full scene's own pictures, small, from a spread of views: what thinned scenes are held to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render_views
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import jitter

# Bounds of what pictures cost, in time and memory: pixels of one, and views of all.
PICTURE_PIXELS = 48_000
MOST_VIEWS = 192

# Weights of the golden ratio: the fractions of its multiples are spread evenly, however many.
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True, eq=False)
class ReferenceViews:
    """Views of a scene and what it looks like from them.

    Parameters
    ----------
    cameras : sequence of Camera
        Reduced to at most `PICTURE_PIXELS` px.
    kernels : sequence of float
        Variance added to projected covariances, px² of each reduced picture.
    pictures : sequence of (H, W, 3) float32
        0 to 1, over black.
    weights : (V,) float64
        What a view counts; the given views and their jittered copies sum to 1 each.
    given : int
        Views before the first jittered copy.
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.
    """

    cameras: Sequence[Camera]
    kernels: Sequence[float]
    pictures: Sequence[NDArray[np.float32]]
    weights: NDArray[np.float64]
    given: int
    near_plane: float

    def sample(self, count: int, turn: int) -> list[int]:
        """Return about `count` views, given and jittered in proportion, others at every turn.

        Parameters
        ----------
        count : int
            At least 1; all views where there are no more.
        turn : int
            Each turn starts elsewhere; over many, all views come equally often.
        """
        total = len(self.cameras)
        if count >= total:
            return list(range(total))
        phase = turn * _GOLDEN % 1.0
        chosen: list[int] = []
        for first, size in ((0, self.given), (self.given, total - self.given)):
            if size:
                wanted = max(1, round(count * size / total))
                chosen += [first + int((k + phase) * size / wanted) for k in range(wanted)]
        return chosen


def _reduced(camera: Camera) -> tuple[Camera, int]:
    """Return a camera that sees the same in fewer pixels, and by how many each side shrank."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / PICTURE_PIXELS))
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
    if len(views) <= most:
        return list(views)
    return [views[k * len(views) // most] for k in range(most)]


def render_references(
    splats: Splats,
    cameras: Sequence[Camera],
    *,
    jittered: bool = True,
    near_plane: float = NEAR,
    threads: int = 0,
    progress: Progress = silent,
) -> ReferenceViews:
    """Draw the full scene.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        In the frame of the means, at least one; of more than `MOST_VIEWS`, copies included, an
        even choice is drawn.
    jittered : bool
        Whether the copies that step back and turn (`view_sets.jitter`) are drawn as well.
    near_plane : float
        Scene units.
    threads : int
        0 for every core this process may use. The pictures do not depend on it.
    progress : Progress
        Called with ``("reference views", views done, views)``.

    Returns
    -------
    ReferenceViews

    Raises
    ------
    ValueError
        No cameras.
    """
    if not cameras:
        raise ValueError("0 cameras, expected at least 1")
    if jittered:
        # A camera has two copies.
        chosen = _thinned(cameras, MOST_VIEWS // 3)
        copies = jitter(splats, chosen)
    else:
        chosen, copies = _thinned(cameras, MOST_VIEWS), []
    reduced = [_reduced(camera) for camera in [*chosen, *copies]]
    info = splats.info
    views = [camera for camera, _ in reduced]
    kernels = [info.kernel_px / (factor * factor) for _, factor in reduced]
    pictures: list[NDArray[np.float32]] = []
    # Views of one factor are drawn together; factors come in runs.
    start = 0
    progress("reference views", 0, len(views))
    while start < len(views):
        stop = start
        while stop < len(views) and kernels[stop] == kernels[start] and stop < start + 16:
            stop += 1
        config = RenderConfig(
            kernel_px=kernels[start],
            antialiased=info.antialiased,
            near_plane=near_plane,
            threads=threads,
        )
        drawn = render_views(splats, views[start:stop], config)
        pictures += [np.clip(picture, np.float32(0.0), np.float32(1.0)) for picture in drawn]
        start = stop
        progress("reference views", len(pictures), len(views))
    weights = np.concatenate(
        [np.full(len(members), 1.0 / len(members)) for members in (chosen, copies) if members]
    )
    return ReferenceViews(views, kernels, pictures, weights, len(chosen), near_plane)
