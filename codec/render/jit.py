"""Decorators `kernel` and `inner_kernel`: numba options of all loops over splats or pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from cogsplat.codec.compiling import jit_kernel

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function over arrays and scalars on its first call.

    Parameters
    ----------
    function : callable
        Python function for numba's nopython mode.

    Returns
    -------
    callable
        Compiled function with the same arguments. It runs without the interpreter's lock, so that
        several threads can run kernels in parallel, and divides as numpy does (no
        ZeroDivisionError).

    Notes
    -----
    A product and a sum may fuse into one instruction. Kernels therefore give the same bits between
    runs and thread counts on one machine, but not between machines: decode arithmetic must not use
    them.

    Compiled code is cached on disk (`compiling.jit_kernel`) and rebuilt when the kernel's module
    changes. numba does not notice changes of inner kernels in other modules: while editing such a
    module, set ``NUMBA_CACHE_DIR`` to a fresh folder.
    """
    return jit_kernel(function, fuses=True)


def inner_kernel(function: Function) -> Function:
    """Compile a function that only kernels call, as part of their code; see `kernel`.

    Parameters
    ----------
    function : callable
        Python function for numba's nopython mode.
    """
    return jit_kernel(function, fuses=True, cached=False)
