"""Codes of sparse coordinates, chosen by error and bits together (SPEC 6.14)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.jit import inner_kernel, kernel
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
    codes = np.zeros((count, width), np.int64)
    _choose(
        np.ascontiguousarray(positions, np.float64),
        costs,
        shrink,
        group_of,
        price * inner_bits,
        price * last_bits,
        price * end_bits,
        codes,
    )
    return codes


@called_with(
    "float64[:, ::1], float64[::1], float64, int64[::1], float64[:, ::1], float64[:, ::1], "
    "float64[::1], int64[:, ::1]"
)
@kernel
def _choose(
    positions: F64,
    costs: F64,
    shrink: float,
    group_of: I64,
    inner_prices: F64,
    last_prices: F64,
    end_prices: F64,
    codes: I64,
) -> None:
    """Write the codes of least cost to `codes`, (n, W) zeros; see `choose_codes` and `_bits`."""
    count, width = positions.shape
    inner = np.empty(width, np.int64)
    last = np.empty(width, np.int64)
    # Error of the coordinates from each one on, where zeros are decoded for them.
    dropped = np.zeros(width + 1, np.float64)
    for i in range(count):
        cost = costs[i]
        for j in range(width - 1, -1, -1):
            dropped[j] = dropped[j + 1] + cost * positions[i, j] * positions[i, j]
        least, end = end_prices[0] + dropped[0], 0
        before = 0.0
        for j in range(width):
            size, group = abs(positions[i, j]), group_of[j]
            nearest = int(np.rint(size))
            least_inner, least_last = np.inf, np.inf
            last[j] = 0
            for magnitude in (0, max(nearest - 1, 0), nearest):
                missed = size - magnitude + (shrink if magnitude > 0 else 0.0)
                symbol = _symbol(magnitude, positions[i, j] < 0.0)
                total = cost * missed * missed + inner_prices[group, symbol]
                if total < least_inner:
                    least_inner, inner[j] = total, magnitude
                total = cost * missed * missed + last_prices[group, symbol]
                # The last code is not zero.
                if magnitude > 0 and total < least_last:
                    least_last, last[j] = total, magnitude
            total = before + least_last + end_prices[j + 1] + dropped[j + 1]
            if total < least:
                least, end = total, j + 1
            before += least_inner
        for j in range(end):
            chosen = inner[j] if j + 1 < end else last[j]
            codes[i, j] = -chosen if positions[i, j] < 0.0 else chosen


@inner_kernel
def _symbol(magnitude: int, negative: bool) -> int:
    """Return the number that stands for a signed code (SPEC 6.14), limited to `_LAST_SYMBOL`."""
    symbol = 2 * magnitude
    if magnitude > 0 and not negative:
        symbol -= 1
    return min(symbol, _LAST_SYMBOL)


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
    shape = int(group_of[-1]) + 1, _LAST_SYMBOL + 1
    inner, last = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    ends = np.zeros((1, codes.shape[1] + 1), np.int64)
    _count(np.ascontiguousarray(codes), group_of, inner, last, ends[0])
    return _bits_of_counts(inner), _bits_of_counts(last), _bits_of_counts(ends)[0]


@called_with("int64[:, ::1], int64[::1], int64[:, ::1], int64[:, ::1], int64[::1]")
@kernel
def _count(codes: I64, group_of: I64, inner: I64, last: I64, ends: I64) -> None:
    """Add the frequencies of codes to three arrays of the shapes of `_bits`."""
    count, width = codes.shape
    for i in range(count):
        end = width
        while end > 0 and codes[i, end - 1] == 0:
            end -= 1
        ends[end] += 1
        for j in range(end):
            counts = inner if j + 1 < end else last
            counts[group_of[j], _symbol(abs(codes[i, j]), codes[i, j] < 0)] += 1


def _bits_of_counts(counts: I64) -> F64:
    """Return the bits of each symbol from its counts, (m, s), by row."""
    total = counts.sum(axis=1, keepdims=True) + _PRIOR_COUNT
    bits: F64 = np.log2(total) - np.log2(np.maximum(counts, _PRIOR_COUNT))
    return bits
