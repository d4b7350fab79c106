"""The cheapest partition that straight cuts make: each cut goes through the whole of a box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .box_costs import Box, BoxCosts, Spans, cut_box

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CutCosts:
    """What boxes cost whole and cut.

    Parameters
    ----------
    costs : BoxCosts
    cut : (I, J, K) float64
        The cheapest partition of each box by straight cuts into two boxes or more; infinite for a
        single cuboid.
    """

    costs: BoxCosts
    cut: F64

    def best(self, box: Box) -> float:
        """Return what a box costs whole or cut, whichever is less."""
        place = self.costs.index(box)
        return float(min(self.costs.cost[place], self.cut[place]))

    def partition(self) -> list[Box]:
        """Return the cheapest partition of the grid by straight cuts."""
        i, j, k = (span.length for span in self.costs.spans)
        return self._parts((0, 0, 0, i, j, k))

    def _parts(self, box: Box) -> list[Box]:
        place = self.costs.index(box)
        if self.costs.cost[place] <= self.cut[place]:
            return [box]
        ways = [
            (self.best(low) + self.best(high), low, high)
            for axis in range(3)
            for plane in range(box[axis] + 1, box[axis + 3])
            for low, high in (cut_box(box, axis, plane),)
        ]
        _, low, high = min(ways, key=lambda way: way[0])
        return self._parts(low) + self._parts(high)


def cut_costs(costs: BoxCosts) -> CutCosts:
    """Return the cheapest straight cuts of all boxes, by dynamic programming from small ones up."""
    best, cut = costs.cost.copy(), np.full(costs.cost.shape, np.inf)
    along_x, along_y, along_z = costs.spans
    for width in range(1, along_x.length + 1):
        x = along_x.of_size(width)
        for height in range(1, along_y.length + 1):
            y = along_y.of_size(height)
            found = cut[x, y]
            for part in range(1, width):
                low, high = _two(along_x, width, part)
                np.minimum(found, best[low, y] + best[high, y], out=found)
            for part in range(1, height):
                low, high = _two(along_y, height, part)
                np.minimum(found, best[x, low] + best[x, high], out=found)
            for depth in range(1, along_z.length + 1):
                z = along_z.of_size(depth)
                here = found[:, :, z]
                for part in range(1, depth):
                    low, high = _two(along_z, depth, part)
                    np.minimum(here, best[x, y, low] + best[x, y, high], out=here)
                np.minimum(best[x, y, z], here, out=best[x, y, z])
    return CutCosts(costs, cut)


def _two(span: Spans, size: int, part: int) -> tuple[slice, slice]:
    """Return where the first `part` cuboids of all ranges of a size stand, and where the rest."""
    count = span.length - size + 1
    first, rest = span.index(0, part), span.index(part, size - part)
    return slice(first, first + count), slice(rest, rest + count)
