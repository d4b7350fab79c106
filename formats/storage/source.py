"""Byte sources: local files, memory, file objects and prefixes of sources."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import BinaryIO, Protocol, cast, runtime_checkable

from cogsplat.codec.errors import StorageError, TruncatedError

from .atomic import open_for_read


class Source(Protocol):
    """Protocol for reading byte ranges from files, memory, HTTP or object stores.

    Notes
    -----
    Three further members are optional. The attribute ``first_request_bytes`` is the best size of
    the first read, bytes. The method ``holds(offset, length)`` is for sources with gaps: it says
    whether a range is present. The attribute ``stored_bytes`` is the number of bytes that
    the source occupies, where it is below `size`, as in a folder with missing objects.
    """

    @property
    def name(self) -> str:
        """Name of the source in messages."""

    @property
    def size(self) -> int:
        """Length of the source, bytes."""

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
        """Free files, connections and memory; later reads fail."""


Cancel = Callable[[], None]
"""Cancels a prefetch: reads of its ranges raise `Cancelled`."""


@runtime_checkable
class RemoteSource(Source, Protocol):
    """Source with slow reads, which can prefetch ranges and fetch damaged ranges again."""

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Prefetch ranges, in the given order, while a ``with`` block runs.

        Parameters
        ----------
        ranges : sequence of (int, int)
            Offset and length of each later read, bytes.
        any_order : bool
            Whether the source may reorder the ranges to save requests, because the caller needs
            most of them before it begins.

        Returns
        -------
        context manager of callable
            The callable cancels the prefetch from any thread; reads then raise `Cancelled`.
        """

    def reread(self, offset: int, length: int) -> bytes:
        """Fetch a damaged range again, bypassing HTTP caches; otherwise as `read`."""


def prefetching(
    source: Source, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
) -> AbstractContextManager[Cancel]:
    """Prefetch ranges of a remote source until the block ends; no effect on local sources.

    Parameters
    ----------
    source : Source
        Source to read from.
    ranges : sequence of (int, int)
        Offset and length of each later read, bytes, in order.
    any_order : bool
        Whether the source may reorder the ranges; see `RemoteSource.prefetch`.
    """
    if isinstance(source, RemoteSource):
        return source.prefetch(ranges, any_order=any_order)
    return nullcontext(lambda: None)


def has_arrived(source: Source, offset: int, length: int) -> bool:
    """Whether a read of the range would return without waiting for the network."""
    arrived = getattr(source, "arrived", None)
    return arrived is None or bool(arrived(offset, length))


class BytesSource:
    """Source over bytes in memory; reads return copies."""

    def __init__(self, data: bytes, name: str = "bytes") -> None:
        self._data = data
        self.name = name

    @property
    def size(self) -> int:
        """Length of the source, bytes."""
        return len(self._data)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        require_within(self, offset, length)
        return self._data[offset : offset + length]

    def close(self) -> None:
        """Do nothing: memory needs no closing."""


class FileSource:
    """Source over a local file, safe to read from several threads.

    Parameters
    ----------
    path : Path
        Regular file.

    Raises
    ------
    StorageError
        ``not-found``, ``permission`` or ``io``.

    Notes
    -----
    The file is read instead of mapped: with a map, a file that is cut short kills the process.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._file: BinaryIO = open_for_read(path)
        self._lock = threading.Lock()
        self._size = os.fstat(self._file.fileno()).st_size

    @property
    def size(self) -> int:
        """Length of the file when it was opened, bytes."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        require_within(self, offset, length)
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
                "the file became shorter while it was read: open it again",
                offset=offset,
                needed=offset + length,
            )
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class StreamSource:
    """Source over an open, seekable binary file object; `close` leaves it open.

    Parameters
    ----------
    stream : BinaryIO
        File object open for reading: a file, ``io.BytesIO``, or one of a storage library.

    Raises
    ------
    StorageError
        ``not-seekable``: it cannot seek, such as a pipe.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.name = str(getattr(stream, "name", type(stream).__name__))
        if not stream.seekable():
            raise StorageError("not-seekable", f"{self.name}: cannot seek, expected a file")
        self._stream = stream
        self._lock = threading.Lock()
        self._size = stream.seek(0, os.SEEK_END)

    @property
    def size(self) -> int:
        """Length of the stream when the source was made, bytes."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        require_within(self, offset, length)
        parts: list[bytes] = []
        missing = length
        try:
            with self._lock:
                self._stream.seek(offset)
                while missing:
                    # A stream may return fewer bytes than requested.
                    part = self._stream.read(missing)
                    if not part:
                        break
                    parts.append(part)
                    missing -= len(part)
        except OSError as error:
            raise StorageError("io", f"{self.name}: {error} at byte {offset}") from error
        if missing:
            raise TruncatedError(
                "source-changed",
                f"{self.name}: {length - missing} bytes at byte {offset}, expected {length}; "
                "the stream became shorter while it was read: open it again",
                offset=offset,
                needed=offset + length,
            )
        return b"".join(parts)

    def close(self) -> None:
        """Do nothing: the caller closes the stream."""


