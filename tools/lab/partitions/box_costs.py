"""What each box of basic cuboids would cost a client as one cell, for all boxes at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .basic_cuboids import BasicCuboids

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

Box = tuple[int, int, int, int, int, int]
"""First cuboid along x, y and z, then the first one behind it: a half-open range on each axis."""


def cut_box(box: Box, axis: int, plane: int) -> tuple[Box, Box]:
    """Return the two parts of a box on both sides of a plane of the grid."""
    low, high = list(box), list(box)
    low[axis + 3] = high[axis] = plane
    a, b, c, d, e, f = low
    one: Box = (a, b, c, d, e, f)
    a, b, c, d, e, f = high
    return one, (a, b, c, d, e, f)


@dataclass(frozen=True, eq=False)
class Spans:
    """All ranges of the cuboids along one axis, short ones first, then by where they begin.

    Parameters
    ----------
    length : int
        Cuboids along the axis.
    """

    length: int

    @property
    def count(self) -> int:
        """Number of ranges."""
        return self.length * (self.length + 1) // 2

    def of_size(self, size: int) -> slice:
        """Return where the ranges of `size` cuboids stand, by their first cuboid."""
        first = self.index(0, size)
        return slice(first, first + self.length - size + 1)

    def index(self, start: int, size: int) -> int:
        """Return where the range of `size` cuboids that begins at `start` stands."""
        # Ranges of 1 … size - 1 cuboids come before: length, length - 1, … of them.
        return (size - 1) * (2 * self.length - size + 2) // 2 + start

    def ends(self) -> tuple[I64, I64]:
        """Return the first cuboid of each range and the one behind its last, (count,) each."""
        sizes = np.arange(1, self.length + 1)
        starts = np.concatenate([np.arange(self.length - size + 1) for size in sizes])
        return starts, starts + np.repeat(sizes, self.length - sizes + 1)


@dataclass(frozen=True, eq=False)
class BoxCosts:
    """The cost of every box.

    Parameters
    ----------
    spans : tuple of Spans
        Of each axis; box (a, b, c) is range a along x, b along y and c along z.
    cost : (I, J, K) float64
        Its share of what a partition that contains it costs.
    splats : (I, J, K) int64
        Splats in it.
    """

    spans: tuple[Spans, Spans, Spans]
    cost: F64
    splats: I64

    def index(self, box: Box) -> tuple[int, int, int]:
        """Return where a box stands in the arrays."""
        a, b, c = (
            span.index(box[axis], box[axis + 3] - box[axis]) for axis, span in enumerate(self.spans)
        )
        return a, b, c

    def total(self, boxes: list[Box]) -> float:
        """Return what a partition costs."""
        return float(sum(self.cost[self.index(box)] for box in boxes))


def box_sums(values: NDArray[np.generic], spans: tuple[Spans, Spans, Spans]) -> F64:
    """Return the sum of (i, j, k) values over every box, (I, J, K) float64."""
    sums = np.asarray(values, np.float64)
    for axis, span in enumerate(spans):
        before = np.cumsum(np.insert(sums, 0, 0.0, axis=axis), axis=axis)
        start, end = span.ends()
        sums = np.take(before, end, axis=axis) - np.take(before, start, axis=axis)
    return sums


def box_costs(cuboids: BasicCuboids) -> BoxCosts:
    """Return what boxes cost by SGSS' measure (Zhu et al., MMSys 2025).

    Parameters
    ----------
    cuboids : BasicCuboids

    Notes
    -----
    A partition costs the boxes that hold splats over the basic cuboids that hold some, for a client
    tests each box against its view; plus, averaged over views, the splats of all boxes that a view
    sees something of over those that it sees. Views that see nothing do not count.
    """
    shape = cuboids.splats.shape
    spans = (Spans(shape[0]), Spans(shape[1]), Spans(shape[2]))
    splats = np.rint(box_sums(cuboids.splats, spans)).astype(np.int64)
    cost = (splats > 0) / max(int((cuboids.splats > 0).sum()), 1)
    seen = [view for view in cuboids.seen if view.any()]
    for view in seen:
        fetched = box_sums(view, spans) > 0.5
        cost += np.where(fetched, splats, 0) / (float(view.sum()) * len(seen))
    return BoxCosts(spans, cost, splats)


def waste(cuboids: BasicCuboids, boxes: list[Box]) -> float:
    """Return the splats that views fetch over those that they see, averaged: 1 is the least."""
    ratios = []
    for view in cuboids.seen:
        if view.any():
            parts = [np.s_[b[0] : b[3], b[1] : b[4], b[2] : b[5]] for b in boxes]
            fetched = sum(int(cuboids.splats[part].sum()) for part in parts if view[part].any())
            ratios.append(fetched / int(view.sum()))
    return float(np.mean(ratios)) if ratios else 1.0
