"""Kernels before they run: how numba caches them, and the types that they are called with.

numba compiles a kernel when it is first called, which takes a fraction of a second to seconds, and
keeps the machine code in a folder. A kernel whose types are declared can be compiled before it is
called, in another process that writes to the same folder.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function, *, fuses: bool = False, kept: bool = True) -> Function:
    """Compile a function on its first call, and keep the machine code on disk where that works.

    Parameters
    ----------
    function : callable
        Python that numba compiles (nopython mode). It runs without the interpreter's lock and
        divides as numpy does.
    fuses : bool
        Whether a product and a sum may become one instruction.
    kept : bool
        Whether its machine code is kept; False for inner kernels, which only kernels call. What is
        kept of a kernel holds the inner ones that it calls.

    Notes
    -----
    A kernel that is kept is called with one set of types only. numba (0.68) numbers the files of a
    function without a lock: where two processes compile it for two sets of types at the same time,
    both may take the same number, and later processes would run the machine code of the wrong
    types. Inner kernels are called with many: a constant argument is a type of its own.

    The code is kept in ``NUMBA_CACHE_DIR`` where that is set, otherwise beside the module or in the
    user's cache folder: the first of them that can be written. Where none can, as in an
    installation that is read-only for a user without a home, every process compiles anew.
    """
    from numba import njit

    fastmath = {"contract"} if fuses else False
    if not kept:
        return cast(Function, njit(nogil=True, error_model="numpy", fastmath=fastmath)(function))
    try:
        found = njit(nogil=True, cache=True, error_model="numpy", fastmath=fastmath)(function)
    except RuntimeError:
        # What numba raises where no folder can be written.
        found = njit(nogil=True, error_model="numpy", fastmath=fastmath)(function)
    return cast(Function, found)


@dataclass(frozen=True, eq=False)
class DeclaredKernel:
    """A kernel, and the types of the arguments that it is called with.

    Parameters
    ----------
    function : callable
        What `compiled` returned.
    types : str
        As numba writes them, separated by commas: ``"int64, float32[:, ::1]"``.
    """

    function: Callable[..., object]
    types: str

    @property
    def name(self) -> str:
        """Its module and its name there, with a colon between."""
        return f"{self.function.__module__}:{self.function.__name__}"

    @property
    def folder(self) -> Path | None:
        """Where its machine code is kept; None where no folder can be written."""
        stats = getattr(self.function, "stats", None)
        return Path(stats.cache_path) if stats is not None and stats.cache_path else None

    def is_cached(self) -> bool:
        """Tell whether the folder of machine code has an entry for this kernel.

        Code for another processor or of an earlier version of the module may be all there is; then
        the kernel is compiled when it is called.
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
        """Compile it, or load it where its machine code is kept already."""
        dispatcher = cast(Any, self.function)
        # With NUMBA_DISABLE_JIT it is plain Python.
        if not hasattr(dispatcher, "compile"):
            return
        from numba.core import sigutils

        # numba files machine code under what it is given here, and a call looks it up under a
        # tuple of types: under the text of a signature no call would find it.
        types, _ = cast(Any, sigutils).normalize_signature(f"({self.types},)")
        dispatcher.compile(tuple(types))


_DECLARED: Final[dict[str, DeclaredKernel]] = {}


def called_with(types: str) -> Callable[[Function], Function]:
    """Declare what types a kernel is called with; stands above the decorator that compiles it.

    Parameters
    ----------
    types : str
        As in `DeclaredKernel`.
    """

    def declare(function: Function) -> Function:
        kernel = DeclaredKernel(function, types)
        _DECLARED[kernel.name] = kernel
        return function

    return declare


def declared_in(modules: Iterable[str]) -> list[DeclaredKernel]:
    """Import some modules and return the kernels that they declare, in the order of the modules."""
    found: list[DeclaredKernel] = []
    for module in modules:
        importlib.import_module(module)
        found += [kernel for kernel in _DECLARED.values() if kernel.function.__module__ == module]
    return found


def declared(name: str) -> DeclaredKernel:
    """Return the kernel of a name that `DeclaredKernel.name` gave, also in another process.

    Raises
    ------
    KeyError
        Its module declares no such kernel.
    """
    importlib.import_module(name.partition(":")[0])
    return _DECLARED[name]
