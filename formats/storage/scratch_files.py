"""Memory-mapped arrays in unnamed temporary files, with a limit on resident pages."""

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
"""Page counts of this process: total, resident, resident and file-backed (Linux, proc(5))."""

# Interval between two counts of resident pages, seconds, in which two cores touch some tens of MB.
_INTERVAL: Final = 0.005

# Smaller arrays are kept in memory, because a file each would cost more.
_LEAST_BYTES: Final = 1 << 18


class ScratchFiles:
    """Allocator of zeroed arrays in temporary files, which are deleted with the arrays.

    As a context manager, it runs a thread that evicts the files' pages from memory whenever more
    than `resident_bytes` of them and more than `process_bytes` of the process are resident. The
    contents stay in the files. Only Linux reports resident pages; elsewhere the operating system
    alone evicts pages.

    Parameters
    ----------
    folder : Path
        Folder of the files. The files have no names, so a crash leaves none behind.
    resident_bytes : int
        Resident memory that the files may take in any case, bytes. Fast reads may exceed it for
        milliseconds.
    process_bytes : int
        Resident memory of the process, bytes, up to which the files may take more.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder, ScratchFiles(Path(folder), 1 << 20) as files:
    ...     values = files.zeros((1000, 3), "f4")
    >>> values.shape, float(values.sum())
    ((1000, 3), 0.0)
    """

    def __init__(self, folder: Path, resident_bytes: int, process_bytes: int = 0) -> None:
        self._folder = folder
        self._resident_bytes = resident_bytes
        self._process_bytes = process_bytes
        # Weak: a map is freed with the last array that uses it.
        self._maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()
        # Opened once: page counts are read some hundred times a second.
        self._statm = os.open(_STATM, os.O_RDONLY) if _STATM.exists() else None
        if self._statm is not None:
            weakref.finalize(self, os.close, self._statm)
        # Pages of programs and libraries are file-backed as well, and stay after an eviction.
        self._baseline_bytes = self._resident()[1]
        self._stopped = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> ScratchFiles:
        if self._statm is not None:
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
        """Return a writable C-ordered array of zeros, in memory below 256 KiB, else in a file.

        Raises
        ------
        StorageError
            ``disk-full``, ``permission``, ``io``.
        """
        kind = np.dtype(dtype)
        size = math.prod(shape) * kind.itemsize
        if size < _LEAST_BYTES:
            return np.zeros(shape, kind)
        with storage_errors(self._folder), tempfile.TemporaryFile(dir=self._folder) as file:
            # Reserved now, because a write to a mapped page on a full disk kills the process.
            if sys.platform == "linux":
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
        with self._lock:
            self._maps.add(mapped)
        return np.frombuffer(mapped, kind).reshape(shape)

    def evict(self) -> None:
        """Evict the files' pages from memory if more than the limits are resident."""
        with self._lock:
            process, files = self._resident()
            if process <= self._process_bytes:
                return
            if files - self._baseline_bytes <= self._resident_bytes:
                return
            for mapped in self._maps:
                mapped.madvise(mmap.MADV_DONTNEED)
            self._baseline_bytes = self._resident()[1]

    def _watch(self) -> None:
        """Check the resident pages at intervals until the block ends."""
        while not self._stopped.wait(_INTERVAL):
            self.evict()

    def _resident(self) -> tuple[int, int]:
        """Return the resident bytes of this process, all and file-backed; 0 outside Linux."""
        if self._statm is None:
            return 0, 0
        pages = os.pread(self._statm, 128, 0).split()
        return int(pages[1]) * mmap.PAGESIZE, int(pages[2]) * mmap.PAGESIZE
