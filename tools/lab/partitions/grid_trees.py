"""Greedy partitions of a grid: a k-d tree and an octree that split the fullest box first."""

from __future__ import annotations

import numpy as np

from .basic_cuboids import BasicCuboids
from .box_costs import Box, cut_box


def kd_partition(cuboids: BasicCuboids, cells: int) -> list[Box]:
    """Partition a grid by a k-d tree, splitting the box with most splats first.

    Parameters
    ----------
    cuboids : BasicCuboids
    cells : int
        Number of boxes, at least 1; fewer if the grid has fewer non-empty cuboids.

    Returns
    -------
    list of Box
        Boxes split across their longest axis, at the plane nearest to the median of the splats.
    """
    boxes = [_whole(cuboids)]
    while len(boxes) < cells:
        order = sorted(range(len(boxes)), key=lambda n: -_splats(cuboids, boxes[n]))
        cuts = ((n, _halves(cuboids, boxes[n])) for n in order if _splats(cuboids, boxes[n]))
        found = next(((n, two) for n, two in cuts if two), None)
        if found is None:
            break
        boxes[found[0] : found[0] + 1] = found[1]
    return boxes


def octree_partition(cuboids: BasicCuboids, cells: int) -> list[Box]:
    """Partition a grid by an octree, splitting the box with most splats first.

    Parameters
    ----------
    cuboids : BasicCuboids
    cells : int
        Maximum number of boxes, at least 1.

    Returns
    -------
    list of Box
        Boxes split at the middle of every axis with more than one cuboid.
    """
    boxes = [_whole(cuboids)]
    while True:
        for n in sorted(range(len(boxes)), key=lambda n: -_splats(cuboids, boxes[n])):
            parts = _octants(boxes[n])
            if 1 < len(parts) <= cells - len(boxes) + 1 and _splats(cuboids, boxes[n]):
                boxes[n : n + 1] = parts
                break
        else:
            return boxes


def _whole(cuboids: BasicCuboids) -> Box:
    i, j, k = cuboids.splats.shape
    return (0, 0, 0, i, j, k)


def _splats(cuboids: BasicCuboids, box: Box) -> int:
    a, b, c, d, e, f = box
    return int(cuboids.splats[a:d, b:e, c:f].sum())


def _halves(cuboids: BasicCuboids, box: Box) -> list[Box]:
    """Split a box at the median of its longest axis; empty for a single cuboid."""
    a, b, c, d, e, f = box
    lengths = [
        float(cuboids.edges[axis][box[axis + 3]] - cuboids.edges[axis][box[axis]])
        if box[axis + 3] - box[axis] > 1
        else -1.0
        for axis in range(3)
    ]
    axis = int(np.argmax(lengths))
    if lengths[axis] < 0.0:
        return []
    part = cuboids.splats[a:d, b:e, c:f]
    others = tuple(other for other in range(3) if other != axis)
    before = np.cumsum(part.sum(axis=others))[:-1]
    plane = box[axis] + 1 + int(np.argmin(np.abs(2 * before - int(part.sum()))))
    return list(cut_box(box, axis, plane))


def _octants(box: Box) -> list[Box]:
    """Split a box at the middle of each axis."""
    parts = [box]
    for axis in range(3):
        middle = (box[axis] + box[axis + 3]) // 2
        if middle > box[axis]:
            parts = [half for part in parts for half in cut_box(part, axis, middle)]
    return parts
