"""Split quantised values into the coarse codes of a head and refinement digits (SPEC 6.16)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import refinement_digits
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Stream

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

WAITING_BIT_VALUE: Final = 0.06
"""Bits of the file that one more bit in the refinement, and out of the head, may cost."""

# Bits that a plane of digits takes beside its content: its word and the header of a zstd frame.
_PLANE_BITS: Final = 8 * 8

# Bits that describe one symbol in the table of an entropy coder, about.
_SYMBOL_BITS: Final = 4

# Radices that are tried; between them little changes.
_RADICES: Final = (2, 3, 4, 5, 6, 8, 10, 12, 16)

# Grids of more levels than this are split without a search for the best alignment: none gains.
_ALIGNED_LEVELS: Final = 1 << 14

# Bounds of the fitted step of a coarse grid, relative to the even one.
_STRETCH: Final = (0.6, 1.4)


@dataclass(frozen=True, eq=False)
class Split:
    """Values of a grid in two parts: coarse codes of the head, digits of the refinement.

    Parameters
    ----------
    coarse : (n, c) float32
        As decoded from the head alone.
    grid : Grid
        The head's; `coarse` lies on it.
    fine : (n, c) float32
        As decoded from both.
    digits : Stream or None
        None where the head holds the values in full.
    """

    coarse: F32
    grid: Grid
    fine: F32
    digits: Stream | None

    def take(self, rows: I64) -> Split:
        """Return the same with its rows in another order."""
        digits = self.digits
        if digits is not None:
            digits = replace(digits, planes=[plane[rows] for plane in digits.planes])
        return Split(self.coarse[rows], self.grid, self.fine[rows], digits)


def split(
    attribute: Attribute, values: F32, grid: Grid, weights: F64, most: tuple[int, ...]
) -> Split:
    """Split values where the bits that move to the refinement outweigh those that splitting costs.

    Parameters
    ----------
    attribute : Attribute
    values : (n, c) float32
    grid : Grid
        Of the refined values.
    weights : (n,) float64
        Weight of the error of each coarse value.
    most : tuple of int
        Largest radix of each component, at most `refinement_digits.MAX_RADIX`.
    """
    codes = grid.quantise(values)
    radices, shifts = [], []
    for component, limit in enumerate(most):
        radix, shift = _radix(codes[:, component], int(grid.levels[component]), limit)
        radices.append(radix)
        shifts.append(shift)
    if max(radices) == 1:
        stored = grid.dequantise(codes)
        return Split(stored, grid, stored, None)
    grid = _shifted(grid, shifts)
    codes = grid.quantise(values)
    fine = grid.dequantise(codes)
    digits = refinement_digits.write(attribute, codes, grid, radices)
    coarse_codes = codes // np.array(radices, np.uint32)
    coarse_grid = _coarse_grid(grid, radices, coarse_codes, fine, weights)
    return Split(coarse_grid.dequantise(coarse_codes), coarse_grid, fine, digits)


def _radix(codes: U32, levels: int, limit: int) -> tuple[int, int]:
    """Return the radix of the digits, and by how many levels to shift the codes before."""
    if levels > _ALIGNED_LEVELS:
        return limit, 0
    counts = np.bincount(codes, minlength=levels)
    whole = bits(counts)
    best, gain = (1, 0), 0.0
    for radix in (r for r in _RADICES if r <= limit):
        cells = -(-(levels + radix - 1) // radix)
        padded = np.zeros(cells * radix, np.int64)
        for shift in range(min(radix, levels)):
            padded[:] = 0
            padded[shift : shift + levels] = counts
            grouped = padded.reshape(cells, radix)
            below = bits(grouped.sum(axis=0))
            loss = bits(grouped.sum(axis=1)) + below - whole + _PLANE_BITS
            if WAITING_BIT_VALUE * below - loss > gain:
                best, gain = (radix, shift), WAITING_BIT_VALUE * below - loss
    return best


def bits(counts: I64) -> float:
    """Return about how many bits symbols of these counts take, all of them."""
    used = counts[counts > 0].astype(np.float64)
    if len(used) < 2:
        return 0.0
    total = used.sum()
    ideal = total * np.log2(total) - (used * np.log2(used)).sum()
    # The code of the symbols has to be described; where that is too long, all take the same bits.
    return float(min(ideal + _SYMBOL_BITS * len(used), total * np.log2(len(counts))))


def _shifted(grid: Grid, shifts: list[int]) -> Grid:
    """Return a grid with so many levels more below its minimum."""
    step = grid.step.astype(np.float64)
    count = np.array(shifts, np.uint32)
    minimum = (grid.minimum.astype(np.float64) - step * count).astype(np.float32)
    return Grid(minimum, grid.maximum, grid.levels + count)


def _coarse_grid(grid: Grid, radices: list[int], codes: U32, fine: F32, weights: F64) -> Grid:
    """Return the grid of the head, its ends fitted to the values by weighted least squares."""
    size = np.array(radices, np.float64)
    step = grid.step.astype(np.float64)
    levels = (grid.levels + np.array(radices, np.uint32) - 1) // np.array(radices, np.uint32)
    low = np.array(grid.minimum, np.float64)
    high = np.array(grid.maximum, np.float64)
    weights = weights / weights.sum()
    for component in range(grid.components):
        if radices[component] == 1:
            continue
        code, value = codes[:, component].astype(np.float64), fine[:, component].astype(np.float64)
        even = size[component] * step[component]
        centre, mean = weights @ code, weights @ value
        spread = weights @ np.square(code - centre)
        width = weights @ ((code - centre) * (value - mean)) / spread if spread > 0 else even
        width = min(max(width, _STRETCH[0] * even), _STRETCH[1] * even)
        low[component] = mean - centre * width
        high[component] = low[component] + (int(levels[component]) - 1) * width
    return Grid(low.astype(np.float32), high.astype(np.float32), levels.astype(np.uint32))
