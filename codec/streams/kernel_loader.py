"""Loading of compiled kernels on a background thread, while numpy decodes.

Kernels whose machine code is in numba's cache load in a fraction of a second; others are compiled
first. Neither blocks the process. At exit or fork, the process waits for one kernel at most.
"""

from __future__ import annotations

import atexit
import importlib.util
import os
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Final

from cogsplat.codec.compiling import kernels_in
from cogsplat.codec.errors import CogsplatWarning

# Interval at which threads yield the interpreter's lock while kernels are loaded, seconds. With
# Python's default of 0.005 a concurrent decode waits that long at each of some hundred planes.
_SWITCH_S: Final = 0.0005


class KernelLoader:
    """Loads kernels on a daemon thread, once.

    Parameters
    ----------
    modules : sequence of str
        Names of the modules whose kernels are loaded.
    on_loaded : callable
        Called on the loading thread when all kernels are loaded.
    """

    def __init__(self, modules: Sequence[str], on_loaded: Callable[[], object]) -> None:
        self._modules = modules
        self._on_loaded = on_loaded
        # Held during each step: the process forks or exits between steps only.
        # Re-entrant because a step may fork itself: numba runs other programs.
        self._step = threading.RLock()
        self._stopped = threading.Event()
        self._ended = False
        self._registered = False
        self._interval_s = sys.getswitchinterval()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start loading if numba is installed; a second call does nothing."""
        # Threads may call this at once. Whoever holds the lock starts loading, or loads already.
        if self._thread is not None or not self._step.acquire(blocking=False):
            return
        try:
            if self._thread is not None or self._stopped.is_set():
                return
            if importlib.util.find_spec("numba") is None:
                self._stopped.set()
                return
            self._register()
            thread = threading.Thread(target=self._load, name="cogsplat kernels", daemon=True)
            thread.start()
            self._thread = thread
        finally:
            self._step.release()

    def join(self) -> None:
        """Wait until loading has ended, if it was started."""
        if self._thread is not None:
            self._thread.join()

    def _register(self) -> None:
        """Register the exit and fork handlers; a second call does nothing."""
        if self._registered:
            return
        self._registered = True
        atexit.register(self._stop)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(
                before=self._step.acquire,
                after_in_parent=self._step.release,
                after_in_child=self._reset_in_child,
            )

    def _load(self) -> None:
        """Load all kernels; on failure warn and leave decoding to numpy."""
        self._interval_s = sys.getswitchinterval()
        sys.setswitchinterval(min(self._interval_s, _SWITCH_S))
        try:
            self._load_all()
        except Exception as error:
            # numba and LLVM raise errors of many types, and nobody joins this thread: numpy decodes
            # to the same bits, and the warning says why decoding is slower.
            warnings.warn(
                CogsplatWarning(f"decoding stays in numpy, kernels cannot be loaded: {error!r}"),
                stacklevel=1,
            )
        finally:
            sys.setswitchinterval(self._interval_s)
            self._ended = True

    def _load_all(self) -> None:
        """Load all kernels in turn; stop early if the process exits."""
        for module in self._modules:
            with self._step:
                if self._stopped.is_set():
                    return
                kernels = kernels_in([module])
            for kernel in kernels:
                with self._step:
                    if self._stopped.is_set():
                        return
                    kernel.compile()
        with self._step:
            self._on_loaded()

    def _stop(self) -> None:
        """Stop loading when the process exits; return once the current step has ended."""
        self._stopped.set()
        with self._step:
            return

    def _reset_in_child(self) -> None:
        """Let `start` work again in a forked child, which does not inherit the loading thread."""
        self._step.release()
        if self._thread is not None and not self._ended:
            self._thread = None
            sys.setswitchinterval(self._interval_s)
