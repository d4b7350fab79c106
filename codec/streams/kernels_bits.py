"""Compiled reading of integers, floats and bit fields from bytes, with exact arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import jit_kernel

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]


Function = TypeVar("Function", bound=Callable[..., object])


def exact(function: Function) -> Function:
    """Compile a kernel with IEEE rounding of each operation (SPEC 2.2).

    Products and sums are not fused, unlike in `render.jit`: results equal those of numpy.
    """
    return jit_kernel(function)


def inner_exact(function: Function) -> Function:
    """Compile a function that only kernels call, with the rounding of `exact`.

    It has no cache entry: numba compiles its code into each calling kernel.
    """
    return jit_kernel(function, cached=False)


@inner_exact
def signed(value: np.unsignedinteger[Any]) -> int:
    """Return an unsigned integer as a signed one; numba turns a mix of both into floats."""
    return int(np.int64(value))


@inner_exact
def u16(data: U8, at: int) -> int:
    """Return the little-endian 16-bit integer at byte `at`."""
    return signed(data[at]) | signed(data[at + 1]) << 8


@inner_exact
def u32(data: U8, at: int) -> int:
    """Return the little-endian 32-bit integer at byte `at`."""
    return u16(data, at) | u16(data, at + 2) << 16


@inner_exact
def read_floats(data: U8, at: int, count: int, limit: float, out: F32) -> bool:
    """Read `count` float32 values from byte `at`; return False if one is NaN or beyond ±`limit`."""
    bits = np.empty(count, np.uint32)
    for i in range(count):
        bits[i] = u32(data, at + 4 * i)
    values = bits.view(np.float32)
    for i in range(count):
        if not abs(np.float64(values[i])) <= limit:
            return False
        out[i] = values[i]
    return True


@inner_exact
def plane_words(data: U8, start: int, length: int) -> U64:
    """Return `length` bytes of a plane as 64-bit words, followed by two words of zeros."""
    words = np.zeros((length + 7 >> 3) + 2, np.uint64)
    octets = words.view(np.uint8)
    for i in range(length):
        octets[i] = data[start + i]
    return words


@inner_exact
def is_padded(data: U8, start: int, bits: int) -> bool:
    """Tell whether the padding bits of a packed plane are zero, as SPEC 6.15 requires.

    Parameters
    ----------
    data : uint8
        Decompressed planes of the chunk.
    start : int
        Position of the plane, bytes.
    bits : int
        Number of bits in use; the remaining bits of the last byte are padding.
    """
    return not (bits & 7 and signed(data[start + (bits >> 3)]) >> (bits & 7))


@inner_exact
def window(packed: U64, position: int) -> np.uint64:
    """Return the 64 bits that begin at bit `position` of packed words."""
    index = position >> 6
    shift = np.uint64(position & 63)
    high: np.uint64 = (packed[index + 1] << np.uint64(1)) << (np.uint64(63) - shift)
    found: np.uint64 = high | (packed[index] >> shift)
    return found
