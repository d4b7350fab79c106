"""Morton codes: three axis codes interleaved bit by bit, and the spatial order of means."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

MAX_AXIS_BITS: Final = 21
"""Bits of an axis code at most: three axes of 21 bits make a 63-bit Morton code."""

MAX_LEVELS: Final = 1 << MAX_AXIS_BITS

# Masks that spread 21 bits to every third bit, halving the group at each step.
_SPREAD: Final = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _spread(values: U64) -> U64:
    """Spread the lowest 21 bits of each value to every third bit."""
    for shift, mask in _SPREAD:
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values


def _compact(values: U64) -> U64:
    """Collect every third bit of each value: the inverse of `_spread`."""
    values = values & np.uint64(_SPREAD[-1][1])
    masks = [mask for _, mask in _SPREAD]
    for index in range(len(_SPREAD) - 1, -1, -1):
        shift = _SPREAD[index][0]
        mask = masks[index - 1] if index else 0x1FFFFF
        values = (values | (values >> np.uint64(shift))) & np.uint64(mask)
    return values


def interleave(codes: U32) -> U64:
    """Return Morton codes of (n, 3) axis codes below 2^21: x in bit 0, y in bit 1, z in bit 2."""
    wide = codes.astype(np.uint64)
    morton: U64 = (
        _spread(wide[:, 0])
        | (_spread(wide[:, 1]) << np.uint64(1))
        | (_spread(wide[:, 2]) << np.uint64(2))
    )
    return morton


def deinterleave(morton: U64) -> U32:
    """Return the (n, 3) codes along x, y and z of (n,) Morton codes."""
    out = np.empty((len(morton), 3), np.uint32)
    for axis in range(3):
        out[:, axis] = _compact(morton >> np.uint64(axis))
    return out


F64 = NDArray[np.float64]
_ORDER_AXIS_BITS: Final = 16


def spatial_order(means: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return an order of (n, 3) means in which consecutive means are mostly close in space.

    It is a Morton order of ranks along the axes: ranks prevent a few distant splats from forcing
    all remaining splats into one cell.
    """
    n = len(means)
    morton = np.zeros(n, np.uint64)
    for axis in range(3):
        code = np.empty(n, np.uint64)
        levels = (np.arange(n, dtype=np.uint64) << np.uint64(_ORDER_AXIS_BITS)) // np.uint64(n)
        code[np.argsort(means[:, axis], kind="stable")] = levels
        del levels
        morton |= _spread(code) << np.uint64(axis)
    return np.argsort(morton, kind="stable")
