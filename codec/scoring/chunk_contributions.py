"""Contribution of each chunk of a scene to each view, as a share of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.blend_weights import WEIGHT, add_weights
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.tiles import tile_lists
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

MAX_PIXELS: Final = 20_000
"""Pixels of a measured view at most; larger ones are reduced, which suffices for whole chunks."""


def chunk_contributions(
    splats: Splats,
    chunks: NDArray[np.int64],
    count: int,
    cameras: Sequence[Camera],
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> F64:
    """Measure each chunk's share of each view's picture: its blending weights per pixel.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    chunks : (N,) int64
        Number of the chunk of each splat.
    count : int
        Number of chunks.
    cameras : sequence of Camera
        Cameras of the V views, in the frame of the means.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("view table", views done, views)``.

    Returns
    -------
    (V, count) float64
        Shares, 0 to 1: the sum of the blending weights T·alpha of the chunk's splats over a view's
        pixels, divided by the number of pixels. Independent of the number of threads.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.scoring.chunk_contributions import chunk_contributions
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:3]
    >>> halves = np.arange(1000) // 500
    >>> chunk_contributions(splats, halves, 2, cameras).shape
    (3, 2)
    """
    shares = np.zeros((len(cameras), count))
    views = (executor or LocalThreads()).map(
        partial(_shares_in_view, count=count),
        [_reduce(camera) for camera in cameras],
        splats,
        chunks,
    )
    progress("view table", 0, len(cameras))
    for view, found in enumerate(views):
        shares[view] = found
        progress("view table", view + 1, len(cameras))
    return shares


def _shares_in_view(
    camera: Camera, splats: Splats, chunks: NDArray[np.int64], *, count: int
) -> F64:
    """Return each chunk's blending weights per pixel of one view, (count,)."""
    footprints = project(splats, camera)
    sums = np.zeros((len(footprints), 3), np.float64)
    for lists in tile_lists(footprints, camera.width, camera.height):
        # No top K and no minimum: every weight counts.
        add_weights(lists, footprints, camera, 0, 1, sums)
    weights = np.bincount(chunks[footprints.index], sums[:, WEIGHT], minlength=count)
    return weights / (camera.width * camera.height)


def _reduce(camera: Camera) -> Camera:
    """Return the camera with its picture reduced to at most `MAX_PIXELS` pixels."""
    scale = min(1.0, (MAX_PIXELS / (camera.width * camera.height)) ** 0.5)
    width, height = max(1, int(camera.width * scale)), max(1, int(camera.height * scale))
    return camera.resized(width, height)
