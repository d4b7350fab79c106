"""Compiled decoding of adaptive steps: extra bits of each row (SPEC 6.10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .adaptive_step import MAX_EXTRA_BITS
from .kernels_bits import inner_exact

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


@inner_exact
def compute_extra_bits(scales: F32, coefficients: F32, knees: F32, extra: U8) -> None:
    """Compute the number of extra bits of each splat into `extra`, as `StepModel` does (SPEC 6.10).

    Parameters
    ----------
    scales : (n, 3) float32
        Decoded log scales of the head: middle, thin, long.
    coefficients : (6,) float32
        Coefficients of the step model.
    knees : (4,) float32
        `adaptive_step.KNEES`.
    extra : (n,) uint8, out
        Number of bits; each one halves the quantiser step.
    """
    c0, c1, c2 = coefficients[0], coefficients[1], coefficients[2]
    c3, c4, c5 = coefficients[3], coefficients[4], coefficients[5]
    k0, k1, k2, k3 = knees[0], knees[1], knees[2], knees[3]
    limit = np.float32(MAX_EXTRA_BITS)
    zero = np.float32(0)
    for row in range(len(extra)):
        middle, thin, long = scales[row, 0], scales[row, 1], scales[row, 2]
        p = long - middle
        q = middle - thin
        total = c0 + c1 * long
        total = total + c2 * (p if p < k0 else k0)
        total = total + c3 * (p if p < k1 else k1)
        total = total + c4 * (q if q < k2 else k2)
        total = total + c5 * (q if q < k3 else k3)
        total = total if total < limit else limit
        # The integer part of a non-negative number is its floor.
        extra[row] = np.uint8(np.int32(total if total > zero else zero))


@inner_exact
def count_extra_bits(scales: F32, coefficients: F32, knees: F32, extra: U8) -> I64:
    """Compute the extra bits as `compute_extra_bits` does; return their histogram, (16,)."""
    compute_extra_bits(scales, coefficients, knees, extra)
    # Two alternating histograms: an increment does not wait for the previous one.
    rows = np.zeros((2, MAX_EXTRA_BITS + 1), np.int64)
    for row in range(len(extra)):
        rows[row & 1, extra[row]] += 1
    total_rows: I64 = rows[0] + rows[1]
    return total_rows
