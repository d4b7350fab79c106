"""Compiled reading of rotations as swing and twist (SPEC 6.11)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import adaptive_step, swing_twist
from .adaptive_step import KNEES, MAX_EXTRA_BITS
from .inputs import Inputs
from .kernels_adaptive_step import count_extra_bits
from .kernels_bits import exact, inner_exact
from .kernels_planes import join_run
from .records import StoredStream

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

GROUPS: Final = swing_twist.SYMBOL_BITS + 1
"""Rows without extra bits, which have no plane, and those of each plane of symbols."""


@called_with("float32[:, ::1], float32[:, ::1], float32[::1], uint8[:, ::1], int64[:, ::1]")
@exact
def plan(scales: F32, coefficients: F32, knees: F32, extra: U8, counts: I64) -> None:
    """Write the extra bits of swing and twist (SPEC 6.10), and what planes follow from them.

    Parameters
    ----------
    scales : (n, 3) float32
    coefficients : (2, 6) float32
    knees : (4,) float32
    extra : (2, n) uint8, out
        Extra bits.
    counts : (2, GROUPS + 1) int64, out
        Rows of each group, and the low bits of all rows together.
    """
    counts[:] = 0
    for which in range(2):
        rows = count_extra_bits(scales, coefficients[which], knees, extra[which])
        for bits in range(MAX_EXTRA_BITS + 1):
            group = min(bits, GROUPS - 1)
            counts[which, group] += rows[bits]
            counts[which, GROUPS] += rows[bits] * (bits - group)


@inner_exact
def _positions(planes: U8, starts: I64, counts: I64) -> tuple[I64, I64, bool]:
    """Return where symbols and low bits of each component start, and whether paddings are 0."""
    symbols = np.zeros((3, GROUPS), np.int64)
    bits = np.zeros(3, np.int64)
    right = True
    for column in range(3):
        for group in range(1, GROUPS):
            symbols[column, group] = starts[column * GROUPS + group - 1]
        at = starts[column * GROUPS + GROUPS - 1]
        low = counts[column >> 1, GROUPS]
        bits[column] = 8 * at
        if low & 7 and int(planes[at + (low >> 3)]) >> (low & 7):
            right = False
    return symbols, bits, right


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], uint8[:, ::1], int64[:, ::1], float32[::1], "
    "float32[:, ::1]"
)
@exact
def rotations(planes: U8, starts: I64, extra: U8, counts: I64, steps: F32, out: F32) -> bool:
    """Write the unit quaternions of swing, swing and twist (SPEC 6.11).

    Parameters
    ----------
    planes : uint8
        Two bytes stand behind the last.
    starts : (21,) int64
        Where each begins.
    extra, counts
        As `plan` writes them.
    steps : (MAX_EXTRA_BITS + 1,) float32
        Distance between levels at each number of extra bits.
    out : (n, 4) float32

    Returns
    -------
    bool
        False where padding is set or a code is out of range.
    """
    symbols, bits, right = _positions(planes, starts, counts)
    if not right:
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
            code = int(planes[symbols[column, group]])
            symbols[column, group] += 1
            if low:
                byte, shift = bits[column] >> 3, bits[column] & 7
                pair = int(planes[byte]) | int(planes[byte + 1]) << 8
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


def read(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `swing_twist.read` does; False where something is out of range."""
    models = swing_twist.parse(stream)
    coefficients = np.array([model.coefficients for model in models], np.float32)
    extra = np.empty((2, stream.rows), np.uint8)
    counts = np.empty((2, GROUPS + 1), np.int64)
    scales = adaptive_step.scales_of(inputs)
    plan(scales, coefficients, KNEES, extra, counts)
    swing, twist = ([*found[1:-1], found[-1] + 7 >> 3] for found in counts.tolist())
    lengths = [*swing, *swing, *twist]
    starts = np.cumsum([0, *lengths[:-1]], dtype=np.int64)
    planes = join_run(stream, 0, lengths)
    return rotations(planes, starts, extra, counts, swing_twist.STEPS, out)
