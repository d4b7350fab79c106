"""Compiled reading of streams on a grid, with and without refinement (SPEC 6.4, 6.12, 6.16)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .grid import MAX_LEVELS, MAX_VALUE
from .kernels_bits import inner_exact, signed, u32
from .kernels_planes import FIRST_PLANE, PARAMS, PLANES, PRESENT, ChunkPlanes, plane_starts
from .refinement_digits import MAX_RADIX

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


class GridArrays(NamedTuple):
    """Minimum, maximum and number of levels of each component of a grid, (c,) each."""

    minimum: F32
    maximum: F32
    levels: U32


@inner_exact
def parse_grid(
    data: U8, at: int, components: int, max_levels: int, max_value: float
) -> tuple[bool, GridArrays]:
    """Return whether the grid at byte `at` is valid, and the grid (SPEC 6.4)."""
    bits = np.empty((3, components), np.uint32)
    for component in range(components):
        for field in range(3):
            bits[field, component] = u32(data, at + 12 * component + 4 * field)
    low, high = bits[0].view(np.float32), bits[1].view(np.float32)
    levels = bits[2].copy()
    valid = True
    for component in range(components):
        a, b = np.float64(low[component]), np.float64(high[component])
        if not (a >= -max_value and a <= b and b <= max_value):
            valid = False
        if levels[component] < 1 or levels[component] > max_levels:
            valid = False
    return valid, GridArrays(low.copy(), high.copy(), levels)


@inner_exact
def plane_count(levels: U32) -> int:
    """Return the number of planes that codes on a grid have (SPEC 6.4)."""
    planes = 0
    for limit in levels:
        count = 0
        while signed(limit) - 1 >> 8 * count:
            count += 1
        planes += count
    return planes


@inner_exact
def decode_values(data: U8, starts: I64, grid: GridArrays, out: F32) -> bool:
    """Decode byte planes to (rows, c) values; return False if a code is out of range (SPEC 6.4).

    Parameters
    ----------
    data : uint8
        Decompressed planes of the chunk.
    starts : int64
        Position of each plane, bytes.
    grid : GridArrays
    out : (rows, c) float32
    """
    rows, components = out.shape
    plane = 0
    for column in range(components):
        limit = int(grid.levels[column])
        count = 0
        while limit - 1 >> 8 * count:
            count += 1
        low = grid.minimum[column]
        width = np.float32(0)
        if limit > 1:
            width = (grid.maximum[column] - low) / (np.float32(limit) - np.float32(1))
        top = 0
        if count == 1:
            at = starts[plane]
            for row in range(rows):
                code = int(data[at + row])
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        else:
            for row in range(rows):
                code = 0
                for byte in range(count):
                    code |= int(data[starts[plane + byte] + row]) << (8 * byte)
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        if top >= limit:
            return False
        plane += count
    return True


@inner_exact
def _dequantise_column(
    codes: I32, width: np.float32, low: np.float32, column: int, out: F32
) -> None:
    """Write ``low + code * width``, where `width` is the grid's step, to one column of `out`."""
    # Into a contiguous array first: only that loop is vectorised.
    values = np.empty(len(codes), np.float32)
    for row in range(len(codes)):
        values[row] = np.float32(codes[row]) * width + low
    for row in range(len(codes)):
        out[row, column] = values[row]


