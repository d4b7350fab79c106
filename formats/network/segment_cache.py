"""Segments kept on disk by the hash of their content, for every scene and version that has them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import atomic_write

# Where there is more than allowed, the least recently used go, down to this share of it.
_KEPT_SHARE: Final = 0.8


class SegmentCache:
    """A folder of segments by their hashes; processes may share it.

    Parameters
    ----------
    folder : Path
        Made where it is not there.
    most_bytes : int
        What is kept, nearly.

    Examples
    --------
    >>> import hashlib
    >>> from pathlib import Path
    >>> from cogsplat.formats.network.segment_cache import SegmentCache
    >>> cache = SegmentCache(Path("kept"), most_bytes=1 << 20)
    >>> key = hashlib.sha256(b"segment").digest()[:16]
    >>> cache.put(key, b"segment")
    >>> cache.get(key)
    b'segment'
    """

    def __init__(self, folder: Path, most_bytes: int) -> None:
        self._folder = folder
        self._most_bytes = most_bytes
        self._added = 0

    def has(self, key: bytes) -> bool:
        """Whether a segment is kept."""
        return (self._folder / key.hex()).is_file()

    def get(self, key: bytes) -> bytes | None:
        """Return a segment, None where it is not kept.

        Parameters
        ----------
        key : bytes
            The first bytes of its SHA-256.
        """
        path = self._folder / key.hex()
        try:
            data = path.read_bytes()
            os.utime(path)
        except OSError:
            # Another process may have removed it; it is fetched then.
            return None
        return data if _is_of(key, data) else None

    def put(self, key: bytes, data: bytes) -> None:
        """Keep a segment, unless its hash is not the key: a file may state what it likes."""
        if not _is_of(key, data):
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(self._folder / key.hex(), force=True) as file:
                file.write(data)
        except (OSError, StorageError):
            # A full disk, or a folder that cannot be written: the segment is used all the same.
            return
        self._added += len(data)
        if self._added > self._most_bytes * (1 - _KEPT_SHARE):
            self._added = 0
            self._shrink()

    def _shrink(self) -> None:
        """Remove the least recently used segments where there is more than allowed."""
        files = [(path, path.stat()) for path in self._folder.iterdir() if path.is_file()]
        size = sum(status.st_size for _, status in files)
        if size <= self._most_bytes:
            return
        for path, status in sorted(files, key=lambda entry: entry[1].st_mtime_ns):
            path.unlink(missing_ok=True)
            size -= status.st_size
            if size <= self._most_bytes * _KEPT_SHARE:
                return


def _is_of(key: bytes, data: bytes) -> bool:
    return hashlib.sha256(data).digest()[: len(key)] == key
