"""Compiled reading of shN from coordinates on a basis (SPEC 6.14)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .kernels_bits import inner_exact, read_floats, signed, u16
from .kernels_planes import (
    FIRST_PLANE,
    PARAM_BYTES,
    PARAMS,
    PLANES,
    ChunkPlanes,
    plane_start,
    plane_starts,
)
from .shn_transform import MAX_BASIS_ROWS, MAX_FACTOR

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

BASIS_COLUMNS: Final = 48
"""Columns of a basis padded with zeros from 45 to a multiple of the vector width."""

_FULL_COLUMNS: Final = 45


@inner_exact
def _coordinate(symbol: int, step: np.float32, shrink: np.float32) -> np.float32:
    """Return the coordinate of one symbol (SPEC 6.14)."""
    magnitude = np.float32((symbol + 1) >> 1)
    value = (magnitude - shrink) * step if symbol > 0 else np.float32(0) * step
    return value if symbol & 1 else -value


@inner_exact
def _symbol(data: U8, begin: I64, place: int, count: int) -> int:
    """Return symbol number `place` of `count` byte planes that begin at positions `begin`."""
    symbol = 0
    for byte in range(count):
        symbol |= int(data[begin[byte] + place]) << (8 * byte)
    return symbol


@inner_exact
def _rows_above(ends: U8, width: int) -> I64:
    """Return the number of rows with more than 0, 1, … `width` coordinates, (width + 2,)."""
    counts = np.zeros(width + 2, np.int64)
    for row in range(len(ends)):
        if ends[row]:
            counts[ends[row] - 1] += 1
    for column in range(width - 1, -1, -1):
        counts[column] += counts[column + 1]
    return counts


@inner_exact
def _decode_coefficients(
    ends: U8,
    above: I64,
    groups: I64,
    sizes: U8,
    data: U8,
    starts: I64,
    basis: F32,
    step: np.float32,
    shrink: np.float32,
    out: F32,
) -> None:
    """Compute shN from coordinates on a basis (SPEC 6.14).

    Parameters
    ----------
    ends : (n,) uint8
        Number of coordinates of each row, at most the width.
    above : (width + 2,) int64
        Number of rows with more than 0, 1, … coordinates.
    groups : (g + 1,) int64
        First column of each group, then the width.
    sizes : (2g,) uint8
        For each group, bytes per inner symbol and bytes per last symbol (`Parameters.sizes`).
    data : uint8
    starts : int64
        Position of each plane of symbols.
    basis : (width, BASIS_COLUMNS) float32
    step, shrink : float32
        Quantiser step, and the part of a step by which magnitudes are reduced.
    out : (n, at most BASIS_COLUMNS) float32
    """
    width = groups[-1]
    # A constant length lets the compiler drop the remainder loop.
    full = out.shape[1] == _FULL_COLUMNS
    # Position of each byte of a column's symbols: inner symbols, then last ones.
    begin = np.zeros((2, width + 1, 3), np.int64)
    size = np.zeros((2, width + 1), np.int64)
    plane = 0
    for group in range(len(groups) - 1):
        for part in range(2):
            length = 0
            for column in range(groups[group], groups[group + 1]):
                count = int(sizes[2 * group + part])
                size[part, column] = count
                for byte in range(count):
                    begin[part, column, byte] = starts[plane + byte] + length
                inner = above[column + 1]
                length += above[column] - inner if part else inner
            plane += sizes[2 * group + part]
    table = np.empty((2, 256), np.float32)
    for symbol in range(256):
        table[0, symbol] = _coordinate(symbol, step, shrink)
        table[1, symbol] = _coordinate(symbol + 1, step, shrink)
    rank = above.copy()
    sums = np.empty(BASIS_COLUMNS, np.float32)
    columns = np.empty(width + 1, np.int64)
    values = np.empty(width + 1, np.float32)
    for row in range(len(ends)):
        end = int(ends[row])
        if end == 0:
            for k in range(out.shape[1]):
                out[row, k] = 0
            continue
        place = rank[end]
        rank[end] += 1
        # About half of the coordinates are 0 and add nothing: sums start at +0, so signs of zeros
        # stay as well. They are collected first, without a branch that cannot be predicted.
        used = 0
        for column in range(end - 1):
            count = size[0, column]
            if count == 1:
                symbol = int(data[begin[0, column, 0] + place])
            else:
                symbol = _symbol(data, begin[0, column], place, count)
            columns[used] = column
            if symbol < 256:
                values[used] = table[0, symbol]
            else:
                values[used] = _coordinate(symbol, step, shrink)
            used += symbol != 0
        for k in range(BASIS_COLUMNS):
            sums[k] = 0
        for i in range(used):
            value = values[i]
            column = columns[i]
            for k in range(BASIS_COLUMNS):
                sums[k] = sums[k] + value * basis[column, k]
        column = end - 1
        count = size[1, column]
        place -= above[end]
        if count == 1:
            value = table[1, data[begin[1, column, 0] + place]]
        else:
            symbol = _symbol(data, begin[1, column], place, count)
            value = _coordinate(symbol + 1, step, shrink)
        if full:
            for k in range(_FULL_COLUMNS):
                out[row, k] = sums[k] + value * basis[column, k]
        else:
            for k in range(out.shape[1]):
                out[row, k] = sums[k] + value * basis[column, k]


@inner_exact
def read_coefficients(
    planes: ChunkPlanes, stream: I64, group_starts: I64, basis: F32, out: F32
) -> bool:
    """Decode the shN of a chunk; return False if the stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream : (6,) int64
        Row of `ChunkPlanes.records`.
    group_starts : int64
        `shn_transform.GROUP_STARTS`.
    basis : (C, d) float32
        Rows of the colour codebook.
    out : (n, d) float32
        d at most `BASIS_COLUMNS`.
    """
    data = planes.data
    rows, columns = out.shape
    at = stream[PARAMS]
    factors = np.empty(2, np.float32)
    if not read_floats(data, at + 4, 2, MAX_FACTOR, factors):
        return False
    step, shrink = factors[0], factors[1]
    width, reserved = u16(data, at + 12), u16(data, at + 14)
    if width > min(len(basis), MAX_BASIS_ROWS) or reserved:
        return False
    if not step > 0 or not shrink >= 0 or not shrink <= np.float32(0.5):
        return False
    groups = np.empty(len(group_starts) + 1, np.int64)
    count = 0
    for start in group_starts:
        if start < width:
            groups[count] = start
            count += 1
    groups[count] = width
    groups = groups[: count + 1]
    if stream[PARAM_BYTES] != 16 + 2 * count:
        return False
    sizes = data[at + 16 : at + 16 + 2 * count]
    plane_count = 1
    for size in sizes:
        if size > 3:
            return False
        plane_count += signed(size)
    if stream[PLANES] != plane_count:
        return False
    padded = np.zeros((width, BASIS_COLUMNS), np.float32)
    for row in range(width):
        for column in range(columns):
            if not abs(np.float64(basis[row, column])) <= MAX_FACTOR:
                return False
            padded[row, column] = basis[row, column]
    first = stream[FIRST_PLANE]
    start = plane_start(planes, first, rows)
    if start < 0:
        return False
    ends = data[start : start + rows]
    top = 0
    for row in range(rows):
        top = max(top, signed(ends[row]))
    if top > width:
        return False
    above = _rows_above(ends, width)
    starts = np.zeros(plane_count, np.int64)
    plane = 0
    for group in range(count):
        a, b = groups[group], groups[group + 1]
        inner = 0
        for column in range(a, b):
            inner += above[column + 1]
        for part in range(2):
            own = signed(sizes[2 * group + part])
            length = above[a] - above[b] if part else inner
            if not plane_starts(planes, first + 1 + plane, own, length, starts, plane):
                return False
            plane += own
    _decode_coefficients(ends, above, groups, sizes, data, starts, padded, step, shrink, out)
    return True
