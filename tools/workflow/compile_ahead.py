"""Compile kernels before the first call, in several processes at once.

numba holds the interpreter's lock while it compiles, so threads would wait for each other.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Final

from cogsplat.codec.compiling import DeclaredKernel
from cogsplat.codec.progress import Progress, silent

_PROCESS: Final = "cogsplat.tools.workflow.kernel_process"

# Uncompiled kernels per additional process: loading numba takes half a second, compiling a kernel a
# third of a second on average.
_KERNELS_PER_PROCESS: Final = 4

# Fractional parts of its multiples are far apart for neighbouring process numbers.
_GOLDEN_RATIO: Final = 0.618034

# Interval of progress reports while other processes compile, s.
_REPORT_SECONDS: Final = 0.1


class CompileAhead:
    """Processes that compile the kernels missing from the folder of machine code.

    A context manager; the processes start on entry. `finish` compiles in this process as well and
    returns when all kernels are compiled. Leaving the context ends the processes. A kernel that is
    not compiled by then is compiled at its first call. Without a folder or a process, every kernel
    is. Several commands at a time share the work: each skips kernels that another has compiled.

    Parameters
    ----------
    kernels : sequence of DeclaredKernel
        Kernels to compile, in a circle: from a place that depends on the process number, this
        process goes backward and the others forward. Kernels that call the same inner kernels
        should be neighbours, because every process compiles the inner kernels anew.
    processes : int
        Number of processes at most, including this one.
    """

    def __init__(self, kernels: Sequence[DeclaredKernel], processes: int) -> None:
        kept = [kernel for kernel in kernels if kernel.folder is not None]
        self._waiting = deque(kernel for kernel in kept if not kernel.is_cached())
        # Commands that start at the same time compile different kernels. An empty cache and two
        # encodes of a batch: 43.8 s of processor time from one place, 31.2 s from places apart.
        self._waiting.rotate(int(os.getpid() * _GOLDEN_RATIO % 1.0 * len(self._waiting)))
        self.total = len(self._waiting)
        """Number of kernels that were missing on entry."""
        self._done = 0
        self._lock = threading.Lock()
        self._processes: list[subprocess.Popen[str]] = []
        helpers = min(processes - 1, self.total // _KERNELS_PER_PROCESS)
        self._feeders = [threading.Thread(target=self._feed, daemon=True) for _ in range(helpers)]

    def __enter__(self) -> CompileAhead:
        for feeder in self._feeders:
            feeder.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._waiting.clear()
            for process in self._processes:
                process.terminate()
        for feeder in self._feeders:
            feeder.join()

    def finish(self, progress: Progress = silent) -> None:
        """Compile in this process as well until all kernels are compiled.

        Parameters
        ----------
        progress : Progress
            Called with ``("compile", kernels done, kernels)`` if any kernel was missing.
        """
        while self._done < self.total:
            progress("compile", self._done, self.total)
            kernel = self._next_kernel(last=True)
            if kernel is not None:
                kernel.compile()
                self._count_one()
                continue
            for feeder in self._feeders:
                feeder.join(_REPORT_SECONDS)
        if self.total:
            progress("compile", self.total, self.total)

    def _next_kernel(self, *, last: bool = False) -> DeclaredKernel | None:
        """Remove and return the first or last kernel that is still missing, None without any."""
        with self._lock:
            while self._waiting:
                kernel = self._waiting.pop() if last else self._waiting.popleft()
                if not kernel.is_cached():
                    return kernel
                # Another command compiled it meanwhile.
                self._done += 1
            return None

    def _count_one(self) -> None:
        """Count a compiled kernel."""
        with self._lock:
            self._done += 1

    def _feed(self) -> None:
        """Start a process and send it kernels one by one until the queue is empty."""
        # -P keeps modules of the current folder from being imported.
        command = [sys.executable, "-P", "-m", _PROCESS]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError:
            # Without another process, this one compiles everything.
            return
        with self._lock:
            self._processes.append(process)
        with process:
            while (kernel := self._next_kernel()) is not None:
                if not _compile_in(process, kernel):
                    with self._lock:
                        self._waiting.appendleft(kernel)
                    process.kill()
                    return
                self._count_one()


def _compile_in(process: subprocess.Popen[str], kernel: DeclaredKernel) -> bool:
    """Compile a kernel in another process; return False if that process ended."""
    if process.stdin is None or process.stdout is None:
        return False
    try:
        process.stdin.write(f"{kernel.name}\n")
        process.stdin.flush()
    except OSError:
        return False
    return process.stdout.readline().strip() == kernel.name
