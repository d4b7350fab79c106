"""Compilation of numba kernels: on-disk cache, and declared argument types for compiling ahead.

numba compiles a kernel on its first call, which takes a fraction of a second to seconds, and caches
the machine code in a folder. A kernel with declared types can be compiled ahead of its first call,
in another process that writes to the same folder.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])


def jit_kernel(function: Function, *, fuses: bool = False, cached: bool = True) -> Function:
    """Return a function that numba compiles on its first call, with an on-disk cache if possible.

    Parameters
    ----------
    function : callable
        Python function for numba's nopython mode. It runs without the interpreter's lock and
        divides as numpy does.
    fuses : bool
        Whether a product and a sum may become one fused instruction.
    cached : bool
        Whether the machine code is cached on disk. False for inner kernels, which only kernels
        call: the code of a kernel includes the inner kernels that it calls.

    Notes
    -----
    A cached kernel must be called with one set of types only. numba (0.68) numbers the files of a
    function without a lock. If two processes compile it for different types at the same time, both
    may use the same number, and later processes run machine code of the wrong types. Inner kernels
    are called with many sets of types: each constant argument has its own type.

    The cache is in ``NUMBA_CACHE_DIR`` if that is set, otherwise in the first writable folder of
    the module's and the user's cache folder. Without a writable folder, for example in a read-only
    installation for a user without a home, every process compiles anew.
    """
    njit = _import_njit()
    options: dict[str, Any] = {
        # Saves the wrapper for callers in C, which cost a tenth of the time of compiling.
        "no_cfunc_wrapper": True,
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"contract"} if fuses else False,
    }
    if not cached:
        return cast(Function, njit(**options)(function))
    try:
        found = njit(cache=True, **options)(function)
    except RuntimeError:
        # numba raises this if no cache folder is writable.
        found = njit(**options)(function)
    return cast(Function, found)


def _import_njit() -> Any:
    """Import numba's decorator `njit`, with colorama hidden during the first import of numba.

    numba colours its messages through colorama, if that is installed, and colorama swaps
    `sys.stdout`. Kernels compile on several threads: output of another thread would be lost.
    """
    if "numba" not in sys.modules:
        found = sys.modules.get("colorama")
        sys.modules["colorama"] = None  # type: ignore[assignment]
        try:
            import numba  # noqa: F401
        finally:
            del sys.modules["colorama"]
            if found is not None:
                sys.modules["colorama"] = found
    from numba import njit

    return njit


@dataclass(frozen=True, eq=False)
class DeclaredKernel:
    """A kernel with the types of its arguments.

    Parameters
    ----------
    function : callable
        Result of `jit_kernel`.
    types : str
        Types in numba's notation, separated by commas: ``"int64, float32[:, ::1]"``.
    """

    function: Callable[..., object]
    types: str

    @property
    def name(self) -> str:
        """Module and function name, separated by a colon."""
        return f"{self.function.__module__}:{self.function.__name__}"

    @property
    def folder(self) -> Path | None:
        """Folder of the cached machine code; None if no folder is writable."""
        stats = getattr(self.function, "stats", None)
        return Path(stats.cache_path) if stats is not None and stats.cache_path else None

    def is_cached(self) -> bool:
        """Return whether the cache has an entry for this kernel that is newer than its module.

        The entry may be for another processor; the kernel is then compiled on its first call.
        """
        folder, dispatcher = self.folder, cast(Any, self.function)
        if folder is None:
            return False
        code = dispatcher.py_func.__code__
        source = Path(code.co_filename)
        pattern = f"{source.stem}.{dispatcher.py_func.__qualname__}-{code.co_firstlineno}*.nbi"
        changed = source.stat().st_mtime
        return any(found.stat().st_mtime >= changed for found in folder.glob(pattern))

    def compile(self) -> None:
        """Compile the kernel, or load it from the cache."""
        dispatcher = cast(Any, self.function)
        # With NUMBA_DISABLE_JIT the kernel is a plain Python function.
        if not hasattr(dispatcher, "compile"):
            return
        from numba.core import sigutils

        # The cache key must be a tuple of types, as in a call; compiling by the text of a signature
        # would store the code under a key that no call looks up.
        types, _ = cast(Any, sigutils).normalize_signature(f"({self.types},)")
        dispatcher.compile(tuple(types))


_DECLARED: Final[dict[str, DeclaredKernel]] = {}


def called_with(types: str) -> Callable[[Function], Function]:
    """Return a decorator that declares the argument types of a kernel, for compiling ahead.

    It is applied to the result of `jit_kernel`, so it stands above the compiling decorator.

    Parameters
    ----------
    types : str
        Types in numba's notation; see `DeclaredKernel`.
    """

    def declare(function: Function) -> Function:
        kernel = DeclaredKernel(function, types)
        _DECLARED[kernel.name] = kernel
        return function

    return declare


def kernels_in(modules: Iterable[str]) -> list[DeclaredKernel]:
    """Import modules by name and return the kernels they declare, in the order of the modules."""
    found: list[DeclaredKernel] = []
    for module in modules:
        importlib.import_module(module)
        found += [kernel for kernel in _DECLARED.values() if kernel.function.__module__ == module]
    return found


def kernel_by_name(name: str) -> DeclaredKernel:
    """Import the module of a kernel and return the kernel, by `DeclaredKernel.name`.

    Raises
    ------
    KeyError
        The module declares no such kernel.
    """
    importlib.import_module(name.partition(":")[0])
    return _DECLARED[name]
