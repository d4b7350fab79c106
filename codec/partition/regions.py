"""Regions: the parts of a scene that views tell apart, such as the rooms of a house.

A plane splits a region where most views then fetch splats of one side only. The expected number of
splats that a view fetches decides, as in SGSS (Zhu et al., MMSys 2025), but visibility comes from
rendered pictures, which know walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor
from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.chunk_contributions import chunk_contributions
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .nested_cells import WHOLE_SCENE, Region

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Splats of a group, the unit of visibility, and groups at most: contributions of all groups to all
# views have to fit into memory.
_GROUP_SPLATS: Final = 256
_MOST_GROUPS: Final = 16_384

_GROUPS_PER_TRIM: Final = 16

# Share of a picture from which a view is assumed to fetch a whole region; smaller shares count in
# proportion.
_SEEN_SHARE: Final = 1e-3

# Least share of a region that a split must save a view that fetches the region. The best plane
# through a captured room saves 0.01, through a terrace 0.02, through a house of six rooms 0.34, and
# through parts of its rooms 0.12 to 0.4.
_LEAST_SAVING: Final = 0.1


def find_regions(
    splats: Splats,
    is_stored: NDArray[np.bool_],
    cameras: Sequence[Camera],
    *,
    smallest: int,
    saving: int,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Region:
    """Split a scene by planes into regions of which each view sees few.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    is_stored : (N,) bool
        Splats that count; a view fetches no others.
    cameras : sequence of Camera
        Views of the scene, in the frame of the means.
    smallest, saving : int
        Least splats of a region, and least mean number of splats that a split must save a view
        that fetches the region.
    workspace : Workspace
        Allocator of long arrays.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("regions", views done, views)``.

    Returns
    -------
    Region
        Root of the tree.
    """
    count = min(-(-len(splats) // _GROUP_SPLATS), _MOST_GROUPS)
    if is_stored.sum() < 2 * smallest or not cameras:
        return WHOLE_SCENE
    order = workspace.zeros((len(splats),), np.int64)
    order[:] = spatial_order(splats.means)
    bounds = np.linspace(0, len(order), count + 1).astype(np.int64)
    group = workspace.zeros((len(order),), np.int32)
    centres = np.empty((count, 3))
    for number, (start, stop) in enumerate(pairwise(bounds.tolist())):
        rows = order[start:stop]
        if number % _GROUPS_PER_TRIM == 0:
            workspace.trim()
        group[rows] = number
        centres[number] = splats.means[rows].mean(axis=0, dtype=np.float64)
    shares = chunk_contributions(
        splats,
        group,
        count,
        cameras,
        workspace=workspace,
        executor=executor,
        progress=lambda _, done, views: progress("regions", done, views),
    )
    stored = np.bincount(group[is_stored], minlength=count)
    return split_regions(centres, stored, shares, smallest=smallest, saving=saving)


def split_regions(centres: F64, splats: I64, shares: F64, *, smallest: int, saving: int) -> Region:
    """Split groups of splats by planes into regions of which each view sees few.

    Parameters
    ----------
    centres : (g, 3) float64
        Centre of each group, scene units.
    splats : (g,) int64
        Splats of each group.
    shares : (V, g) float64
        Share of each group in each view's picture, 0 to 1.
    smallest, saving : int
        Least splats of a region, and least mean number of splats that a split must save a view
        that fetches the region.
    """
    whole, views = int(splats.sum()), float(_seen(shares.sum(axis=1)).sum())
    best, found = views * (whole - max(_LEAST_SAVING * whole, saving)), None
    for axis in range(3):
        order = np.argsort(centres[:, axis], kind="stable")
        below = np.cumsum(splats[order])[:-1]
        above = whole - below
        seen_low, seen_high = np.zeros(len(below)), np.zeros(len(below))
        # View by view: arrays of all views and groups would take 0.1 GB each in a large scene.
        for view in shares:
            low = np.cumsum(view[order])
            seen_low += _seen(low[:-1])
            seen_high += _seen(np.maximum(low[-1:] - low[:-1], 0.0))
        cost = seen_low * below + seen_high * above
        places = centres[order, axis]
        planes = 0.5 * (places[1:] + places[:-1])
        # A plane separates centres that differ.
        is_valid = (np.minimum(below, above) >= smallest) & (planes > places[:-1])
        cost = np.where(is_valid, cost, np.inf)
        cut = int(np.argmin(cost)) if len(cost) else 0
        if len(cost) and cost[cut] < best:
            best = float(cost[cut])
            found = axis, float(planes[cut])
    if found is None:
        return WHOLE_SCENE
    axis, plane = found
    is_low = centres[:, axis] < plane
    low_half, high_half = (
        split_regions(
            centres[side], splats[side], shares[:, side], smallest=smallest, saving=saving
        )
        for side in (is_low, ~is_low)
    )
    return Region(axis, plane, (low_half, high_half))


def _seen(shares: F64) -> F64:
    """Return the fetched part of a region from its share of a picture."""
    seen: F64 = np.minimum(shares / _SEEN_SHARE, 1.0)
    return seen
