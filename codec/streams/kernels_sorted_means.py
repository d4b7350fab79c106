"""Compiled reading of sorted means (SPEC 6.5, 6.17)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton

from . import sorted_means
from .adaptive_step import MAX_COEFFICIENT, MAX_EXTRA_BITS
from .grid import MAX_VALUE
from .kernels_adaptive_step import count_extra_bits
from .kernels_bits import inner_exact, is_padded, plane_words, read_floats, signed, window
from .kernels_grid import parse_grid
from .kernels_planes import FIRST_PLANE, PARAMS, PLANES, PRESENT, ChunkPlanes, plane_start
from .refinement_bits import MAX_BITS
from .sorted_means import MAX_CELLS

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

_AXIS_BITS: Final = 21
_AXIS_MASK: Final = (1 << _AXIS_BITS) - 1
_MORTON_BITS: Final = sorted_means.MORTON_BITS
# Morton codes are taken apart nine bits at a time, by a lookup table.
_PARTS: Final = -(-_MORTON_BITS // 9)


def _axes_of_bits() -> U64:
    """Compute the lookup table `AXES_OF_BITS`."""
    axes = morton.deinterleave(np.arange(512, dtype=np.uint64)).astype(np.uint64)
    shifts = np.arange(3, dtype=np.uint64) * np.uint64(_AXIS_BITS)
    return np.asarray(np.bitwise_or.reduce(axes << shifts, axis=1))


AXES_OF_BITS: Final = _axes_of_bits()
"""Lookup table by nine bits of a Morton code: three bits of each axis, 21 bits apart, (512,)."""


@inner_exact
def _count_bits(
    classes: U8, scales: F32, coefficients: F32, knees: F32, extra: U8
) -> tuple[int, int]:
    """Compute the extra bits of each row into `extra`; return the bit counts of the packed planes.

    The first count is that of the Morton differences, -1 if a class is above 51. The second is that
    of the bits below the cells.
    """
    rows = count_extra_bits(scales, coefficients, knees, extra)
    fields = 0
    for bits in range(MAX_EXTRA_BITS + 1):
        fields += 3 * bits * rows[bits]
    total = 0
    top = 0
    for row in range(len(classes)):
        top = max(top, int(classes[row]))
        total += max(int(classes[row]), 1) - 1
    return total if top <= _MORTON_BITS else -1, fields


@inner_exact
def _decode_means(
    classes: U8,
    differences: U64,
    extra: U8,
    fields: U64,
    axes_of_bits: U64,
    levels: I64,
    steps: F32,
    minimum: F32,
    more: int,
    more_fields: U64,
    out: F32,
) -> bool:
    """Compute means from Morton differences and the bits below their cells (SPEC 6.5, 6.17).

    Parameters
    ----------
    classes : (n,) uint8
        Bit length of each row's Morton difference.
    differences, fields, more_fields : uint64
        Packed planes as words: differences, bits below the cells, and bits of the refinement.
    extra : (n,) uint8
        Number of bits below the cell of each row, per axis.
    axes_of_bits : (512,) uint64
        `AXES_OF_BITS`.
    levels : (3,) int64
        Cells along each axis.
    steps : (bits, 3) float32
        Distance between levels for each number of bits below the cell.
    minimum : (3,) float32
    more : int
        Number of bits that the refinement adds to each axis, 0 without a refinement.
    out : (n, 3) float32

    Returns
    -------
    bool
        False if a code is out of range.
    """
    mask = np.uint64(_AXIS_MASK)
    code = np.uint64(0)
    at = 0
    position = 0
    more_position = 0
    under = (np.uint64(1) << np.uint64(more)) - np.uint64(1)
    half = (np.int64(1) << np.int64(more)) >> np.int64(1)
    for row in range(len(out)):
        bits = int(classes[row])
        if bits:
            leading = np.uint64(1) << np.uint64(bits - 1)
            code += (window(differences, at) & (leading - np.uint64(1))) | leading
            at += bits - 1
            if code >> np.uint64(_MORTON_BITS):
                return False
        cells = np.uint64(0)
        for part in range(_PARTS):
            nine = (code >> np.uint64(9 * part)) & np.uint64(511)
            cells |= axes_of_bits[nine] << np.uint64(3 * part)
        wide = int(extra[row])
        low = window(fields, position)
        position += 3 * wide
        below = (np.uint64(1) << np.uint64(wide)) - np.uint64(1)
        lower = np.uint64(0)
        if more:
            lower = window(more_fields, more_position)
            more_position += 3 * more
        for axis in range(3):
            cell = (cells >> np.uint64(_AXIS_BITS * axis)) & mask
            if np.int64(cell) >= levels[axis]:
                return False
            fine = (cell << np.uint64(wide)) | ((low >> np.uint64(wide * axis)) & below)
            field = (lower >> np.uint64(more * axis)) & under
            level = np.int64((fine << np.uint64(more)) + field) - half
            if level < 0:
                return False
            value = np.float32(level) * steps[wide + more, axis]
            out[row, axis] = value + minimum[axis]
    return True


@inner_exact
def read_means(
    planes: ChunkPlanes,
    stream: I64,
    refinement: I64,
    knees: F32,
    powers: F32,
    axes_of_bits: U64,
    scales: F32,
    out: F32,
) -> bool:
    """Decode the means of a chunk; return False if a stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream, refinement : (6,) int64
        Rows of `ChunkPlanes.records`: the stream, and the bits that refine it.
    knees : (4,) float32
        `adaptive_step.KNEES`.
    powers : (bits,) float32
        `sorted_means.POWERS`.
    axes_of_bits : (512,) uint64
        `AXES_OF_BITS`.
    scales : (n, 3) float32
        Log scales of the head alone.
    out : (n, 3) float32
    """
    data = planes.data
    rows = len(out)
    at = stream[PARAMS]
    valid, grid = parse_grid(data, at, 3, MAX_CELLS, MAX_VALUE)
    model = np.empty(6, np.float32)
    valid = valid and read_floats(data, at + 36, 6, MAX_COEFFICIENT, model)
    first = stream[FIRST_PLANE]
    if not valid or stream[PLANES] != 3:
        return False
    start = plane_start(planes, first, rows)
    if start < 0:
        return False
    classes = data[start : start + rows]
    extra = np.empty(rows, np.uint8)
    bits, low_bits = _count_bits(classes, scales, model, knees, extra)
    if bits < 0:
        return False
    differences = plane_start(planes, first + 1, bits + 7 >> 3)
    fields = plane_start(planes, first + 2, low_bits + 7 >> 3)
    if differences < 0 or fields < 0:
        return False
    if not is_padded(data, differences, bits) or not is_padded(data, fields, low_bits):
        return False
    more, more_bits, lower = 0, 0, 0
    if refinement[PRESENT]:
        at = refinement[PARAMS]
        more = signed(data[at])
        reserved = data[at + 1] | data[at + 2] | data[at + 3]
        if more < 1 or more > MAX_BITS or reserved or refinement[PLANES] != 1:
            return False
        more_bits = 3 * more * rows
        lower = plane_start(planes, refinement[FIRST_PLANE], more_bits + 7 >> 3)
        if lower < 0 or not is_padded(data, lower, more_bits):
            return False
    levels = np.empty(3, np.int64)
    steps = np.empty((len(powers), 3), np.float32)
    for axis in range(3):
        count = grid.levels[axis]
        levels[axis] = count
        width = np.float32(0)
        if count > 1:
            span = grid.maximum[axis] - grid.minimum[axis]
            width = span / (np.float32(count) - np.float32(1))
        for m in range(len(powers)):
            steps[m, axis] = powers[m] * width
    return _decode_means(
        classes,
        plane_words(data, differences, bits + 7 >> 3),
        extra,
        plane_words(data, fields, low_bits + 7 >> 3),
        axes_of_bits,
        levels,
        steps,
        grid.minimum,
        more,
        plane_words(data, lower, more_bits + 7 >> 3),
        out,
    )
