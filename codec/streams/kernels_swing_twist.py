"""Compiled reading of rotations as swing and twist (SPEC 6.11)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import swing_twist
from .adaptive_step import MAX_COEFFICIENT, MAX_EXTRA_BITS
from .kernels_adaptive_step import count_extra_bits
from .kernels_bits import inner_exact, read_floats
from .kernels_planes import FIRST_PLANE, PARAMS, PLANES, ChunkPlanes, plane_start

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

GROUPS: Final = swing_twist.SYMBOL_BITS + 1
"""Number of groups of rows: one without extra bits, and one for each plane of symbols."""


@inner_exact
def _count_rows(scales: F32, coefficients: F32, knees: F32, extra: U8, counts: I64) -> None:
    """Compute the extra bits of swing and twist (SPEC 6.10) and the sizes of their planes.

    Parameters
    ----------
    scales : (n, 3) float32
        Log scales of the head alone.
    coefficients : (2, 6) float32
        Step models of swing and twist.
    knees : (4,) float32
        `adaptive_step.KNEES`.
    extra : (2, n) uint8, out
        Extra bits of each row.
    counts : (2, GROUPS + 1) int64, out
        Number of rows in each group, then the total number of low bits.
    """
    counts[:] = 0
    for which in range(2):
        rows = count_extra_bits(scales, coefficients[which], knees, extra[which])
        for bits in range(MAX_EXTRA_BITS + 1):
            group = min(bits, GROUPS - 1)
            counts[which, group] += rows[bits]
            counts[which, GROUPS] += rows[bits] * (bits - group)


@inner_exact
def _component_positions(data: U8, starts: I64, counts: I64) -> tuple[I64, I64, bool]:
    """Return the start positions of the symbols and the low bits of each component.

    Parameters
    ----------
    data : uint8
        Decompressed planes of the chunk.
    starts : (3 · GROUPS,) int64
        Byte position of each plane, component by component.
    counts : (2, GROUPS + 1) int64
        Output of `_count_rows`.

    Returns
    -------
    symbols : (3, GROUPS) int64
        Byte position of the symbols of each component and group.
    bits : (3,) int64
        Bit position of the low bits of each component.
    valid : bool
        False if padding bits are set.
    """
    symbols = np.zeros((3, GROUPS), np.int64)
    bits = np.zeros(3, np.int64)
    valid = True
    for column in range(3):
        for group in range(1, GROUPS):
            symbols[column, group] = starts[column * GROUPS + group - 1]
        at = starts[column * GROUPS + GROUPS - 1]
        low = counts[column >> 1, GROUPS]
        bits[column] = 8 * at
        if low & 7 and int(data[at + (low >> 3)]) >> (low & 7):
            valid = False
    return symbols, bits, valid


@inner_exact
def _decode_rotations(data: U8, starts: I64, extra: U8, counts: I64, steps: F32, out: F32) -> bool:
    """Decode swing and twist to unit quaternions; return False if a code or padding is invalid.

    Parameters
    ----------
    data : uint8
        Decompressed planes of the chunk, with at least two more bytes at the end.
    starts : (3 · GROUPS,) int64
        Position of each plane.
    extra, counts
        See `_count_rows`.
    steps : (MAX_EXTRA_BITS + 1,) float32
        Quantiser step for each number of extra bits.
    out : (n, 4) float32
        Output, wxyz.
    """
    symbols, bits, valid = _component_positions(data, starts, counts)
    if not valid:
        return False
    one = np.float32(1)
    components = np.empty(3, np.float32)
    for row in range(len(out)):
        for column in range(3):
            wide = int(extra[column >> 1, row])
            if not wide:
                components[column] = 0
                continue
            group = min(wide, GROUPS - 1)
            low = wide - group
            code = int(data[symbols[column, group]])
            symbols[column, group] += 1
            if low:
                byte, shift = bits[column] >> 3, bits[column] & 7
                pair = int(data[byte]) | int(data[byte + 1]) << 8
                code = (code << low) | ((pair >> shift) & ((1 << low) - 1))
                bits[column] += low
            if code > 1 << wide:
                return False
            components[column] = np.float32(code) * steps[wide] - one
        a, b, c = components[0], components[1], components[2]
        x = a + b * c
        y = b - a * c
        norm = np.sqrt(((one + x * x) + y * y) + c * c)
        out[row, 0] = one / norm
        out[row, 1] = x / norm
        out[row, 2] = y / norm
        out[row, 3] = c / norm
    return True


@inner_exact
def read_rotations(
    planes: ChunkPlanes, stream: I64, knees: F32, steps: F32, scales: F32, out: F32
) -> bool:
    """Decode the rotations of a chunk; return False if the stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream : (6,) int64
        Row of `ChunkPlanes.records`.
    knees : (4,) float32
        `adaptive_step.KNEES`.
    steps : (MAX_EXTRA_BITS + 1,) float32
        `swing_twist.STEPS`.
    scales : (n, 3) float32
        Log scales of the head alone.
    out : (n, 4) float32
    """
    data = planes.data
    rows = len(out)
    models = np.empty((2, 6), np.float32)
    at = stream[PARAMS]
    valid = read_floats(data, at, 6, MAX_COEFFICIENT, models[0])
    valid = valid and read_floats(data, at + 24, 6, MAX_COEFFICIENT, models[1])
    if not valid or stream[PLANES] != 3 * GROUPS:
        return False
    extra = np.empty((2, rows), np.uint8)
    counts = np.empty((2, GROUPS + 1), np.int64)
    _count_rows(scales, models, knees, extra, counts)
    starts = np.zeros(3 * GROUPS, np.int64)
    for column in range(3):
        for group in range(1, GROUPS + 1):
            length = counts[column >> 1, group]
            if group == GROUPS:
                length = length + 7 >> 3
            plane = column * GROUPS + group - 1
            start = plane_start(planes, stream[FIRST_PLANE] + plane, length)
            if start < 0:
                return False
            starts[plane] = start
    return _decode_rotations(data, starts, extra, counts, steps, out)
