"""Cost of every box of basic cuboids as one cell of a partition, by SGSS' measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .basic_cuboids import BasicCuboids

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

Box = tuple[int, int, int, int, int, int]
"""Index of the first cuboid along x, y and z, then of the end (exclusive) along x, y and z."""


def cut_box(box: Box, axis: int, plane: int) -> tuple[Box, Box]:
    """Split a box into two at a plane of the grid."""
    low, high = list(box), list(box)
    low[axis + 3] = high[axis] = plane
    a, b, c, d, e, f = low
    one: Box = (a, b, c, d, e, f)
    a, b, c, d, e, f = high
    return one, (a, b, c, d, e, f)


@dataclass(frozen=True, eq=False)
class Spans:
    """Enumeration of all ranges of cuboids along one axis, by length, then by start.

    Parameters
    ----------
    length : int
        Number of cuboids along the axis.
    """

    length: int

    @property
    def count(self) -> int:
        """Number of ranges."""
        return self.length * (self.length + 1) // 2

    def of_size(self, size: int) -> slice:
        """Return the positions of all ranges of `size` cuboids."""
        first = self.index(0, size)
        return slice(first, first + self.length - size + 1)

    def index(self, start: int, size: int) -> int:
        """Return the position of the range of `size` cuboids that begins at `start`."""
        # Ranges of 1 … size - 1 cuboids come before: length, length - 1, … of them.
        return (size - 1) * (2 * self.length - size + 2) // 2 + start

    def ends(self) -> tuple[I64, I64]:
        """Return start and end (exclusive) of each range, (count,) each."""
        sizes = np.arange(1, self.length + 1)
        starts = np.concatenate([np.arange(self.length - size + 1) for size in sizes])
        return starts, starts + np.repeat(sizes, self.length - sizes + 1)


@dataclass(frozen=True, eq=False)
class BoxCosts:
    """Cost and splat count of every box.

    Parameters
    ----------
    spans : tuple of Spans
        Ranges of each axis; box (a, b, c) is range a along x, b along y and c along z.
    cost : (I, J, K) float64
        Contribution of each box to the cost of a partition.
    splats : (I, J, K) int64
        Number of splats in each box.
    """

    spans: tuple[Spans, Spans, Spans]
    cost: F64
    splats: I64

    def index(self, box: Box) -> tuple[int, int, int]:
        """Return the array index of a box."""
        a, b, c = (
            span.index(box[axis], box[axis + 3] - box[axis]) for axis, span in enumerate(self.spans)
        )
        return a, b, c

    def total(self, boxes: list[Box]) -> float:
        """Return the cost of a partition."""
        return float(sum(self.cost[self.index(box)] for box in boxes))


def box_sums(values: NDArray[np.generic], spans: tuple[Spans, Spans, Spans]) -> F64:
    """Sum the values of cuboids (i, j, k) over every box, (I, J, K) float64."""
    sums = np.asarray(values, np.float64)
    for axis, span in enumerate(spans):
        before = np.cumsum(np.insert(sums, 0, 0.0, axis=axis), axis=axis)
        start, end = span.ends()
        sums = np.take(before, end, axis=axis) - np.take(before, start, axis=axis)
    return sums


def box_costs(cuboids: BasicCuboids) -> BoxCosts:
    """Return the cost of every box by the measure of SGSS (Zhu et al., MMSys 2025).

    Parameters
    ----------
    cuboids : BasicCuboids

    Notes
    -----
    The cost of a partition has two terms. The first is the number of non-empty boxes over that of
    non-empty cuboids, as a client tests each box against its view. The second is the mean over the
    views of fetched splats over visible splats; a box is fetched if any of its splats is visible.
    Views without visible splats are left out.
    """
    shape = cuboids.splats.shape
    spans = (Spans(shape[0]), Spans(shape[1]), Spans(shape[2]))
    splats = np.rint(box_sums(cuboids.splats, spans)).astype(np.int64)
    cost = (splats > 0) / max(int((cuboids.splats > 0).sum()), 1)
    views = [view for view in cuboids.visible if view.any()]
    for view in views:
        fetched = box_sums(view, spans) > 0.5
        cost += np.where(fetched, splats, 0) / (float(view.sum()) * len(views))
    return BoxCosts(spans, cost, splats)


def waste(cuboids: BasicCuboids, boxes: list[Box]) -> float:
    """Return fetched over visible splats, mean over the views; 1 is the minimum."""
    ratios = []
    for view in cuboids.visible:
        if view.any():
            parts = [np.s_[b[0] : b[3], b[1] : b[4], b[2] : b[5]] for b in boxes]
            fetched = sum(int(cuboids.splats[part].sum()) for part in parts if view[part].any())
            ratios.append(fetched / int(view.sum()))
    return float(np.mean(ratios)) if ratios else 1.0
