"""How hot loops over arrays are compiled: one set of options for all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function over arrays and scalars on its first call.

    It runs without the interpreter's lock, so that several threads can run kernels at once, and
    divides as numpy does (no ZeroDivisionError). Products and sums may fuse, so kernels built here
    agree between runs and thread counts on one machine, not bit for bit between machines: decode
    arithmetic must not use it.
    """
    compiled = njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})(function)
    return cast(Function, compiled)
