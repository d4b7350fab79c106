"""Compile kernels before they are called, in several processes at once.

numba holds the interpreter's lock while it compiles, so that threads would wait for each other.
"""

from __future__ import annotations

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

# Kernels that a further process has to spare the others before it is worth starting: it takes half
# a second to load numba, and a kernel takes a third of one on average.
_WORTH: Final = 4

# How long this process waits for the others before it reports again, seconds.
_WAIT: Final = 0.1


class CompileAhead:
    """Compiles what the folder of machine code lacks, from entering the context on.

    A context manager. Inside, `finish` joins in and returns when all is compiled; leaving the
    context without it ends the other processes, and what they have not compiled is compiled when
    it is called. So is everything where no folder can be written, or no process started.

    Parameters
    ----------
    kernels : sequence of DeclaredKernel
        This process compiles from the last on and the others from the first, so that kernels which
        call the same inner ones stand best beside each other: each process that compiles one of
        them compiles the inner ones as well.
    processes : int
        At most, this one included.
    """

    def __init__(self, kernels: Sequence[DeclaredKernel], processes: int) -> None:
        kept = [kernel for kernel in kernels if kernel.folder is not None]
        self._waiting = deque(kernel for kernel in kept if not kernel.is_cached())
        self.total = len(self._waiting)
        """Kernels that are not there yet."""
        self._done = 0
        self._lock = threading.Lock()
        self._processes: list[subprocess.Popen[str]] = []
        helpers = min(processes - 1, self.total // _WORTH)
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
        """Compile along with the other processes until nothing is left.

        Parameters
        ----------
        progress : Progress
            Called with ``("compile", kernels done, kernels)`` where there are any.
        """
        while self._done < self.total:
            progress("compile", self._done, self.total)
            kernel = self._take(last=True)
            if kernel is not None:
                kernel.compile()
                self._done_one()
                continue
            for feeder in self._feeders:
                feeder.join(_WAIT)
        if self.total:
            progress("compile", self.total, self.total)

    def _take(self, *, last: bool = False) -> DeclaredKernel | None:
        with self._lock:
            if not self._waiting:
                return None
            return self._waiting.pop() if last else self._waiting.popleft()

    def _done_one(self) -> None:
        with self._lock:
            self._done += 1

    def _feed(self) -> None:
        """Give one process after the other kernel until none is left."""
        # -P: what lies in the current folder is none of ours.
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
            # Where the system allows no further process, this one compiles everything.
            return
        with self._lock:
            self._processes.append(process)
        with process:
            while (kernel := self._take()) is not None:
                if not _compiled_by(process, kernel):
                    with self._lock:
                        self._waiting.appendleft(kernel)
                    process.kill()
                    return
                self._done_one()


def _compiled_by(process: subprocess.Popen[str], kernel: DeclaredKernel) -> bool:
    """Have a process compile a kernel; return False where it ended instead."""
    if process.stdin is None or process.stdout is None:
        return False
    try:
        process.stdin.write(f"{kernel.name}\n")
        process.stdin.flush()
    except OSError:
        return False
    return process.stdout.readline().strip() == kernel.name
