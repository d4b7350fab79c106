"""Cells of the parts of a scene that were encoded one by one (SPEC 5.4)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .nested_cells import WHOLE

# Bits of a cell's number in the chunk table (SPEC 5.4).
_CELL_BITS: Final = 32


def part_cells(boxes: NDArray[np.float64]) -> list[int]:
    """Return a cell for each part: the set of parts is halved by middles until each is alone.

    Parameters
    ----------
    boxes : (p, 6) float64
        Box of each part: minimum corner, maximum corner, scene units.

    Returns
    -------
    list of int
        Cell numbers, none inside another; 1 for a single part.

    Examples
    --------
    >>> from cogsplat.codec.partition.part_cells import part_cells
    >>> left, right = [0, 0, 0, 1, 1, 1], [1, 0, 0, 2, 1, 1]
    >>> part_cells(np.array([right, left], np.float64))
    [3, 2]
    """
    middles = 0.5 * (boxes[:, :3] + boxes[:, 3:])
    found = [WHOLE] * len(boxes)

    def halve(parts: NDArray[np.int64], cell: int) -> None:
        if len(parts) == 1:
            found[int(parts[0])] = cell
            return
        axis = int(np.argmax(np.ptp(middles[parts], axis=0)))
        sorted_parts = parts[np.argsort(middles[parts, axis], kind="stable")]
        half = (len(parts) + 1) // 2
        halve(sorted_parts[:half], 2 * cell)
        halve(sorted_parts[half:], 2 * cell + 1)

    if len(boxes):
        halve(np.arange(len(boxes)), WHOLE)
    return found


def cell_within(outer: int, inner: int) -> int:
    """Return the scene's number for cell `inner` of a part that is the scene's cell `outer`.

    Where it does not fit 32 bits, the smallest cell around it whose number does.

    Examples
    --------
    >>> from cogsplat.codec.partition.part_cells import cell_within
    >>> cell_within(3, 1), cell_within(3, 2), cell_within(3, 5)
    (3, 6, 13)
    """
    depth = inner.bit_length() - 1
    cell = outer << depth | inner - (1 << depth)
    return cell >> max(cell.bit_length() - _CELL_BITS, 0)
