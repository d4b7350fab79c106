"""Cheapest guillotine partition: every cut splits a whole box into two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .box_costs import Box, BoxCosts, Spans, cut_box

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CutCosts:
    """Cost of every box, whole and cut.

    Parameters
    ----------
    costs : BoxCosts
        Costs of the whole boxes.
    cut : (I, J, K) float64
        Cost of the cheapest guillotine partition of each box into two or more; infinite for a
        single cuboid.
    """

    costs: BoxCosts
    cut: F64

    def best(self, box: Box) -> float:
        """Return the lower of a box's costs, whole or cut."""
        index = self.costs.index(box)
        return float(min(self.costs.cost[index], self.cut[index]))

    def partition(self) -> list[Box]:
        """Return the cheapest guillotine partition of the grid."""
        i, j, k = (span.length for span in self.costs.spans)
        return self._parts((0, 0, 0, i, j, k))

    def _parts(self, box: Box) -> list[Box]:
        """Return the cheapest guillotine partition of a box."""
        index = self.costs.index(box)
        if self.costs.cost[index] <= self.cut[index]:
            return [box]
        cuts = [
            (self.best(low) + self.best(high), low, high)
            for axis in range(3)
            for plane in range(box[axis] + 1, box[axis + 3])
            for low, high in (cut_box(box, axis, plane),)
        ]
        _, low, high = min(cuts, key=lambda cut: cut[0])
        return self._parts(low) + self._parts(high)


def cut_costs(costs: BoxCosts) -> CutCosts:
    """Compute the cheapest guillotine partition of every box, by dynamic programming."""
    best, cut = costs.cost.copy(), np.full(costs.cost.shape, np.inf)
    along_x, along_y, along_z = costs.spans
    for width in range(1, along_x.length + 1):
        x = along_x.of_size(width)
        for height in range(1, along_y.length + 1):
            y = along_y.of_size(height)
            found = cut[x, y]
            for part in range(1, width):
                low, high = _split(along_x, width, part)
                np.minimum(found, best[low, y] + best[high, y], out=found)
            for part in range(1, height):
                low, high = _split(along_y, height, part)
                np.minimum(found, best[x, low] + best[x, high], out=found)
            for depth in range(1, along_z.length + 1):
                z = along_z.of_size(depth)
                here = found[:, :, z]
                for part in range(1, depth):
                    low, high = _split(along_z, depth, part)
                    np.minimum(here, best[x, y, low] + best[x, y, high], out=here)
                np.minimum(best[x, y, z], here, out=best[x, y, z])
    return CutCosts(costs, cut)


def _split(span: Spans, size: int, part: int) -> tuple[slice, slice]:
    """Return positions of the first `part` cuboids and of the rest, for ranges of one size."""
    count = span.length - size + 1
    first, rest = span.index(0, part), span.index(part, size - part)
    return slice(first, first + count), slice(rest, rest + count)