class PrefixSource:
    """Prefix of another source, like a file whose transfer stopped early.

    Parameters
    ----------
    source : Source
        Whole source; closed with the prefix.
    size : int
        Length of the prefix, bytes.
    """

    def __init__(self, source: Source, size: int) -> None:
        self._source = source
        self._size = min(size, source.size)
        self.name = f"{source.name} (first {self._size} bytes)"

    @property
    def size(self) -> int:
        """Length of the prefix, bytes."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        require_within(self, offset, length)
        return self._source.read(offset, length)

    @property
    def first_request_bytes(self) -> int:
        """Best size of the first read, bytes."""
        return first_request_bytes(self._source, self._size)

    def holds(self, offset: int, length: int) -> bool:
        """Whether a range within the size is present."""
        return has_range(self._source, offset, length)

    @property
    def stored_bytes(self) -> int:
        """Number of bytes that the whole source occupies, capped at the length of the prefix."""
        return min(self._size, stored_bytes(self._source))

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Prefetch ranges of the whole source; see `RemoteSource.prefetch`."""
        kept = [x for x in ranges if x[0] + x[1] <= self._size]
        return prefetching(self._source, kept, any_order=any_order)

    def reread(self, offset: int, length: int) -> bytes:
        """Fetch a damaged range again, if the source is remote; see `RemoteSource.reread`."""
        require_within(self, offset, length)
        source = self._source
        again = source.reread if isinstance(source, RemoteSource) else source.read
        return again(offset, length)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether a read would return at once; see `has_arrived`."""
        return has_arrived(self._source, offset, length)

    @property
    def traffic(self) -> object:
        """`Traffic` of the whole source; None for a local one."""
        return getattr(self._source, "traffic", None)

    def close(self) -> None:
        """Close the whole source."""
        self._source.close()


def first_request_bytes(source: Source, default: int) -> int:
    """Return the best size of the first read of a source, bytes; `default` if it has none."""
    return min(source.size, int(getattr(source, "first_request_bytes", default)))


def has_range(source: Source, offset: int, length: int) -> bool:
    """Whether a source has every byte of a range."""
    if offset + length > source.size:
        return False
    holds = getattr(source, "holds", None)
    return holds is None or bool(holds(offset, length))


def stored_bytes(source: Source) -> int:
    """Return the number of bytes that a source occupies, which may be below its length.

    For a folder, the length of its manifest and objects; by default the length of the source.
    """
    return int(getattr(source, "stored_bytes", source.size))


def require_within(source: Source, offset: int, length: int) -> None:
    """Refuse a range outside a source.

    Raises
    ------
    ValueError
        The offset or the length is negative.
    TruncatedError
        ``file-truncated``: the source ends before the range does.
    """
    if offset < 0 or length < 0:
        raise ValueError(f"offset {offset} and length {length}, expected no negative number")
    if offset + length > source.size:
        raise TruncatedError(
            "file-truncated",
            f"{source.name}: {source.size} bytes, expected {offset + length} for the "
            f"{length} bytes at byte {offset}",
            offset=offset,
            needed=offset + length,
        )


Readable = str | os.PathLike[str] | bytes | bytearray | memoryview | BinaryIO | Source
"""Types that `as_source` accepts: paths, bytes, binary file objects and sources."""


def as_source(given: Readable) -> Source:
    """Return a source for a path, bytes or a binary file object; return a source unchanged.

    Raises
    ------
    StorageError
        The errors of `FileSource` and `StreamSource`.
    TypeError
        `given` has another type.
    """
    if isinstance(given, str | os.PathLike):
        return FileSource(Path(given))
    if isinstance(given, bytes | bytearray | memoryview):
        return BytesSource(bytes(given))
    if isinstance(given, io.IOBase) or (hasattr(given, "seek") and hasattr(given, "read")):
        return StreamSource(cast("BinaryIO", given))
    if hasattr(given, "read") and hasattr(given, "size"):
        return cast("Source", given)
    raise TypeError(
        f"a {type(given).__name__}, expected a path, bytes, a binary file object, or a Source with "
        "name, size, read and close"
    )
