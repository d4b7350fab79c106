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

DEFERRED_BIT_PRICE: Final = 0.06
"""Growth of the file, in bits, accepted for moving one bit from a head to its refinement."""

# Overhead of a plane of digits: its word in the record and the header of a zstd frame, bits.
_PLANE_BITS: Final = 8 * 8

# Approximate size of one symbol's entry in the table of an entropy coder, bits.
_SYMBOL_BITS: Final = 4

# Radices tried; the sizes change little between them.
_RADICES: Final = (2, 3, 4, 5, 6, 8, 10, 12, 16)

# Number of levels above which a grid is split without searching the best shift: no shift gains.
_ALIGNED_LEVELS: Final = 1 << 14

# Bounds of the fitted step of a coarse grid, relative to radix times the fine step.
_STRETCH: Final = (0.6, 1.4)


@dataclass(frozen=True, eq=False)
class Split:
    """Quantised values in two parts: coarse codes of the head, digits of the refinement.

    Parameters
    ----------
    coarse : (n, c) float32
        Values decoded from the head alone.
    grid : Grid
        Grid of the head, on which `coarse` lies.
    fine : (n, c) float32
        Values decoded from head and refinement.
    digits : Stream or None
        Stream of the refinement; None if the head holds the values in full.
    """

    coarse: F32
    grid: Grid
    fine: F32
    digits: Stream | None

    def take(self, rows: I64) -> Split:
        """Return the split values of given rows, in the order of `rows`."""
        digits = self.digits
        if digits is not None:
            digits = replace(digits, planes=[plane[rows] for plane in digits.planes])
        return Split(self.coarse[rows], self.grid, self.fine[rows], digits)


def split(
    attribute: Attribute, values: F32, grid: Grid, weights: F64, max_radices: tuple[int, ...]
) -> Split:
    """Quantise values and split their codes into coarse codes and refinement digits.

    A component is split only if the file grows by fewer bits than `DEFERRED_BIT_PRICE` times the
    bits that move from the head to the refinement.

    Parameters
    ----------
    attribute : Attribute
        Attribute of the values.
    values : (n, c) float32
        Values to quantise, one row per splat.
    grid : Grid
        Grid of the refined values.
    weights : (n,) float64
        Weight of each row's squared error in the fit of the coarse grid.
    max_radices : tuple of int
        Limit of the radix of each component, at most `refinement_digits.MAX_RADIX`.
    """
    codes = grid.quantise(values)
    radices, shifts = [], []
    for component, limit in enumerate(max_radices):
        radix, shift = _best_radix(codes[:, component], int(grid.levels[component]), limit)
        radices.append(radix)
        shifts.append(shift)
    stored = grid.dequantise(codes)
    whole = Split(stored, grid, stored, None)
    if max(radices) == 1:
        return whole
    grid = _extend_below(grid, shifts)
    codes = grid.quantise(values)
    fine = grid.dequantise(codes)
    digits = refinement_digits.write(attribute, codes, grid, radices)
    coarse_codes = codes // np.array(radices, np.uint32)
    coarse_grid = _fit_coarse_grid(grid, radices, coarse_codes, fine, weights)
    coarse = coarse_grid.dequantise(coarse_codes)
    if (coarse_grid.quantise(coarse) != coarse_codes).any():
        # The writer of the head quantises again. On a grid of millions of levels float32 can round
        # a value to the next level, whose digits would lead beyond the fine grid.
        return whole
    return Split(coarse, coarse_grid, fine, digits)


def _best_radix(codes: U32, levels: int, limit: int) -> tuple[int, int]:
    """Choose the radix of one component's refinement digits by the sizes of head and refinement.

    Parameters
    ----------
    codes : (n,) uint32
        Codes of the component.
    levels : int
        Number of levels of the component's grid.
    limit : int
        Maximum radix.

    Returns
    -------
    radix, shift : int
        Radix, 1 if a split does not pay; and the offset to add to the codes before the division by
        the radix.
    """
    if levels > _ALIGNED_LEVELS:
        return limit, 0
    counts = np.bincount(codes, minlength=levels)
    whole = entropy_bits(counts)
    best, gain = (1, 0), 0.0
    for radix in (r for r in _RADICES if r <= limit):
        cells = -(-(levels + radix - 1) // radix)
        padded = np.zeros(cells * radix, np.int64)
        for shift in range(min(radix, levels)):
            padded[:] = 0
            padded[shift : shift + levels] = counts
            grouped = padded.reshape(cells, radix)
            below = entropy_bits(grouped.sum(axis=0))
            loss = entropy_bits(grouped.sum(axis=1)) + below - whole + _PLANE_BITS
            if DEFERRED_BIT_PRICE * below - loss > gain:
                best, gain = (radix, shift), DEFERRED_BIT_PRICE * below - loss
    return best


def entropy_bits(counts: I64) -> float:
    """Return the approximate entropy-coded size of a symbol histogram, with code table, bits."""
    used = counts[counts > 0].astype(np.float64)
    if len(used) < 2:
        return 0.0
    total = used.sum()
    ideal = total * np.log2(total) - (used * np.log2(used)).sum()
    # The code table is stored too; if it is too large, symbols have a fixed length instead.
    return float(min(ideal + _SYMBOL_BITS * len(used), total * np.log2(len(counts))))


def _extend_below(grid: Grid, shifts: list[int]) -> Grid:
    """Return a grid with `shifts` more levels below the minimum of each component."""
    step = grid.step.astype(np.float64)
    count = np.array(shifts, np.uint32)
    minimum = (grid.minimum.astype(np.float64) - step * count).astype(np.float32)
    return Grid(minimum, grid.maximum, grid.levels + count)


def _fit_coarse_grid(
    grid: Grid, radices: list[int], coarse_codes: U32, fine: F32, weights: F64
) -> Grid:
    """Fit the head's grid, so that coarse codes decode near the refined values.

    Parameters
    ----------
    grid : Grid
        Grid of the refined values.
    radices : list of int
        Radix of each component's digits; a component of radix 1 keeps its grid.
    coarse_codes : (n, c) uint32
        Codes of the head.
    fine : (n, c) float32
        Refined values.
    weights : (n,) float64
        Weight of each row's squared error.
    """
    size = np.array(radices, np.float64)
    step = grid.step.astype(np.float64)
    levels = (grid.levels + np.array(radices, np.uint32) - 1) // np.array(radices, np.uint32)
    low = np.array(grid.minimum, np.float64)
    high = np.array(grid.maximum, np.float64)
    weights = weights / weights.sum()
    for component in range(grid.components):
        if radices[component] == 1:
            continue
        code = coarse_codes[:, component].astype(np.float64)
        value = fine[:, component].astype(np.float64)
        even = size[component] * step[component]
        centre, mean = weights @ code, weights @ value
        spread = weights @ np.square(code - centre)
        width = weights @ ((code - centre) * (value - mean)) / spread if spread > 0 else even
        width = min(max(width, _STRETCH[0] * even), _STRETCH[1] * even)
        low[component] = mean - centre * width
        high[component] = low[component] + (int(levels[component]) - 1) * width
    return Grid(low.astype(np.float32), high.astype(np.float32), levels.astype(np.uint32))
