"""Loading of compiled kernels on a thread of their own, while numpy decodes.

Kernels that are in numba's folder of machine code are loaded from there in a fraction of a second,
others are compiled first. Nobody waits for either: a process that ends or forks does so after the
kernel that is being loaded, not after all.
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

# How long a thread keeps the interpreter's lock from others while kernels are loaded, seconds. At
# Python's own 0.005 a decode beside it waits that long at each of some hundred planes.
_SWITCH_S: Final = 0.0005


class KernelLoader:
    """Loads kernels on a daemon thread, once.

    Parameters
    ----------
    modules : sequence of str
        Whose kernels are loaded.
    finished : callable
        Is called on that thread when all are there.
    """

    def __init__(self, modules: Sequence[str], finished: Callable[[], object]) -> None:
        self._modules = modules
        self._finished = finished
        # Held for each step, so that nothing forks or ends in the middle of one. A step may fork
        # itself: numba runs other programs.
        self._step = threading.RLock()
        self._stopped = threading.Event()
        self._ended = False
        self._registered = False
        self._interval_s = sys.getswitchinterval()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to load, where numba is installed; a second call does nothing."""
        if self._thread is not None or self._stopped.is_set():
            return
        if importlib.util.find_spec("numba") is None:
            self._stopped.set()
            return
        self._register()
        self._thread = threading.Thread(target=self._load, name="cogsplat kernels", daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Wait until loading has ended, if it has begun."""
        if self._thread is not None:
            self._thread.join()

    def _register(self) -> None:
        if self._registered:
            return
        self._registered = True
        atexit.register(self._stop)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(
                before=self._step.acquire,
                after_in_parent=self._step.release,
                after_in_child=self._forked,
            )

    def _load(self) -> None:
        self._interval_s = sys.getswitchinterval()
        sys.setswitchinterval(min(self._interval_s, _SWITCH_S))
        try:
            self._load_all()
        except Exception as error:
            # Whatever numba finds in its way, numpy decodes as well; but not silently slower.
            warnings.warn(
                CogsplatWarning(f"decoding stays in numpy, its kernels cannot be loaded: {error}"),
                stacklevel=1,
            )
        finally:
            sys.setswitchinterval(self._interval_s)
            self._ended = True

    def _load_all(self) -> None:
        """Load one kernel after the other, unless the process is about to end before."""
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
            self._finished()

    def _stop(self) -> None:
        """Let the step under way end, and no other begin."""
        self._stopped.set()
        with self._step:
            return

    def _forked(self) -> None:
        """Be ready to begin anew in a child process, which does not have the thread."""
        self._step.release()
        if self._thread is not None and not self._ended:
            self._thread = None
            sys.setswitchinterval(self._interval_s)
