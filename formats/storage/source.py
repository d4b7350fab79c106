"""Byte sources: local files, memory, prefixes, and whatever else reads ranges."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import BinaryIO, Protocol

from cogsplat.codec.errors import StorageError, TruncatedError

from .atomic import open_for_read


class Source(Protocol):
    """A protocol for reading byte ranges, from files, memory, HTTP or object stores."""

    @property
    def name(self) -> str:
        """Names the source in messages."""

    @property
    def size(self) -> int:
        """Bytes there are."""

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`.

        Raises
        ------
        TruncatedError
            The source ends before ``offset + length``.
        StorageError
            Reading failed.
        """

    def close(self) -> None:
        """Give back what the source holds; reading is over."""


class BytesSource:
    """A source over bytes in memory; slices are copies."""

    def __init__(self, data: bytes, name: str = "bytes") -> None:
        self._data = data
        self.name = name

    @property
    def size(self) -> int:
        """Bytes there are."""
        return len(self._data)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        _check_end(self, offset, length)
        return self._data[offset : offset + length]

    def close(self) -> None:
        """Do nothing: memory needs no closing."""


class FileSource:
    """A source over a local file, safe to read from several threads.

    Parameters
    ----------
    path : Path

    Raises
    ------
    StorageError
        ``not-found``, ``permission`` or ``io``.

    Notes
    -----
    Reads copy rather than map, so that a file cut short under us is an error, not a crash.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._file: BinaryIO = open_for_read(path)
        self._lock = threading.Lock()
        self._size = os.fstat(self._file.fileno()).st_size

    @property
    def size(self) -> int:
        """Bytes the file had when it was opened."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        _check_end(self, offset, length)
        try:
            with self._lock:
                self._file.seek(offset)
                data = self._file.read(length)
        except OSError as error:
            raise StorageError("io", f"{self.name}: {error.strerror} at byte {offset}") from error
        if len(data) != length:
            raise TruncatedError(
                "source-changed",
                f"{self.name}: {len(data)} bytes at byte {offset}, expected {length}; "
                "the file became shorter while it was read",
                offset=offset,
                needed=offset + length,
            )
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class PrefixSource:
    """A prefix of another source, like a file whose transfer stopped early."""

    def __init__(self, source: Source, size: int) -> None:
        self._source = source
        self._size = min(size, source.size)
        self.name = f"{source.name} (first {self._size} bytes)"

    @property
    def size(self) -> int:
        """Bytes there are."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        _check_end(self, offset, length)
        return self._source.read(offset, length)

    def close(self) -> None:
        """Close the source behind this one."""
        self._source.close()


def _check_end(source: Source, offset: int, length: int) -> None:
    if offset < 0 or length < 0:
        raise ValueError(f"offset {offset} and length {length}, expected none negative")
    if offset + length > source.size:
        raise TruncatedError(
            "file-truncated",
            f"{source.name}: {source.size} bytes, expected {offset + length} for the "
            f"{length} bytes at byte {offset}",
            offset=offset,
            needed=offset + length,
        )
