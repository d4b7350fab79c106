"""Decoding compiled: the arithmetic of the numpy code beside it, bit for bit.

Kernels that check return False where a value is out of range; the numpy code then says which.
Nothing here fuses products and sums (SPEC 2.2), unlike `render.jit.kernel`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

Function = TypeVar("Function", bound=Callable[..., object])


def _exact(function: Function) -> Function:
    compiled = njit(nogil=True, cache=True, error_model="numpy")(function)
    return cast(Function, compiled)


SYMBOL_GROUPS: Final = 7
"""Halvings 0 to 6 and above: the first has no plane (SPEC 6.11)."""

BASIS_COLUMNS: Final = 48
"""Columns of a basis as the kernel wants it: 45 and zeros, a multiple of the vector width."""

_FULL_COLUMNS: Final = 45

_AXIS_BITS: Final = 21
_AXIS_MASK: Final = (1 << _AXIS_BITS) - 1


def _axes_of_bits() -> U64:
    axes = morton.deinterleave(np.arange(512, dtype=np.uint64)).astype(np.uint64)
    shifts = np.arange(3, dtype=np.uint64) * np.uint64(_AXIS_BITS)
    return np.asarray(np.bitwise_or.reduce(axes << shifts, axis=1))


AXES_OF_BITS: Final = _axes_of_bits()
"""Three bits of each axis, 21 bits apart, of nine bits of a Morton code."""


def words(plane: U8) -> U64:
    """Return the bytes of a plane as 64-bit words, with two of zeros behind them."""
    padded = np.empty((len(plane) + 7 >> 3) + 2, np.uint64)
    octets = padded.view(np.uint8)
    octets[: len(plane)] = plane
    octets[len(plane) :] = 0
    return padded


@_exact
def _window(packed: U64, position: int) -> np.uint64:
    """Return the 64 bits from a position on."""
    index = position >> 6
    shift = np.uint64(position & 63)
    high: np.uint64 = (packed[index + 1] << np.uint64(1)) << (np.uint64(63) - shift)
    window: np.uint64 = high | (packed[index] >> shift)
    return window


@_exact
def _spread(packed: U8, start: int, table: U8, count: int, out: U8, at: int, length: int) -> int:
    """Write the digits of bytes of one radix; return the digits behind the last that are not 0."""
    whole = length // count
    if count == 2:
        for i in range(whole):
            for j in range(2):
                out[at + 2 * i + j] = table[packed[start + i], j]
    elif count == 3:
        for i in range(whole):
            for j in range(3):
                out[at + 3 * i + j] = table[packed[start + i], j]
    elif count == 4:
        for i in range(whole):
            for j in range(4):
                out[at + 4 * i + j] = table[packed[start + i], j]
    elif count == 5:
        for i in range(whole):
            for j in range(5):
                out[at + 5 * i + j] = table[packed[start + i], j]
    else:
        for i in range(whole):
            for j in range(8):
                out[at + 8 * i + j] = table[packed[start + i], j]
    rest = length - whole * count
    beyond = 0
    if rest:
        for j in range(count):
            digit = table[packed[start + whole], j]
            if j < rest:
                out[at + whole * count + j] = digit
            elif digit:
                beyond += 1
    return beyond


@_exact
def digits(packed: U8, spans: I64, tables: U8, out: U8) -> int:
    """Write planes end to end from packed ones (SPEC 6.3, 6.9), and what stands behind the last.

    Parameters
    ----------
    packed : uint8
        Planes end to end, digits still packed.
    spans : (3, p) int64
        Radix (0 where nothing is packed), length in `packed` and in `out` of each plane.
    tables : (17, 256, 8) uint8
        Digits of each byte by radix.
    out : uint8

    Returns
    -------
    int
        The first plane with a byte or digit out of range, -1 where there is none.
    """
    start = 0
    at = 0
    for plane in range(spans.shape[1]):
        radix, size, length = spans[0, plane], spans[1, plane], spans[2, plane]
        if radix:
            count = 1
            limit = radix
            while limit * radix <= 256:
                limit *= radix
                count += 1
            top = 0
            for i in range(start, start + size):
                top = max(top, int(packed[i]))
            if top >= limit or _spread(packed, start, tables[radix], count, out, at, length):
                return plane
        else:
            out[at : at + length] = packed[start : start + size]
        start += size
        at += length
    out[at:] = packed[start:]
    return -1


@_exact
def grid_rows(planes: U8, minimum: F32, maximum: F32, levels: U32, extra: int, out: F32) -> bool:
    """Write (rows, c) values from byte planes end to end (SPEC 6.4).

    `extra` is 2 where two codes above the levels stand for infinities, 0 elsewhere.
    """
    rows, components = out.shape
    at = 0
    for column in range(components):
        limit = int(levels[column]) + extra
        count = 0
        while limit - 1 >> 8 * count:
            count += 1
        low = minimum[column]
        width = np.float32(0)
        if levels[column] > 1:
            width = (maximum[column] - low) / (np.float32(levels[column]) - np.float32(1))
        top = 0
        if count == 1:
            for row in range(rows):
                code = int(planes[at + row])
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        else:
            for row in range(rows):
                code = 0
                for byte in range(count):
                    code |= int(planes[at + byte * rows + row]) << (8 * byte)
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        if top >= limit:
            return False
        if extra:
            for row in range(rows):
                code = 0
                for byte in range(count):
                    code |= int(planes[at + byte * rows + row]) << (8 * byte)
                if code == limit - 2:
                    out[row, column] = np.inf
                elif code == limit - 1:
                    out[row, column] = -np.inf
        at += count * rows
    return True


@_exact
def _spread_codes(codes: I32, width: np.float32, low: np.float32, column: int, out: F32) -> None:
    """Write what codes of a grid are worth into a column."""
    # Into a run first, then apart: only runs are done several at a time.
    run = np.empty(len(codes), np.float32)
    for row in range(len(codes)):
        run[row] = np.float32(codes[row]) * width + low
    for row in range(len(codes)):
        out[row, column] = run[row]


@_exact
def digit_rows(
    planes: U8,
    coarse: tuple[F32, F32, U32],
    first_digit: int,
    radices: I64,
    fine: tuple[F32, F32, U32],
    coarse_out: F32,
    out: F32,
) -> bool:
    """Write (rows, c) values from byte planes and behind them digits, all end to end (SPEC 6.16).

    Digits begin at `first_digit`. `coarse` and `fine` are minimum, maximum and levels; `coarse_out`
    may have no rows.
    """
    rows, components = out.shape
    at = 0
    digit_at = first_digit
    codes = np.empty(rows, np.int32)
    for column in range(components):
        limit = int(coarse[2][column])
        count = 0
        while limit - 1 >> 8 * count:
            count += 1
        codes[:] = 0
        for byte in range(count):
            plane = planes[at : at + rows]
            for row in range(rows):
                codes[row] |= np.int32(plane[row]) << np.int32(8 * byte)
            at += rows
        top = np.int32(0)
        for row in range(rows):
            top = max(top, codes[row])
        if top >= limit:
            return False
        if len(coarse_out):
            low = coarse[0][column]
            width = np.float32(0)
            if limit > 1:
                width = (coarse[1][column] - low) / (np.float32(limit) - np.float32(1))
            _spread_codes(codes, width, low, column, coarse_out)
        radix = np.int32(radices[column])
        if radix > 1:
            digits_of = planes[digit_at : digit_at + rows]
            digit_at += rows
            top_digit = np.uint8(0)
            for row in range(rows):
                top_digit = max(top_digit, digits_of[row])
            if top_digit >= radix:
                return False
            # Below 2^24 · 16: 28 bits.
            for row in range(rows):
                codes[row] = codes[row] * radix + np.int32(digits_of[row])
        fine_limit = int(fine[2][column])
        top = np.int32(0)
        for row in range(rows):
            top = max(top, codes[row])
        if top >= fine_limit:
            return False
        low = fine[0][column]
        width = np.float32(0)
        if fine_limit > 1:
            width = (fine[1][column] - low) / (np.float32(fine_limit) - np.float32(1))
        _spread_codes(codes, width, low, column, out)
    return True


@_exact
def climb(steps: F32, out: F32) -> None:
    """Write the scales of a ladder (SPEC 6.12)."""
    for row in range(len(out)):
        middle = steps[row, 0] - steps[row, 1]
        out[row, 0] = middle
        out[row, 1] = middle - steps[row, 2]
        out[row, 2] = steps[row, 0]


@_exact
def on_axes(values: F32, axes: F32, out: F32) -> None:
    """Write sh0 from coordinates on axes (SPEC 6.13)."""
    for row in range(len(out)):
        a, b, c = values[row, 0], values[row, 1], values[row, 2]
        for channel in range(3):
            out[row, channel] = (a * axes[0, channel] + b * axes[1, channel]) + c * axes[2, channel]


@_exact
def delta_bits(classes: U8) -> int:
    """Return how many bits the differences of these classes take, -1 for a class above 63."""
    total = 0
    top = 0
    for row in range(len(classes)):
        top = max(top, int(classes[row]))
        total += max(int(classes[row]), 1) - 1
    return total if top <= 3 * _AXIS_BITS else -1


@_exact
def _wanted(scales: F32, coefficients: F32, knees: F32, most: int, halved: U8) -> None:
    """Write the halvings that scales ask for (SPEC 6.10)."""
    c0, c1, c2 = coefficients[0], coefficients[1], coefficients[2]
    c3, c4, c5 = coefficients[3], coefficients[4], coefficients[5]
    k0, k1, k2, k3 = knees[0], knees[1], knees[2], knees[3]
    limit = np.float32(most)
    zero = np.float32(0)
    for row in range(len(halved)):
        middle, thin, long = scales[row, 0], scales[row, 1], scales[row, 2]
        p = long - middle
        q = middle - thin
        total = c0 + c1 * long
        total = total + c2 * (p if p < k0 else k0)
        total = total + c3 * (p if p < k1 else k1)
        total = total + c4 * (q if q < k2 else k2)
        total = total + c5 * (q if q < k3 else k3)
        total = total if total < limit else limit
        # Of what is not negative, the integer part is the floor.
        halved[row] = np.uint8(np.int32(total if total > zero else zero))


@_exact
def _halvings(scales: F32, coefficients: F32, knees: F32, most: int, halved: U8) -> I64:
    """Write the halvings that scales ask for (SPEC 6.10); return how many rows have each."""
    _wanted(scales, coefficients, knees, most, halved)
    # Two histograms in turn: a count need not wait for the one before.
    rows = np.zeros((2, most + 1), np.int64)
    for row in range(len(halved)):
        rows[row & 1, halved[row]] += 1
    total_rows: I64 = rows[0] + rows[1]
    return total_rows


@_exact
def gained(scales: F32, coefficients: F32, knees: F32, most: int, halved: U8, out: U8) -> None:
    """Write how many halvings more than `halved` scales ask for (SPEC 6.17)."""
    _wanted(scales, coefficients, knees, most, out)
    for row in range(len(out)):
        out[row] = out[row] - halved[row] if out[row] > halved[row] else 0


@_exact
def turn_plan(
    scales: F32, coefficients: F32, knees: F32, most: int, halved: U8, counts: I64
) -> None:
    """Write what scales ask of tilt and spin (SPEC 6.10, 6.11).

    Parameters
    ----------
    scales : (n, 3) float32
    coefficients : (2, 6) float32
    knees : (4,) float32
    most : int
        Halvings at most.
    halved : (2, n) uint8, out
        Halvings.
    counts : (2, SYMBOL_GROUPS + 1) int64, out
        Rows of each symbol group, and the sum of the halvings beyond the last.
    """
    counts[:] = 0
    for which in range(2):
        rows = _halvings(scales, coefficients[which], knees, most, halved[which])
        for wide in range(most + 1):
            group = min(wide, SYMBOL_GROUPS - 1)
            counts[which, group] += rows[wide]
            counts[which, SYMBOL_GROUPS] += rows[wide] * (wide - group)


@_exact
def gained_plan(halved: U8, extra: U8, counts: I64) -> None:
    """Write what a refinement adds to the turns of a head (SPEC 6.17).

    Parameters
    ----------
    halved, extra : (2, n) uint8
        Halvings of the head and of the refinement.
    counts : (2, SYMBOL_GROUPS + 1) int64, out
        As of `turn_plan`, of the rows without halvings in the head; in column 0 the bits of the
        others.
    """
    counts[:] = 0
    for which in range(2):
        for row in range(halved.shape[1]):
            more = int(extra[which, row])
            if halved[which, row]:
                counts[which, 0] += more
            elif more:
                group = min(more, SYMBOL_GROUPS - 1)
                counts[which, group] += 1
                counts[which, SYMBOL_GROUPS] += more - group


@_exact
def _starts(planes: U8, counts: I64) -> tuple[I64, I64, bool]:
    """Return where symbols and bits of each component start, and whether paddings are zeros."""
    starts = np.zeros((3, SYMBOL_GROUPS), np.int64)
    bits = np.zeros(3, np.int64)
    at = 0
    right = True
    for column in range(3):
        which = column >> 1
        for group in range(1, SYMBOL_GROUPS):
            starts[column, group] = at
            at += counts[which, group]
        spare = counts[which, SYMBOL_GROUPS]
        bits[column] = 8 * at
        at += (spare + 7) >> 3
        if spare & 7 and int(planes[at - 1]) >> (spare & 7):
            right = False
    return starts, bits, right


@_exact
def turns(
    planes: U8,
    halved: U8,
    counts: I64,
    steps: F32,
    extra: U8,
    more_counts: I64,
    below: U8,
    fields: U64,
    out: F32,
) -> bool:
    """Write the unit quaternions of tilt, tilt and spin (SPEC 6.11, 6.17).

    Parameters
    ----------
    planes : uint8
        All planes end to end, and two bytes behind them.
    halved, counts
        As `turn_plan` writes them.
    steps : (most + 1,) float32
        What a code is worth after each number of halvings.
    extra : (2, n) uint8
        Halvings that a refinement adds to tilt and spin; no columns where there is none.
    more_counts : (2, SYMBOL_GROUPS + 1) int64
        As `gained_plan` writes them.
    below : uint8
        The planes of the refinement end to end, and two bytes behind them.
    fields : uint64
        The last of them, as `words` gives it.
    out : (n, 4) float32
    """
    starts, bits, found = _starts(planes, counts)
    more_starts, more_bits, more_found = _starts(below, more_counts)
    if not found or not more_found:
        return False
    one = np.float32(1)
    turned = np.empty(3, np.float32)
    finer = extra.shape[1] > 0
    position = 0
    for row in range(len(out)):
        for column in range(3):
            wide = int(halved[column >> 1, row])
            more = int(extra[column >> 1, row]) if finer else 0
            # Written out twice: a call for each code takes as long as all the rest.
            if wide:
                group = min(wide, SYMBOL_GROUPS - 1)
                spare = wide - group
                code = int(planes[starts[column, group]])
                starts[column, group] += 1
                if spare:
                    byte, shift = bits[column] >> 3, bits[column] & 7
                    pair = int(planes[byte]) | int(planes[byte + 1]) << 8
                    code = (code << spare) | ((pair >> shift) & ((1 << spare) - 1))
                    bits[column] += spare
                if code > 1 << wide:
                    return False
                if more:
                    window = _window(fields, position) & np.uint64((1 << more) - 1)
                    position += more
                    code = (code << more) + int(np.int64(window)) - (1 << (more - 1))
                    wide += more
            elif more:
                group = min(more, SYMBOL_GROUPS - 1)
                spare = more - group
                code = int(below[more_starts[column, group]])
                more_starts[column, group] += 1
                if spare:
                    byte, shift = more_bits[column] >> 3, more_bits[column] & 7
                    pair = int(below[byte]) | int(below[byte + 1]) << 8
                    code = (code << spare) | ((pair >> shift) & ((1 << spare) - 1))
                    more_bits[column] += spare
                wide = more
            else:
                turned[column] = 0
                continue
            if code < 0 or code > 1 << wide:
                return False
            turned[column] = np.float32(code) * steps[wide] - one
        a, b, c = turned[0], turned[1], turned[2]
        x = a + b * c
        y = b - a * c
        norm = np.sqrt(((one + x * x) + y * y) + c * c)
        out[row, 0] = one / norm
        out[row, 1] = x / norm
        out[row, 2] = y / norm
        out[row, 3] = c / norm
    return True


@_exact
def fine_plan(
    classes: U8, scales: F32, coefficients: F32, knees: F32, most: int, halved: U8
) -> tuple[int, int]:
    """Write the halvings of means; return the bits of the deltas and of the fields below them."""
    rows = _halvings(scales, coefficients, knees, most, halved)
    fields = 0
    for wide in range(most + 1):
        fields += 3 * wide * rows[wide]
    return delta_bits(classes), fields


@_exact
def fine_means(
    classes: U8,
    deltas: U64,
    halved: U8,
    fields: U64,
    axes_of_bits: U64,
    levels: I64,
    factors: F32,
    minimum: F32,
    extra: U8,
    extra_fields: U64,
    out: F32,
) -> bool:
    """Write means from Morton deltas and the bits below their cells (SPEC 6.5, 6.15, 6.17).

    `factors` (halvings, 3) is what a code is worth at each number of halvings, `extra` how many a
    refinement adds to each row, with no rows where there is none, and `extra_fields` their bits.
    """
    mask = np.uint64(_AXIS_MASK)
    code = np.uint64(0)
    at = 0
    position = 0
    finer = len(extra) > 0
    extra_position = 0
    for row in range(len(out)):
        bits = int(classes[row])
        if bits:
            leading = np.uint64(1) << np.uint64(bits - 1)
            code += (_window(deltas, at) & (leading - np.uint64(1))) | leading
            at += bits - 1
            if code >> np.uint64(63):
                return False
        cells = np.uint64(0)
        for part in range(7):
            nine = (code >> np.uint64(9 * part)) & np.uint64(511)
            cells |= axes_of_bits[nine] << np.uint64(3 * part)
        wide = int(halved[row])
        low = _window(fields, position)
        position += 3 * wide
        below = (np.uint64(1) << np.uint64(wide)) - np.uint64(1)
        more = int(extra[row]) if finer else 0
        lower = np.uint64(0)
        if more:
            lower = _window(extra_fields, extra_position)
            extra_position += 3 * more
        under = (np.uint64(1) << np.uint64(more)) - np.uint64(1)
        half = (np.int64(1) << np.int64(more)) >> np.int64(1)
        for axis in range(3):
            cell = (cells >> np.uint64(_AXIS_BITS * axis)) & mask
            if np.int64(cell) >= levels[axis]:
                return False
            fine = (cell << np.uint64(wide)) | ((low >> np.uint64(wide * axis)) & below)
            field = (lower >> np.uint64(more * axis)) & under
            level = np.int64((fine << np.uint64(more)) + field) - half
            if level < 0:
                return False
            value = np.float32(level) * factors[wide + more, axis]
            out[row, axis] = value + minimum[axis]
    return True


@_exact
def _coordinate(symbol: int, step: np.float32, shrink: np.float32) -> np.float32:
    magnitude = np.float32((symbol + 1) >> 1)
    value = (magnitude - shrink) * step if symbol > 0 else np.float32(0) * step
    return value if symbol & 1 else -value


@_exact
def _symbol(planes: U8, at: int, count: int, stride: int) -> int:
    code = 0
    for byte in range(count):
        code |= int(planes[at + byte * stride]) << (8 * byte)
    return code


@_exact
def above(ends: U8, width: int) -> I64:
    """Return how many rows have more coordinates than 0, 1, … `width`, and a 0 behind."""
    counts = np.zeros(width + 2, np.int64)
    for row in range(len(ends)):
        if ends[row]:
            counts[ends[row] - 1] += 1
    for column in range(width - 1, -1, -1):
        counts[column] += counts[column + 1]
    return counts


@_exact
def shn(
    ends: U8,
    more: I64,
    groups: I64,
    sizes: U8,
    planes: U8,
    basis: F32,
    step: np.float32,
    shrink: np.float32,
    out: F32,
) -> None:
    """Write shN from coordinates on a basis (SPEC 6.14).

    Parameters
    ----------
    ends : (n,) uint8
        Coordinates of each row, at most the width.
    more : (width + 2,) int64
        As `above` returns it.
    groups : (g + 1,) int64
        First column of each group, and the width.
    sizes : (2g,) uint8
        Bytes of a symbol, before the last coordinate and in it, of each group.
    planes : uint8
        All planes of symbols end to end, whose lengths follow from the above.
    basis : (width, BASIS_COLUMNS) float32
    step, shrink : float32
    out : (n, at most BASIS_COLUMNS) float32
    """
    width = groups[-1]
    # A length that is known is a loop without a remainder.
    full = out.shape[1] == _FULL_COLUMNS
    # Where each column's symbols start and how far apart their bytes are, by part.
    begin = np.zeros((2, width + 1), np.int64)
    stride = np.zeros((2, width + 1), np.int64)
    size = np.zeros((2, width + 1), np.int64)
    at = 0
    for group in range(len(groups) - 1):
        for part in range(2):
            length = 0
            for column in range(groups[group], groups[group + 1]):
                begin[part, column] = at + length
                size[part, column] = sizes[2 * group + part]
                inner = more[column + 1]
                length += more[column] - inner if part else inner
            for column in range(groups[group], groups[group + 1]):
                stride[part, column] = length
            at += length * sizes[2 * group + part]
    table = np.empty((2, 256), np.float32)
    for symbol in range(256):
        table[0, symbol] = _coordinate(symbol, step, shrink)
        table[1, symbol] = _coordinate(symbol + 1, step, shrink)
    rank = more.copy()
    sums = np.empty(BASIS_COLUMNS, np.float32)
    for row in range(len(ends)):
        end = int(ends[row])
        if end == 0:
            for k in range(out.shape[1]):
                out[row, k] = 0
            continue
        place = rank[end]
        rank[end] += 1
        for k in range(BASIS_COLUMNS):
            sums[k] = 0
        for column in range(end - 1):
            count = size[0, column]
            first = begin[0, column] + place
            if count == 1:
                value = table[0, planes[first]]
            else:
                symbol = _symbol(planes, first, count, stride[0, column])
                value = _coordinate(symbol, step, shrink)
            for k in range(BASIS_COLUMNS):
                sums[k] = sums[k] + value * basis[column, k]
        column = end - 1
        count = size[1, column]
        first = begin[1, column] + place - more[end]
        if count == 1:
            value = table[1, planes[first]]
        else:
            symbol = _symbol(planes, first, count, stride[1, column])
            value = _coordinate(symbol + 1, step, shrink)
        if full:
            for k in range(_FULL_COLUMNS):
                out[row, k] = sums[k] + value * basis[column, k]
        else:
            for k in range(out.shape[1]):
                out[row, k] = sums[k] + value * basis[column, k]
