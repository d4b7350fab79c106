"""Octree orders: every part of space gets its share of the first splats (PRoGS, section 3.2).

The paper sorts by contribution inside each leaf of the octree. It does not specify how the leaves
are merged into one order (here `round_robin` and `quota`), nor how the depth depends on density
(here `leaves` and `adaptive_leaves`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_DEPTH: Final = 20
"""Maximum depth of an octree: three coordinates of 20 bits fit an int64."""


def leaves(means: NDArray[np.float32], depth: int) -> NDArray[np.int64]:
    """Return the number of the octree leaf that holds each mean.

    Parameters
    ----------
    means : (N, 3) float32
        Means, scene units; non-finite means go to the first leaf.
    depth : int
        Number of times the bounding box of the means is halved along each axis, 0 to `MAX_DEPTH`.
        Leaves have the proportions of that box.

    Returns
    -------
    (N,) int64
        Leaf numbers, not consecutive.

    Raises
    ------
    ValueError
        `depth` is out of range.
    """
    if not 0 <= depth <= MAX_DEPTH:
        raise ValueError(f"octree depth {depth}, expected 0 to {MAX_DEPTH}")
    points = means.astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    numbers = np.zeros(len(points), np.int64)
    if not finite.any():
        return numbers
    low, high = points[finite].min(axis=0), points[finite].max(axis=0)
    sides = np.where(high > low, high - low, 1.0)
    cells = np.floor((points[finite] - low) / sides * 2.0**depth).astype(np.int64)
    # The mean on the upper face belongs to the last leaf.
    cells = np.minimum(cells, (1 << depth) - 1)
    numbers[finite] = (cells[:, 0] << 2 * depth) | (cells[:, 1] << depth) | cells[:, 2]
    return numbers


def adaptive_leaves(means: NDArray[np.float32], capacity: int) -> NDArray[np.int64]:
    """Return the number of each mean's leaf in an octree that is deeper where splats are dense.

    PRoGS (section 3.2) subdivides "based on the density of splats": a node with more than
    `capacity` means is split into eight children.

    Parameters
    ----------
    means : (N, 3) float32
        Means, scene units; non-finite means go to the first leaf.
    capacity : int
        Means of a leaf at most, 1 or more; a leaf at depth `MAX_DEPTH` may hold more.

    Returns
    -------
    (N,) int64
        Leaf numbers, not consecutive.

    Raises
    ------
    ValueError
        `capacity` is below 1.

    Examples
    --------
    >>> means = np.array([[0, 0, 0], [0.1, 0, 0], [8, 8, 8]], np.float32)
    >>> leaf = adaptive_leaves(means, 1)
    >>> len(set(leaf.tolist()))
    3
    """
    if capacity < 1:
        raise ValueError(f"octree capacity {capacity}, expected 1 or more")
    finest = leaves(means, MAX_DEPTH)
    coordinates = [(finest >> MAX_DEPTH * axis) & ((1 << MAX_DEPTH) - 1) for axis in (2, 1, 0)]
    out = np.zeros(len(means), np.int64)
    rest = np.arange(len(means))
    used = 0
    for depth in range(MAX_DEPTH + 1):
        node = np.zeros(len(rest), np.int64)
        for axis in coordinates:
            node = (node << depth) | (axis[rest] >> (MAX_DEPTH - depth))
        _, number, counts = np.unique(node, return_inverse=True, return_counts=True)
        small = counts[number] <= capacity
        if depth == MAX_DEPTH:
            small[:] = True
        out[rest[small]] = used + number[small]
        used += len(counts)
        rest = rest[~small]
    return out


def round_robin(leaf: NDArray[np.int64], contribution: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return an order of the best splat of every leaf, then the second best of every leaf, etc.

    Parameters
    ----------
    leaf : (N,) int64
        Leaf number of each splat.
    contribution : (N,) float64
        Contribution of each splat. It ranks the splats of a leaf (ties in file order); its sum
        ranks the leaves.

    Returns
    -------
    (N,) int64
        Rows, first to last.
    """
    rank, _, total = _rank_in_leaves(leaf, contribution)
    return np.lexsort((leaf, -total, rank)).astype(np.int64)


def quota(leaf: NDArray[np.int64], contribution: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return an order whose every prefix holds about the same share of every leaf.

    Parameters
    ----------
    leaf : (N,) int64
        Leaf number of each splat.
    contribution : (N,) float64
        Contribution of each splat, which ranks the splats of a leaf; ties in file order.

    Returns
    -------
    (N,) int64
        Rows by ascending (rank in the leaf + ½) / (splats in the leaf), ties by contribution.
    """
    rank, size, _ = _rank_in_leaves(leaf, contribution)
    return np.lexsort((-contribution, (rank + 0.5) / size)).astype(np.int64)


def _rank_in_leaves(
    leaf: NDArray[np.int64], contribution: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return each row's rank in its leaf, the leaf's size, and its total contribution."""
    rows = np.lexsort((-contribution, leaf))
    _, first, counts = np.unique(leaf[rows], return_index=True, return_counts=True)
    rank, size = np.empty(len(leaf), np.int64), np.empty(len(leaf), np.int64)
    total = np.empty(len(leaf), np.float64)
    rank[rows] = np.arange(len(leaf)) - np.repeat(first, counts)
    size[rows] = np.repeat(counts, counts)
    if len(leaf):
        total[rows] = np.repeat(np.add.reduceat(contribution[rows], first), counts)
    return rank, size, total
