"""Contribution of each chunk of a scene to each view, as a share of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.blend_weights import WEIGHT, add_weights
from cogsplat.codec.render.front_to_back import FrontToBack
from cogsplat.codec.render.splat_blocks import SplatBlocks, blocks_if_large
from cogsplat.codec.render.tiles import tile_lists
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace

F64 = NDArray[np.float64]

MAX_PIXELS: Final = 20_000
"""Pixels of a measured view at most; larger ones are reduced, which suffices for whole chunks."""


def chunk_contributions(
    splats: Splats,
    chunks: NDArray[np.integer],
    count: int,
    cameras: Sequence[Camera],
    *,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> F64:
    """Measure each chunk's share of each view's picture: its blending weights per pixel.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    chunks : (N,) integer
        Number of the chunk of each splat.
    count : int
        Number of chunks.
    cameras : sequence of Camera
        Cameras of the V views, in the frame of the means.
    workspace : Workspace
        Allocator of long arrays; it also decides whether several views are drawn at once.
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
    if executor is None or not workspace.views_at_once:
        executor = LocalThreads(0 if workspace.views_at_once else 1)
    blocks = blocks_if_large(splats, workspace)
    views = executor.map(
        partial(_shares_in_view, count=count),
        [_reduce(camera) for camera in cameras],
        splats,
        chunks,
        *(() if blocks is None else (blocks,)),
    )
    progress("view table", 0, len(cameras))
    for view, found in enumerate(views):
        shares[view] = found
        progress("view table", view + 1, len(cameras))
    return shares


def _shares_in_view(
    camera: Camera,
    splats: Splats,
    chunks: NDArray[np.integer],
    blocks: SplatBlocks | None = None,
    *,
    count: int,
) -> F64:
    """Return each chunk's blending weights per pixel of one view, (count,)."""
    walk = FrontToBack(splats, blocks, camera, near_plane=NEAR, hides=True)
    size = (camera.width, camera.height)
    numbers, found = [], []
    for footprints in walk.slabs():
        sums = np.zeros((len(footprints), 3), np.float64)
        for lists in tile_lists(footprints, *size, is_open=walk.is_open):
            # No top K and no minimum: every weight counts.
            add_weights(lists, footprints, camera, 0, 1, sums, transmittances=walk.transmittances)
        seen = sums[:, WEIGHT] > 0.0
        numbers.append(chunks[footprints.index[seen]])
        found.append(sums[seen, WEIGHT])
    # Added up at once, nearest first, so that slabs do not change the sums.
    weights = np.bincount(np.concatenate(numbers), np.concatenate(found), minlength=count)
    return weights / (camera.width * camera.height)


def _reduce(camera: Camera) -> Camera:
    """Return the camera with its picture reduced to at most `MAX_PIXELS` pixels."""
    scale = min(1.0, (MAX_PIXELS / (camera.width * camera.height)) ** 0.5)
    width, height = max(1, int(camera.width * scale)), max(1, int(camera.height * scale))
    return camera.resized(width, height)
