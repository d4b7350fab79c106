"""Compiled reading of sorted means (SPEC 6.5, 6.17)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry import morton

from . import adaptive_step, refinement_bits, sorted_means
from .adaptive_step import KNEES, MAX_EXTRA_BITS
from .inputs import Inputs
from .kernels_adaptive_step import count_extra_bits
from .kernels_bits import exact, window, words, zeros_behind
from .records import StoredStream

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

_AXIS_BITS: Final = 21
_AXIS_MASK: Final = (1 << _AXIS_BITS) - 1
_MORTON_BITS: Final = sorted_means.MORTON_BITS
# Parts of nine bits that a Morton code has.
_PARTS: Final = -(-_MORTON_BITS // 9)


def _axes_of_bits() -> U64:
    axes = morton.deinterleave(np.arange(512, dtype=np.uint64)).astype(np.uint64)
    shifts = np.arange(3, dtype=np.uint64) * np.uint64(_AXIS_BITS)
    return np.asarray(np.bitwise_or.reduce(axes << shifts, axis=1))


AXES_OF_BITS: Final = _axes_of_bits()
"""Three bits of each axis, 21 bits apart, of nine bits of a Morton code."""


@called_with("Array(uint8, 1, 'C', True), float32[:, ::1], float32[::1], float32[::1], uint8[::1]")
@exact
def plan(classes: U8, scales: F32, coefficients: F32, knees: F32, extra: U8) -> tuple[int, int]:
    """Write the extra bits of rows; return the bits of the differences and of the plane below.

    The first is -1 where a class is above 51.
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


@called_with(
    "Array(uint8, 1, 'C', True), uint64[::1], uint8[::1], uint64[::1], uint64[::1], "
    "int64[::1], float32[:, ::1], float32[::1], int64, uint64[::1], float32[:, ::1]"
)
@exact
def means(
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
    """Write means from Morton differences and the bits below their cells (SPEC 6.5, 6.17).

    Parameters
    ----------
    classes : (n,) uint8
    differences, fields, more_fields : uint64
        The packed planes, as `words` gives them; the last is the refinement's.
    extra : (n,) uint8
        Extra bits.
    axes_of_bits : (512,) uint64
    levels : (3,) int64
        Of the cells.
    steps : (bits, 3) float32
        Distance between levels at each number of bits below the cell.
    minimum : (3,) float32
    more : int
        Bits that the refinement adds, 0 without one.
    out : (n, 3) float32

    Returns
    -------
    bool
        False where a code is out of range.
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


def read(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `sorted_means.read` does; False where something is out of range."""
    grid, model = sorted_means.parse(stream)
    classes = stream.plane(0, stream.rows)
    coefficients = np.array(model.coefficients, np.float32)
    extra = np.empty(stream.rows, np.uint8)
    scales = adaptive_step.scales_of(inputs)
    used = plan(classes, scales, coefficients, KNEES, extra)
    if used[0] < 0:
        return False
    differences = stream.plane(1, used[0] + 7 >> 3)
    fields = stream.plane(2, used[1] + 7 >> 3)
    if not zeros_behind(differences, used[0]) or not zeros_behind(fields, used[1]):
        return False
    more, below = 0, extra[:0]
    if inputs.refinement is not None:
        more = refinement_bits.parse(inputs.refinement)
        below = refinement_bits.read_plane(inputs.refinement, more)
    return means(
        classes,
        words(differences),
        extra,
        words(fields),
        AXES_OF_BITS,
        grid.levels.astype(np.int64),
        sorted_means.POWERS[:, None] * grid.step,
        grid.minimum,
        more,
        words(below),
        out,
    )