@inner_exact
def _decode_refined_values(
    data: U8,
    starts: I64,
    coarse: GridArrays,
    radices: I64,
    fine: GridArrays,
    coarse_out: F32,
    out: F32,
) -> bool:
    """Decode codes on a grid and their refining digits to (rows, c) values (SPEC 6.16).

    Parameters
    ----------
    data : uint8
    starts : int64
        Position of each plane: those of the codes, then those of the digits.
    coarse, fine : GridArrays
        Grids of the head and of the refinement.
    radices : (c,) int64
        Number of fine levels per coarse level; components of radix 1 have no digits.
    coarse_out : (rows, c) float32
        Receives the values of the head alone; no rows if they are not needed.
    out : (rows, c) float32

    Returns
    -------
    bool
        False if a code or a digit is out of range.
    """
    rows, components = out.shape
    plane = 0
    digit = 0
    for column in range(components):
        while int(coarse.levels[column]) - 1 >> 8 * (digit - plane):
            digit += 1
        plane = digit
    plane = 0
    codes = np.empty(rows, np.int32)
    for column in range(components):
        limit = int(coarse.levels[column])
        count = 0
        while limit - 1 >> 8 * count:
            count += 1
        codes[:] = 0
        for byte in range(count):
            plane_bytes = data[starts[plane] : starts[plane] + rows]
            for row in range(rows):
                codes[row] |= np.int32(plane_bytes[row]) << np.int32(8 * byte)
            plane += 1
        top = np.int32(0)
        for row in range(rows):
            top = max(top, codes[row])
        if top >= limit:
            return False
        if len(coarse_out):
            low = coarse.minimum[column]
            width = np.float32(0)
            if limit > 1:
                width = (coarse.maximum[column] - low) / (np.float32(limit) - np.float32(1))
            _dequantise_column(codes, width, low, column, coarse_out)
        radix = np.int32(radices[column])
        if radix > 1:
            digits_of = data[starts[digit] : starts[digit] + rows]
            digit += 1
            top_digit = np.uint8(0)
            for row in range(rows):
                top_digit = max(top_digit, digits_of[row])
            if top_digit >= radix:
                return False
            # Below 2^24 · 16: 28 bits.
            for row in range(rows):
                codes[row] = codes[row] * radix + np.int32(digits_of[row])
        fine_limit = int(fine.levels[column])
        top = np.int32(0)
        for row in range(rows):
            top = max(top, codes[row])
        if top >= fine_limit:
            return False
        low = fine.minimum[column]
        width = np.float32(0)
        if fine_limit > 1:
            width = (fine.maximum[column] - low) / (np.float32(fine_limit) - np.float32(1))
        _dequantise_column(codes, width, low, column, out)
    return True


@inner_exact
def read_values(planes: ChunkPlanes, stream: I64, digits: I64, coarse_out: F32, out: F32) -> bool:
    """Decode the values of a stream on a grid, refined if the chunk has refining digits.

    Parameters
    ----------
    planes : ChunkPlanes
    stream, digits : (6,) int64
        Rows of `ChunkPlanes.records`: the stream, and the digits that refine it.
    coarse_out : (rows, c) float32
        Receives the values without refinement; no rows if they are not needed.
    out : (rows, c) float32

    Returns
    -------
    bool
        False if the stream or its digits are invalid.
    """
    data = planes.data
    rows, components = out.shape
    valid, coarse = parse_grid(data, stream[PARAMS], components, MAX_LEVELS, MAX_VALUE)
    count = stream[PLANES]
    if not valid or count != plane_count(coarse.levels):
        return False
    starts = np.zeros(count + components, np.int64)
    if not plane_starts(planes, stream[FIRST_PLANE], count, rows, starts, 0):
        return False
    if not digits[PRESENT]:
        return decode_values(data, starts, coarse, out)
    at = digits[PARAMS]
    valid, fine = parse_grid(data, at, components, MAX_LEVELS, MAX_VALUE)
    radices = np.empty(components, np.int64)
    finer = 0
    for component in range(components):
        radices[component] = data[at + 12 * components + component]
        if radices[component] < 1 or radices[component] > MAX_RADIX:
            valid = False
        finer += radices[component] > 1
    if not valid or digits[PLANES] != finer:
        return False
    if not plane_starts(planes, digits[FIRST_PLANE], finer, rows, starts, count):
        return False
    return _decode_refined_values(data, starts, coarse, radices, fine, coarse_out, out)


@inner_exact
def scales_from_differences(differences: F32, out: F32) -> None:
    """Compute (rows, 3) log scales from their differences (SPEC 6.12)."""
    for row in range(len(out)):
        middle = differences[row, 0] - differences[row, 1]
        out[row, 0] = middle
        out[row, 1] = middle - differences[row, 2]
        out[row, 2] = differences[row, 0]


@inner_exact
def sh0_from_coordinates(values: F32, axes: F32, out: F32) -> None:
    """Compute (rows, 3) sh0 from coordinates on the three `axes` (SPEC 6.13)."""
    for row in range(len(out)):
        a, b, c = values[row, 0], values[row, 1], values[row, 2]
        for channel in range(3):
            out[row, channel] = (a * axes[0, channel] + b * axes[1, channel]) + c * axes[2, channel]
