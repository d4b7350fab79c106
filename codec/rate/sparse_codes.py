"""Codes of sparse coordinates, chosen by error and bits together (SPEC 6.14)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams.shn_transform import coordinate_groups

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Price of a bit here, relative to the error that it removes from a value elsewhere. At 0.5, four
# trained scenes (pruned to 12 to 29 % of their splats, in 36 to 109 kB) are shown 0.02 to 0.17 dB
# better than with rounded codes in equal bytes. At 0.35 they lose up to 0.05 dB of that; at 1 two
# of them lose 0.06 and 0.16 dB.
_PRICE: Final = 0.5
# Least cost of an error, relative to the mean cost in the chunk. A splat that no scored view shows
# costs nothing, and would get zeros as coordinates. Other views may show it.
_LEAST_COST: Final = 1 / 16
# Added to each count, so that unused codes have a finite cost (Krichevsky and Trofimov 1981).
_PRIOR_COUNT: Final = 0.5
# Symbols beyond this one are counted as this one.
_LAST_SYMBOL: Final = 1023


def choose_codes(positions: F64, costs: F64, bit_price: float, shrink: float, rounded: I64) -> I64:
    """Choose the codes of a chunk that have the least error plus price of the bits.

    All splats of a chunk share a step. A splat that shows more than the mean gets the nearest
    codes. One that shows less gets smaller codes, and more of its coordinates are zero.

    Parameters
    ----------
    positions : (n, W) float64
        Coordinates before rounding, in steps.
    costs : (n,) float64
        Squared error of the picture by an error of one step in a coordinate of each splat.
    bit_price : float
        Squared error that a bit removes elsewhere.
    shrink : float
        Part of a step by which decoders reduce the magnitude of non-zero coordinates.
    rounded : (n, W) int64
        Rounded coordinates; their frequencies give the bits of a code.

    Returns
    -------
    (n, W) int64
        Codes: signed multiples of the step.

    Notes
    -----
    Of each splat, the codes up to its last that is not zero are stored (`shn_transform.write`): an
    inner code costs other bits than a last one. Candidates are the nearest code, the next one
    towards zero, and zero. The best inner and the best last code of each coordinate do not depend
    on other coordinates, so that comparing all ends finds the best codes for given frequencies.
    """
    count, width = positions.shape
    if not count or not width:
        return rounded
    price = _PRICE * bit_price
    costs = np.maximum(costs, _LEAST_COST * costs.mean())
    groups = coordinate_groups(width)
    group_of = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    inner_bits, last_bits, end_bits = _bits(rounded, group_of)
    size, negative = np.abs(positions), positions < 0
    nearest = np.rint(size).astype(np.int64)
    candidates = [np.zeros_like(nearest), np.maximum(nearest - 1, 0), nearest]
    inner, last = [], []
    for magnitudes in candidates:
        missed = size - np.where(magnitudes > 0, magnitudes - shrink, 0.0)
        error = costs[:, None] * np.square(missed)
        symbols = _symbols(magnitudes, negative)
        inner.append(error + price * inner_bits[group_of, symbols])
        # The last code is not zero.
        ending = error + price * last_bits[group_of, symbols]
        last.append(np.where(magnitudes > 0, ending, np.inf))
    # Totals by the number of coordinates up to the last that is not zero.
    totals = np.tile(price * end_bits, (count, 1))
    totals[:, 2:] += np.cumsum(np.min(inner, axis=0), axis=1)[:, :-1]
    totals[:, 1:] += np.min(last, axis=0)
    dropped = costs[:, None] * np.square(size)
    totals[:, :-1] += np.cumsum(dropped[:, ::-1], axis=1)[:, ::-1]
    ends = totals.argmin(axis=1)[:, None]
    place = np.arange(1, width + 1)
    choice = np.where(place == ends, np.argmin(last, axis=0), np.argmin(inner, axis=0))
    codes = np.choose(choice, candidates) * np.where(negative, -1, 1)
    return np.where(place <= ends, codes, 0)


def _symbols(magnitudes: I64, negative: NDArray[np.bool_]) -> I64:
    """Return the numbers that stand for signed codes (SPEC 6.14), limited to `_LAST_SYMBOL`."""
    symbols = np.where((magnitudes > 0) & ~negative, 2 * magnitudes - 1, 2 * magnitudes)
    return np.minimum(symbols, _LAST_SYMBOL)


def _bits(codes: I64, group_of: I64) -> tuple[F64, F64, F64]:
    """Return the bits of codes by their frequencies.

    Parameters
    ----------
    codes : (n, W) int64
        Codes of all splats.
    group_of : (W,) int64
        Group of each coordinate; the coordinates of a group share their planes.

    Returns
    -------
    inner, last : (G, s) float64
        Bits of each symbol as an inner and as a last code, by group.
    ends : (W + 1,) float64
        Bits of each number of coordinates up to the last that is not zero.
    """
    width = codes.shape[1]
    place = np.arange(1, width + 1)
    ends = ((codes != 0) * place).max(axis=1)
    shape = int(group_of[-1]) + 1, _LAST_SYMBOL + 1
    at = _symbols(np.abs(codes), codes < 0) + group_of * shape[1]
    inner, last = (
        np.bincount(at[chosen], minlength=shape[0] * shape[1]).reshape(shape)
        for chosen in (place < ends[:, None], place == ends[:, None])
    )
    by_end = np.bincount(ends, minlength=width + 1)[None]
    return _bits_of_counts(inner), _bits_of_counts(last), _bits_of_counts(by_end)[0]


def _bits_of_counts(counts: I64) -> F64:
    """Return the bits of each symbol from its counts, (m, s), by row."""
    total = counts.sum(axis=1, keepdims=True) + _PRIOR_COUNT
    bits: F64 = np.log2(total) - np.log2(np.maximum(counts, _PRIOR_COUNT))
    return bits
