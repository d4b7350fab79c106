"""Compiled reading of rotations as swing and twist (SPEC 6.11, 6.17)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import sorted_means, swing_twist
from .adaptive_step import KNEES, MAX_EXTRA_BITS
from .inputs import Inputs
from .kernels_adaptive_step import count_extra_bits, gained
from .kernels_bits import exact, window, words
from .kernels_planes import join_run
from .records import StoredStream

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

SYMBOL_GROUPS: Final = 7
"""Extra bits 0 to 6 and above: the first has no plane (SPEC 6.11)."""


@exact
def _plan(scales: F32, coefficients: F32, knees: F32, most: int, wide_of: U8, counts: I64) -> None:
    """Write the extra bits of swing and twist (SPEC 6.10, 6.11).

    Parameters
    ----------
    scales : (n, 3) float32
    coefficients : (2, 6) float32
    knees : (4,) float32
    most : int
        Extra bits at most.
    wide_of : (2, n) uint8, out
        Extra bits.
    counts : (2, SYMBOL_GROUPS + 1) int64, out
        Rows of each symbol group, and the sum of the extra bits beyond the last.
    """
    counts[:] = 0
    for which in range(2):
        rows = count_extra_bits(scales, coefficients[which], knees, most, wide_of[which])
        for wide in range(most + 1):
            group = min(wide, SYMBOL_GROUPS - 1)
            counts[which, group] += rows[wide]
            counts[which, SYMBOL_GROUPS] += rows[wide] * (wide - group)


@exact
def _gained_plan(wide_of: U8, extra: U8, counts: I64) -> None:
    """Write what a refinement adds to the rotations of a head (SPEC 6.17).

    Parameters
    ----------
    wide_of, extra : (2, n) uint8
        Extra bits of the head and of the refinement.
    counts : (2, SYMBOL_GROUPS + 1) int64, out
        As of `_plan`, of the rows without extra bits in the head; in column 0 the bits of the
        others.
    """
    counts[:] = 0
    for which in range(2):
        for row in range(wide_of.shape[1]):
            more = int(extra[which, row])
            if wide_of[which, row]:
                counts[which, 0] += more
            elif more:
                group = min(more, SYMBOL_GROUPS - 1)
                counts[which, group] += 1
                counts[which, SYMBOL_GROUPS] += more - group


@exact
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


@exact
def _rotations(
    planes: U8,
    wide_of: U8,
    counts: I64,
    steps: F32,
    extra: U8,
    more_counts: I64,
    below: U8,
    fields: U64,
    out: F32,
) -> bool:
    """Write the unit quaternions of swing, swing and twist (SPEC 6.11, 6.17).

    Parameters
    ----------
    planes : uint8
        All planes end to end, and two bytes behind them.
    wide_of, counts
        As `_plan` writes them.
    steps : (most + 1,) float32
        What a code is worth after each number of extra bits.
    extra : (2, n) uint8
        Extra bits that a refinement adds to swing and twist; no columns where there is none.
    more_counts : (2, SYMBOL_GROUPS + 1) int64
        As `_gained_plan` writes them.
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
            wide = int(wide_of[column >> 1, row])
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
                    low = window(fields, position) & np.uint64((1 << more) - 1)
                    position += more
                    code = (code << more) + int(np.int64(low)) - (1 << (more - 1))
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


def _lengths(counts: I64) -> list[int]:
    swing, twist = (
        [*(n for n in groups[1:-1] if n), groups[-1] + 7 >> 3] for groups in counts.tolist()
    )
    return swing * swing_twist.SWINGS + twist


def read(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `swing_twist.read` does; False where something is out of range."""
    models = swing_twist.parse(stream)
    coefficients = np.array([model.coefficients for model in models], np.float32)
    extra = np.empty((2, stream.rows), np.uint8)
    counts = np.empty((2, SYMBOL_GROUPS + 1), np.int64)
    scales = sorted_means.scales_of(inputs)
    _plan(scales, coefficients, KNEES, MAX_EXTRA_BITS, extra, counts)
    lengths = _lengths(counts)
    if len(stream.words) != len(lengths):
        return False
    planes = join_run(stream, 0, lengths)
    more = np.empty((2, 0), np.uint8)
    more_counts = np.zeros_like(counts)
    below = np.empty(2, np.uint8)
    finer = sorted_means.finer_of(inputs)
    if finer is not None:
        more = np.empty_like(extra)
        for which, fine in enumerate(finer.step_models(models)):
            constants = np.array(fine.coefficients, np.float32)
            gained(finer.scales, constants, KNEES, MAX_EXTRA_BITS, extra[which], more[which])
        _gained_plan(extra, more, more_counts)
        lengths = _lengths(more_counts)
        spare = int(more_counts[:, 0] @ (2, 1))
        lengths.append(spare + 7 >> 3)
        if len(finer.stream.words) != len(lengths):
            return False
        below = join_run(finer.stream, 0, lengths)
        if spare & 7 and int(below[-3]) >> (spare & 7):
            return False
    fields = words(below[sum(lengths[:-1]) :])
    steps = swing_twist.STEPS
    return _rotations(planes, extra, counts, steps, more, more_counts, below, fields, out)
