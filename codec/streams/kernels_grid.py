"""Compiled reading of streams on a grid: scalar, quat, differences, sh0 (SPEC 6.4 and others)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import grid_planes, quaternion, refinement_digits, scalar, sh0_transform
from .grid import Grid
from .inputs import Inputs
from .kernels_bits import exact, inner_exact
from .kernels_planes import join, join_run
from .records import StoredStream

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], Tuple((float32[::1], float32[::1], uint32[::1])), "
    "int64, float32[:, ::1]"
)
@exact
def grid_rows(planes: U8, starts: I64, grid: tuple[F32, F32, U32], extra: int, out: F32) -> bool:
    """Write (rows, c) values from byte planes (SPEC 6.4).

    Parameters
    ----------
    planes : uint8
    starts : int64
        Where each plane begins.
    grid : tuple
        Minimum, maximum and levels of each component.
    extra : int
        2 where two codes above the levels stand for infinities, 0 elsewhere.
    out : (rows, c) float32

    Returns
    -------
    bool
        False where a code is out of range.
    """
    rows, components = out.shape
    minimum, maximum, levels = grid
    plane = 0
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
            at = starts[plane]
            for row in range(rows):
                code = int(planes[at + row])
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        else:
            for row in range(rows):
                code = 0
                for byte in range(count):
                    code |= int(planes[starts[plane + byte] + row]) << (8 * byte)
                top = max(top, code)
                out[row, column] = np.float32(code) * width + low
        if top >= limit:
            return False
        if extra:
            for row in range(rows):
                code = 0
                for byte in range(count):
                    code |= int(planes[starts[plane + byte] + row]) << (8 * byte)
                if code == limit - 2:
                    out[row, column] = np.inf
                elif code == limit - 1:
                    out[row, column] = -np.inf
        plane += count
    return True


@inner_exact
def _spread_codes(codes: I32, width: np.float32, low: np.float32, column: int, out: F32) -> None:
    """Write what codes of a grid are worth into a column."""
    # Into a run first, then apart: only runs are done several at a time.
    run = np.empty(len(codes), np.float32)
    for row in range(len(codes)):
        run[row] = np.float32(codes[row]) * width + low
    for row in range(len(codes)):
        out[row, column] = run[row]


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], Tuple((float32[::1], float32[::1], uint32[::1])), "
    "int64[::1], Tuple((float32[::1], float32[::1], uint32[::1])), float32[:, ::1], "
    "float32[:, ::1]"
)
@exact
def digit_rows(
    planes: U8,
    starts: I64,
    coarse: tuple[F32, F32, U32],
    radices: I64,
    fine: tuple[F32, F32, U32],
    coarse_out: F32,
    out: F32,
) -> bool:
    """Write (rows, c) values from byte planes and digits (SPEC 6.16).

    Parameters
    ----------
    planes : uint8
    starts : int64
        Where each plane of the codes begins, and then each of the digits.
    coarse, fine : tuple
        Minimum, maximum and levels of each component.
    radices : (c,) int64
        Components of radix 1 have no digits.
    coarse_out : (rows, c) float32
        The values of the codes alone; may have no rows.
    out : (rows, c) float32

    Returns
    -------
    bool
        False where a code or a digit is out of range.
    """
    rows, components = out.shape
    plane = 0
    digit = 0
    for column in range(components):
        while int(coarse[2][column]) - 1 >> 8 * (digit - plane):
            digit += 1
        plane = digit
    plane = 0
    codes = np.empty(rows, np.int32)
    for column in range(components):
        limit = int(coarse[2][column])
        count = 0
        while limit - 1 >> 8 * count:
            count += 1
        codes[:] = 0
        for byte in range(count):
            octets = planes[starts[plane] : starts[plane] + rows]
            for row in range(rows):
                codes[row] |= np.int32(octets[row]) << np.int32(8 * byte)
            plane += 1
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
            digits_of = planes[starts[digit] : starts[digit] + rows]
            digit += 1
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


@called_with("float32[:, ::1], float32[:, ::1]")
@exact
def accumulate(differences: F32, out: F32) -> None:
    """Write log scales from their differences (SPEC 6.12)."""
    for row in range(len(out)):
        middle = differences[row, 0] - differences[row, 1]
        out[row, 0] = middle
        out[row, 1] = middle - differences[row, 2]
        out[row, 2] = differences[row, 0]


@called_with("float32[:, ::1], float32[:, ::1], float32[:, ::1]")
@exact
def on_axes(values: F32, axes: F32, out: F32) -> None:
    """Write sh0 from coordinates on axes (SPEC 6.13)."""
    for row in range(len(out)):
        a, b, c = values[row, 0], values[row, 1], values[row, 2]
        for channel in range(3):
            out[row, channel] = (a * axes[0, channel] + b * axes[1, channel]) + c * axes[2, channel]


def _read(stream: StoredStream, grid: Grid, out: F32, *, first: int = 0, extra: int = 0) -> bool:
    """Write the values of the planes of a grid, as `grid_planes.read_values` does."""
    count = sum(grid_planes.plane_counts(grid, extra))
    stream.require_planes(first + count)
    planes = join_run(stream, first, [stream.rows] * count)
    starts = np.arange(count) * stream.rows
    return grid_rows(planes, starts, (grid.minimum, grid.maximum, grid.levels), extra, out)


def _read_refined(
    stream: StoredStream, grid: Grid, digits: StoredStream, out: F32, coarse: F32 | None = None
) -> bool:
    """Write the values of a stream and its digits, as `refinement_digits.read` does."""
    fine, radices = refinement_digits.parse(digits, grid.components)
    count = sum(grid_planes.plane_counts(grid))
    stream.require_planes(count)
    finer = sum(radix > 1 for radix in radices)
    runs = [(stream, 0, [stream.rows] * count), (digits, 0, [stream.rows] * finer)]
    return digit_rows(
        join(runs),
        np.arange(count + finer) * stream.rows,
        (grid.minimum, grid.maximum, grid.levels),
        np.array(radices, np.int64),
        (fine.minimum, fine.maximum, fine.levels),
        out[:0] if coarse is None else coarse,
        out,
    )


def read_scalar(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `scalar.read` does; False where a code is out of range."""
    grid = scalar.parse(stream, out.shape[1])
    if inputs.refinement is None:
        return _read(stream, grid, out, extra=scalar.extra_codes(stream))
    return _read_refined(stream, grid, inputs.refinement, out, inputs.coarse)


