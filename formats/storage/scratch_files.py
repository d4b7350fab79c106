"""Arrays in unnamed files that are mapped into memory, few of whose pages stay there."""

from __future__ import annotations

import math
import mmap
import os
import sys
import tempfile
import threading
import weakref
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .atomic import storage_errors

_STATM: Final = Path("/proc/self/statm")
"""Pages of this process: in all, resident, resident of files (Linux, proc(5))."""

# How often the resident pages are counted, seconds. In this time two cores touch some tens of MB.
_INTERVAL: Final = 0.005

# Smaller arrays are not worth a file each.
_LEAST_BYTES: Final = 1 << 18


class ScratchFiles:
    """Arrays of zeros in files that vanish with them.

    A context manager: while it is entered, pages of the files that are in memory are given back to
    the system as often as they are more than `resident_bytes`. Their contents stay, in the files.
    Only Linux tells a process how many they are; elsewhere the system alone decides.

    Parameters
    ----------
    folder : Path
        Where the files are made. They have no names, and no crash leaves one behind.
    resident_bytes : int
        Of the files' bytes, how many may be resident. A fast reader may pass it for a few
        milliseconds.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder, ScratchFiles(Path(folder), 1 << 20) as files:
    ...     values = files.zeros((1000, 3), "f4")
    >>> values.shape, float(values.sum())
    ((1000, 3), 0.0)
    """

    def __init__(self, folder: Path, resident_bytes: int) -> None:
        self._folder = folder
        self._resident_bytes = resident_bytes
        # Forgotten with the last array that looks into it: a search makes several.
        self._maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()
        # Programs and libraries are files as well: what stays after a release is theirs.
        self._theirs = _resident_file_bytes()
        self._stopped = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> ScratchFiles:
        if _STATM.exists():
            self._watcher.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stopped.set()
        if self._watcher.is_alive():
            self._watcher.join()

    def zeros(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array of zeros, C-ordered and writable; a small one lies in memory.

        Raises
        ------
        StorageError
            ``disk-full`` where the folder has no room for it, ``permission``, ``io``.
        """
        kind = np.dtype(dtype)
        size = math.prod(shape) * kind.itemsize
        if size < _LEAST_BYTES:
            return np.zeros(shape, kind)
        with storage_errors(self._folder), tempfile.TemporaryFile(dir=self._folder) as file:
            # Reserved now: a write into a mapped page that finds no room ends the process.
            if sys.platform == "linux":
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
        with self._lock:
            self._maps.add(mapped)
        return np.frombuffer(mapped, kind).reshape(shape)

    def settle(self) -> None:
        """Give the resident pages of the files back to the system if they are too many."""
        with self._lock:
            if _resident_file_bytes() - self._theirs <= self._resident_bytes:
                return
            for mapped in self._maps:
                mapped.madvise(mmap.MADV_DONTNEED)
            self._theirs = _resident_file_bytes()

    def _watch(self) -> None:
        while not self._stopped.wait(_INTERVAL):
            self.settle()


def _resident_file_bytes() -> int:
    """Return the bytes of files that are resident in this process; 0 where nobody says."""
    if not _STATM.exists():
        return 0
    return int(_STATM.read_text(encoding="ascii").split()[2]) * mmap.PAGESIZE
