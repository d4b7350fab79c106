"""Regions: the parts of a scene that views tell apart, such as the rooms of a house.

A plane splits a region where most views then fetch splats of one side only. The expected number of
splats that a view fetches decides, as in SGSS (Zhu et al., MMSys 2025), but visibility comes from
rendered pictures, which know walls.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .nested_cells import WHOLE_SCENE, Region

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# A view of which a region fills this share or more counts as fetching all of the region, a smaller
# share in proportion. With 0.002, a glimpse through a door counts as much as a room, and planes cut
# rooms in halves: a house of six rooms then shows 9 dB less after a fifth of its bytes.
_SEEN_SHARE: Final = 0.2

# Least share of a region that a split must save a view that fetches the region. The best plane
# through a captured room saves 0.01, through a terrace 0.02, through a house of six rooms 0.34, and
# through parts of its rooms 0.12 to 0.4.
_LEAST_SAVING: Final = 0.1


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