def read_quats(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `quaternion.read` does; False where a code is out of range."""
    largest, grid = quaternion.parse(stream)
    others = np.empty((stream.rows, 3), np.float32)
    which = quaternion.left_out(stream, largest, grid)
    if not _read(stream, grid, others, first=0 if which is None else 1):
        return False
    quaternion.complete(largest, which, others, out)
    return True


def read_differences(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `scale_differences.read` does; False where a code is out of range."""
    grid = scalar.parse(stream, 3)
    differences = np.empty((stream.rows, 3), np.float32)
    if inputs.refinement is None:
        if not _read(stream, grid, differences):
            return False
    else:
        alone = None if inputs.coarse is None else np.empty_like(differences)
        if not _read_refined(stream, grid, inputs.refinement, differences, alone):
            return False
        if inputs.coarse is not None and alone is not None:
            accumulate(alone, inputs.coarse)
    accumulate(differences, out)
    return True


def read_sh0(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `sh0_transform.read` does; False where a code is out of range."""
    grid, axes = sh0_transform.parse(stream)
    coordinates = np.empty((stream.rows, 3), np.float32)
    if inputs.refinement is None:
        found = _read(stream, grid, coordinates)
    else:
        found = _read_refined(stream, grid, inputs.refinement, coordinates)
    if found:
        on_axes(coordinates, axes, out)
    return found
