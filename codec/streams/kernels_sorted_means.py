"""Compiled reading of sorted means (SPEC 6.5, 6.15, 6.17)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton

from . import sorted_means
from .adaptive_step import KNEES, MAX_EXTRA_BITS
from .grid import Grid
from .inputs import Inputs
from .kernels_adaptive_step import count_extra_bits, gained
from .kernels_bits import exact, window, words, zeros_behind
from .records import StoredStream

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

_AXIS_BITS: Final = 21
_AXIS_MASK: Final = (1 << _AXIS_BITS) - 1


def _axes_of_bits() -> U64:
    axes = morton.deinterleave(np.arange(512, dtype=np.uint64)).astype(np.uint64)
    shifts = np.arange(3, dtype=np.uint64) * np.uint64(_AXIS_BITS)
    return np.asarray(np.bitwise_or.reduce(axes << shifts, axis=1))


AXES_OF_BITS: Final = _axes_of_bits()
"""Three bits of each axis, 21 bits apart, of nine bits of a Morton code."""


@exact
def _delta_bits(classes: U8) -> int:
    """Return how many bits the differences of these classes take, -1 for a class above 63."""
    total = 0
    top = 0
    for row in range(len(classes)):
        top = max(top, int(classes[row]))
        total += max(int(classes[row]), 1) - 1
    return total if top <= 3 * _AXIS_BITS else -1


@exact
def _plan(
    classes: U8, scales: F32, coefficients: F32, knees: F32, most: int, wide_of: U8
) -> tuple[int, int]:
    """Write the extra bits of rows; return the bits of the deltas and of the planes below."""
    rows = count_extra_bits(scales, coefficients, knees, most, wide_of)
    fields = 0
    for wide in range(most + 1):
        fields += 3 * wide * rows[wide]
    return _delta_bits(classes), fields


@exact
def _means(
    classes: U8,
    deltas: U64,
    wide_of: U8,
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

    `factors` (extra bits, 3) is the step at each number of extra bits, `extra` how many more bits a
    refinement adds to each row, with no rows where there is none, and `extra_fields` these bits.
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
            code += (window(deltas, at) & (leading - np.uint64(1))) | leading
            at += bits - 1
            if code >> np.uint64(63):
                return False
        cells = np.uint64(0)
        for part in range(7):
            nine = (code >> np.uint64(9 * part)) & np.uint64(511)
            cells |= axes_of_bits[nine] << np.uint64(3 * part)
        wide = int(wide_of[row])
        low = window(fields, position)
        position += 3 * wide
        below = (np.uint64(1) << np.uint64(wide)) - np.uint64(1)
        more = int(extra[row]) if finer else 0
        lower = np.uint64(0)
        if more:
            lower = window(extra_fields, extra_position)
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


def _write(
    planes: tuple[U8, U8, U8, U8],
    used: tuple[int, int],
    extra: tuple[U8, U8],
    grid: Grid,
    out: F32,
) -> bool:
    classes, deltas, fields, below = planes
    if not zeros_behind(deltas, used[0]) or not zeros_behind(fields, used[1]):
        return False
    return _means(
        classes,
        words(deltas),
        extra[0],
        words(fields),
        AXES_OF_BITS,
        grid.levels.astype(np.int64),
        sorted_means.POWERS[:, None] * grid.step,
        grid.minimum,
        extra[1],
        words(below),
        out,
    )


def read_cells(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `sorted_means.read_cells` does; False where something is out of range."""
    grid = sorted_means.parse_cells(stream)
    classes = stream.plane(0, stream.rows)
    bits = _delta_bits(classes)
    if bits < 0:
        return False
    deltas = stream.plane(1, bits + 7 >> 3)
    none = np.zeros(stream.rows, np.uint8)
    empty = none[:0]
    return _write((classes, deltas, empty, empty), (bits, 0), (none, empty), grid, out)


def read(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `sorted_means.read` does; False where something is out of range."""
    grid, model = sorted_means.parse(stream)
    classes = stream.plane(0, stream.rows)
    coefficients = np.array(model.coefficients, np.float32)
    extra = np.empty(stream.rows, np.uint8)
    scales = sorted_means.scales_of(inputs)
    used = _plan(classes, scales, coefficients, KNEES, MAX_EXTRA_BITS, extra)
    if used[0] < 0:
        return False
    deltas = stream.plane(1, used[0] + 7 >> 3)
    fields = stream.plane(2, used[1] + 7 >> 3)
    finer = sorted_means.finer_of(inputs)
    more = below = extra[:0]
    if finer is not None:
        (fine,) = finer.step_models([model])
        more = np.empty_like(extra)
        constants = np.array(fine.coefficients, np.float32)
        gained(finer.scales, constants, KNEES, MAX_EXTRA_BITS, extra, more)
        finer.stream.require_planes(1)
        below = finer.plane(0, more * np.uint8(3))
    return _write((classes, deltas, fields, below), used, (extra, more), grid, out)
