"""Compiled decoding: exact arithmetic, and fields of bits as machine words."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import jit_kernel

U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]


Function = TypeVar("Function", bound=Callable[..., object])


def exact(function: Function) -> Function:
    """Compile a function without fusing products and sums (SPEC 2.2), unlike `render.jit`."""
    return jit_kernel(function)


def inner_exact(function: Function) -> Function:
    """Compile a function that only kernels call, as `exact` does, as a part of their code."""
    return jit_kernel(function, cached=False)


def words(plane: U8) -> U64:
    """Return the bytes of a plane as 64-bit words, with two of zeros behind them."""
    found = np.empty((len(plane) + 7 >> 3) + 2, np.uint64)
    octets = found.view(np.uint8)
    octets[: len(plane)] = plane
    octets[len(plane) :] = 0
    return found


def zeros_behind(plane: U8, bits: int) -> bool:
    """Tell whether what follows the first `bits` bits of a plane is zeros."""
    return not (bits & 7 and int(plane[-1]) >> (bits & 7))


@inner_exact
def window(packed: U64, position: int) -> np.uint64:
    """Return the 64 bits from a position on."""
    index = position >> 6
    shift = np.uint64(position & 63)
    high: np.uint64 = (packed[index + 1] << np.uint64(1)) << (np.uint64(63) - shift)
    found: np.uint64 = high | (packed[index] >> shift)
    return found
