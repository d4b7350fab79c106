"""Disk cache of segments by content hash, shared by all scenes and versions."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import atomic_write

# Eviction ends at this share of the size limit, so that it does not run with every new segment.
_KEPT_SHARE: Final = 0.8


class SegmentCache:
    """Disk cache of segments by hash, with least-recently-used eviction; processes may share it.

    Parameters
    ----------
    folder : Path
        Folder of the cache; created if it does not exist.
    max_bytes : int
        Approximate size limit, bytes.

    Examples
    --------
    >>> import hashlib
    >>> from pathlib import Path
    >>> from cogsplat.formats.network.segment_cache import SegmentCache
    >>> cache = SegmentCache(Path("kept"), max_bytes=1 << 20)
    >>> key = hashlib.sha256(b"segment").digest()[:16]
    >>> cache.put(key, b"segment")
    >>> cache.get(key)
    b'segment'
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._added = 0

    def has(self, key: bytes) -> bool:
        """Whether the segment with the hash `key` is cached."""
        return (self._folder / key.hex()).is_file()

    def get(self, key: bytes) -> bytes | None:
        """Return a segment; None on a cache miss.

        Parameters
        ----------
        key : bytes
            First bytes of the segment's SHA-256.
        """
        path = self._folder / key.hex()
        try:
            data = path.read_bytes()
            os.utime(path)
        except OSError:
            # A miss, or another process evicted the file.
            return None
        return data if _has_hash(key, data) else None

    def put(self, key: bytes, data: bytes) -> None:
        """Add a segment; skip one whose hash is not `key`, as a hostile file may claim any hash."""
        if not _has_hash(key, data):
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(self._folder / key.hex(), force=True) as file:
                file.write(data)
        except (OSError, StorageError):
            # The disk is full or the folder read-only: the cache is optional.
            return
        self._added += len(data)
        if self._added > self._max_bytes * (1 - _KEPT_SHARE):
            self._added = 0
            self._evict()

    def _evict(self) -> None:
        """Remove the least recently used segments if the cache exceeds its size limit."""
        files = [(path, path.stat()) for path in self._folder.iterdir() if path.is_file()]
        size = sum(status.st_size for _, status in files)
        if size <= self._max_bytes:
            return
        for path, status in sorted(files, key=lambda entry: entry[1].st_mtime_ns):
            path.unlink(missing_ok=True)
            size -= status.st_size
            if size <= self._max_bytes * _KEPT_SHARE:
                return


def _has_hash(key: bytes, data: bytes) -> bool:
    """Whether the SHA-256 of `data` begins with `key`."""
    return hashlib.sha256(data).digest()[: len(key)] == key
