"""Byte sources: local files, memory, prefixes, and whatever else reads ranges."""

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
    """A protocol for reading byte ranges, from files, memory, HTTP or object stores.

    Notes
    -----
    A source may have more, which `opening_bytes`, `is_there` and `stored_bytes` ask for: an
    attribute `opening_bytes`, how many bytes are asked of it first; a method
    ``holds(offset, length)``, whether bytes within its size are there, where some may be missing in
    the middle; and an attribute `stored_bytes`, the bytes that it is kept in, where these are fewer
    than its size.
    """

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


Cancel = Callable[[], None]
"""Ends waiting for ranges that were to be fetched ahead."""


@runtime_checkable
class RemoteSource(Source, Protocol):
    """A source of which a read takes long: it fetches ahead, and fetches anew what came damaged."""

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Fetch ranges, in this order, as long as the block lasts.

        Parameters
        ----------
        ranges : sequence of (int, int)
            Offset and length, as they will be read.
        any_order : bool
            Whether nothing is done before most of them are there, so that they may be fetched in
            whatever order takes the fewest requests.

        Returns
        -------
        context manager of callable
            Calling it, from any thread, ends all reads of the ranges with `Cancelled`.
        """

    def reread(self, offset: int, length: int) -> bytes:
        """Return bytes that came damaged, fetched around caches; otherwise as `read`."""


def prefetching(
    source: Source, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
) -> AbstractContextManager[Cancel]:
    """Have a source fetch ranges ahead as long as the block lasts, where that helps.

    Parameters
    ----------
    source : Source
    ranges : sequence of (int, int)
        Offset and length, in the order in which they are wanted.
    any_order : bool
        As in `RemoteSource.prefetch`.
    """
    if isinstance(source, RemoteSource):
        return source.prefetch(ranges, any_order=any_order)
    return nullcontext(lambda: None)


def has_arrived(source: Source, offset: int, length: int) -> bool:
    """Whether bytes that were to be fetched ahead are here, so that reading them does not wait."""
    arrived = getattr(source, "arrived", None)
    return arrived is None or bool(arrived(offset, length))


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
        require_within(self, offset, length)
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
                "the file became shorter while it was read",
                offset=offset,
                needed=offset + length,
            )
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class StreamSource:
    """A source over an open binary file object that can seek; it is not closed here.

    Parameters
    ----------
    stream : BinaryIO
        Open for reading: a file, ``io.BytesIO``, or what a storage library opens.

    Raises
    ------
    StorageError
        ``not-seekable``: it cannot seek, as a pipe cannot.
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
        """Bytes the stream had when the source was made."""
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
                    # Streams may give less than they are asked for.
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
                "the stream became shorter while it was read",
                offset=offset,
                needed=offset + length,
            )
        return b"".join(parts)

    def close(self) -> None:
        """Do nothing: who opened the stream closes it."""


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
        require_within(self, offset, length)
        return self._source.read(offset, length)

    @property
    def opening_bytes(self) -> int:
        """How many bytes are asked for first."""
        return opening_bytes(self._source, self._size)

    def holds(self, offset: int, length: int) -> bool:
        """Whether bytes within the size are there."""
        return is_there(self._source, offset, length)

    @property
    def stored_bytes(self) -> int:
        """Bytes that the source is kept in."""
        return min(self._size, stored_bytes(self._source))

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Have the source behind fetch ranges ahead; see `RemoteSource.prefetch`."""
        kept = [x for x in ranges if x[0] + x[1] <= self._size]
        return prefetching(self._source, kept, any_order=any_order)

    def reread(self, offset: int, length: int) -> bytes:
        """Have the source behind fetch bytes anew, where it can; see `RemoteSource.reread`."""
        require_within(self, offset, length)
        source = self._source
        again = source.reread if isinstance(source, RemoteSource) else source.read
        return again(offset, length)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether bytes are here; see `has_arrived`."""
        return has_arrived(self._source, offset, length)

    @property
    def traffic(self) -> object:
        """What reading from the source behind has cost; None where nothing counts it."""
        return getattr(self._source, "traffic", None)

    def close(self) -> None:
        """Close the source behind this one."""
        self._source.close()


def opening_bytes(source: Source, most: int) -> int:
    """Return how many bytes to ask of a source first: `most`, where it does not say otherwise."""
    return min(source.size, int(getattr(source, "opening_bytes", most)))


def is_there(source: Source, offset: int, length: int) -> bool:
    """Whether a source has all of a range of bytes."""
    if offset + length > source.size:
        return False
    holds = getattr(source, "holds", None)
    return holds is None or bool(holds(offset, length))


def stored_bytes(source: Source) -> int:
    """Return the bytes that a source is kept in; its size, where it does not say otherwise."""
    return int(getattr(source, "stored_bytes", source.size))


def require_within(source: Source, offset: int, length: int) -> None:
    """Refuse a range that a source does not have.

    Raises
    ------
    ValueError
        The offset or the length is negative.
    TruncatedError
        ``file-truncated``: the source ends before the range does.
    """
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


Readable = str | os.PathLike[str] | bytes | bytearray | memoryview | BinaryIO | Source
"""What a COGS file can be read from."""


def source_of(given: Readable) -> Source:
    """Return what reads ranges of a path, of bytes, of a file object, or of a source as it is.

    Raises
    ------
    StorageError
        As `FileSource` and `StreamSource`.
    TypeError
        It is none of these.
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
