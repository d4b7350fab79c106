"""Disk cache of segments by content hash, shared by all scenes and versions."""

from __future__ import annotations

import hashlib
import os
import re
import stat
import warnings
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import CogsplatWarning, StorageError
from cogsplat.formats.storage.atomic import atomic_write, storage_errors
from cogsplat.formats.storage.regular_files import open_regular, read_regular

_FOLDER: Final = "cogsplat-segments"
_NAME: Final = re.compile(r"[0-9a-f]{32}\.segment", re.ASCII)

# Marks the folder as a cache for backup programs as well: https://bford.info/cachedir
_TAG_NAME: Final = "CACHEDIR.TAG"
_TAG: Final = (
    b"Signature: 8a477f597d28d172789f06886806bc55\n"
    b"# Segments of scenes that cogsplat read over a network. Deleting this folder is safe.\n"
)

# Eviction ends at this share of the size limit, so that it does not run with every new segment.
_KEPT_SHARE: Final = 0.8


class SegmentCache:
    """Disk cache of segments by hash, with least-recently-used eviction; processes may share it.

    Its files are in the subfolder ``cogsplat-segments``, marked by a ``CACHEDIR.TAG``. Only regular
    files there with names of segments are read, counted and removed; links are not followed. A
    cache that cannot be used gives a warning once, and every lookup misses.

    Parameters
    ----------
    folder : Path
        Folder for the cache's subfolder; created if it does not exist.
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
    >>> cache.get(key, 7)
    b'segment'
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder / _FOLDER
        self._max_bytes = max_bytes
        self._added = 0
        self._has_warned = False
        # Whether the folder was found with its tag, so that not every lookup reads it.
        self._is_known = False

    def has(self, key: bytes, length: int) -> bool:
        """Whether a file of the right length is cached for a segment.

        Parameters
        ----------
        key : bytes
            First bytes of the segment's SHA-256.
        length : int
            Length of the segment, bytes.
        """
        try:
            status = self._path(key).lstat()
        except OSError:
            # A cache miss.
            return False
        self._is_known = self._is_known or self._is_ours()
        return stat.S_ISREG(status.st_mode) and status.st_size == length and self._is_known

    def get(self, key: bytes, length: int) -> bytes | None:
        """Return a segment; None on a cache miss. Parameters as in `has`."""
        if not self.has(key, length):
            return None
        path = self._path(key)
        try:
            data = read_regular(path, length)
            os.utime(path, follow_symlinks=os.utime not in os.supports_follow_symlinks)
        except (OSError, StorageError):
            # Another process evicted or replaced the file: a miss.
            return None
        return data if _has_hash(key, data) else None

    def put(self, key: bytes, data: bytes) -> None:
        """Add a segment; skip one whose hash is not `key`, as a hostile file may claim any hash."""
        if not _has_hash(key, data):
            return
        try:
            self._make_folder()
            # Not synced: a file that a crash cut has another hash, and is a miss.
            with atomic_write(
                self._path(key), force=True, durable=False, follow_links=False
            ) as file:
                file.write(data)
        except StorageError as error:
            self._warn(error)
            return
        self._added += len(data)
        if self._added > self._max_bytes * (1 - _KEPT_SHARE):
            self._added = 0
            self._evict()

    def _path(self, key: bytes) -> Path:
        """Return the path of a segment's file."""
        return self._folder / f"{key.hex()}.segment"

    def _make_folder(self) -> None:
        """Create and tag the cache folder; refuse links and foreign folders."""
        with storage_errors(self._folder):
            self._folder.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._folder.mkdir()
            except FileExistsError:
                is_link = self._folder.is_symlink()
                # Another process may be writing the tag at this moment.
                is_empty = all(_TAG_NAME in path.name for path in self._folder.iterdir())
                if self._is_ours():
                    return
                if is_link or not is_empty:
                    raise StorageError(
                        "not-a-file",
                        f"{self._folder}: exists and is no cache of cogsplat, expected a folder "
                        f"with our {_TAG_NAME}; name another folder",
                    ) from None
            with atomic_write(self._folder / _TAG_NAME, force=True, follow_links=False) as file:
                file.write(_TAG)

    def _is_ours(self) -> bool:
        """Whether the folder exists, is no link, and has the tag of this cache."""
        try:
            if not stat.S_ISDIR(self._folder.lstat().st_mode):
                return False
            with open_regular(self._folder / _TAG_NAME) as file:
                return file.read(len(_TAG)) == _TAG
        except (OSError, StorageError):
            # No folder or no tag.
            return False

    def _evict(self) -> None:
        """Remove the least recently used segments if the cache exceeds its size limit."""
        if not self._is_ours():
            return
        files = []
        size = 0
        try:
            with os.scandir(self._folder) as entries:
                names = [entry.name for entry in entries if _NAME.fullmatch(entry.name)]
        except OSError as error:
            self._warn(error)
            return
        for name in names:
            path = self._folder / name
            try:
                status = path.lstat()
            except OSError:
                # Another process evicted the file.
                continue
            if stat.S_ISREG(status.st_mode):
                files.append((status.st_mtime_ns, name, status.st_size))
                size += status.st_size
        if size <= self._max_bytes:
            return
        for _, name, length in sorted(files):
            try:
                (self._folder / name).unlink(missing_ok=True)
            except OSError as error:
                self._warn(error)
                continue
            size -= length
            if size <= self._max_bytes * _KEPT_SHARE:
                return

    def _warn(self, error: Exception) -> None:
        """Warn once that the cache cannot be used; reading goes on without it."""
        if not self._has_warned:
            self._has_warned = True
            warnings.warn(
                f"{self._folder}: segments are not cached: {error}", CogsplatWarning, stacklevel=2
            )


def _has_hash(key: bytes, data: bytes) -> bool:
    """Whether the SHA-256 of `data` begins with `key`."""
    return hashlib.sha256(data).digest()[: len(key)] == key
