"""`kernel`, `inner_kernel`: the numba options of every loop over splats or pixels."""

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
        Python that numba compiles (nopython mode).

    Returns
    -------
    callable
        Takes the same arguments. It runs without the interpreter's lock, so that several threads
        can run kernels at once, and divides as numpy does (no ZeroDivisionError).

    Notes
    -----
    A product and a sum may fuse into one instruction. Kernels therefore give the same bits between
    runs and thread counts on one machine, but not between machines: decode arithmetic must not use
    them.

    Compiled code is kept on disk (`compiling.compiled`), and is built anew when the kernel's module
    changes. numba does not see changes in kernels that it calls from other modules: while
    such a module is being edited, set ``NUMBA_CACHE_DIR`` to a fresh folder.
    """
    return jit_kernel(function, fuses=True)


def inner_kernel(function: Function) -> Function:
    """Compile a function that only kernels call, as `kernel` does, as a part of their code.

    Parameters
    ----------
    function : callable
        Python that numba compiles (nopython mode).
    """
    return jit_kernel(function, fuses=True, cached=False)
