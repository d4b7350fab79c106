"""A byte source over a network: ranges on demand and ahead of it."""

from __future__ import annotations

import asyncio
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import Context
from pathlib import Path
from typing import Any, Final

from cogsplat.codec.errors import Cancelled, CogsplatWarning
from cogsplat.formats.storage.source import Cancel, require_within

from .answers import Transport
from .options import KIB, NetworkOptions
from .range_queue import Piece
from .range_reader import BEGINNING_BYTES, RangeReader
from .segment_cache import SegmentCache
from .traffic import Traffic

# Of a file that is fetched whole; small, so that what is read first does not wait for much.
_PART_BYTES: Final = 256 * KIB


class _EventLoop(asyncio.SelectorEventLoop):
    """Event loop that drops calls from other threads once it is closed.

    obstore's threads report the end of a cancelled request too, and may do so after the loop closed.
    asyncio's own loop raises then, and obstore prints the traceback.
    """

    def call_soon_threadsafe(
        self, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.Handle:
        """Schedule a call from another thread; on a closed loop, return a cancelled handle."""
        try:
            return super().call_soon_threadsafe(callback, *args, context=context)
        except RuntimeError:
            if not self.is_closed():
                raise
            dropped = asyncio.Handle(callback, args, self, context)
            dropped.cancel()
            return dropped


class RangeSource:
    """A file on a network as a `Source`; safe to read from several threads.

    Requests are made by a thread of its own, which `close` ends. Opening asks for the first 64 KiB
    and returns when the length of the file is known.

    Parameters
    ----------
    transport : Transport
        Of the file; closed with the source.
    name : str
        Names the file in messages.
    options : NetworkOptions
    fresh : bool
        Go around caches, because what they gave was damaged.
    beginning_bytes : int
        What the first request asks for.

    Raises
    ------
    StorageError
        ``host-unreachable``, ``network-timeout``, ``connection-broken``, ``http-status``,
        ``not-found``, ``permission``, ``answer-range``, ``answer-encoding``, ``redirect-loop``,
        ``redirect-refused``.

    Examples
    --------
    >>> from cogsplat.formats.network.open_url import open_url
    >>> with open_url("https://example.org/scene.cogs") as source:
    ...     data = source.read(0, 8)
    >>> data[1:5]
    b'COGS'
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        options: NetworkOptions | None = None,
        *,
        fresh: bool = False,
        beginning_bytes: int = BEGINNING_BYTES,
    ) -> None:
        self.name = name
        self._reader = RangeReader(
            transport,
            name,
            options or NetworkOptions(),
            fresh=fresh,
            beginning_bytes=beginning_bytes,
        )
        self._moved = self._reader.moved
        self._pieces: dict[tuple[int, int], Piece] = {}
        # What lies behind the beginning, in parts, where all of the file was asked for.
        self._rest: list[Piece] = []
        self._told = False
        options = options or NetworkOptions()
        self._window_bytes = options.window_bytes
        self.cache: SegmentCache | None = None
        if options.cache is not None:
            self.cache = SegmentCache(Path(options.cache), options.cache_bytes)
        self._thread = threading.Thread(
            target=self._run, name=f"cogsplat fetches {name}", daemon=True
        )
        self._thread.start()
        try:
            self._size = self._wait_for_size()
        except BaseException:
            self.close()
            raise
        self._tell_of_no_ranges()

    def __enter__(self) -> RangeSource:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes that the server stated at first."""
        return self._size

    @property
    def etag(self) -> str | None:
        """The strong ETag that the server stated at first; None where it states none."""
        with self._moved:
            return self._reader.etag

    @property
    def traffic(self) -> Traffic:
        """What was asked for and what came, up to now."""
        with self._moved:
            return self._reader.traffic()

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`.

        Raises
        ------
        TruncatedError
            ``file-truncated``: the file ends before.
        StorageError
            As the constructor, and ``source-changed``: it is another file now.
        """
        return self._read(offset, length, again=False)

    def fetch_all(self) -> None:
        """Ask for all of the file at once, before it is known what is where in it.

        Requests begin as soon as the length of the file is known, while its first bytes come. All
        bytes are kept until `close`; a file that is longer than the window of `NetworkOptions` is
        fetched as it is read, as if this had not been called.
        """
        first = self._reader.beginning.end
        with self._moved:
            if self._rest or self._size > self._window_bytes:
                return
            ends = [*range(first + _PART_BYTES, self._size, _PART_BYTES), self._size]
            starts = [first, *ends[:-1]]
            self._rest = [
                Piece(start, end) for start, end in zip(starts, ends, strict=True) if start < end
            ]
            self._reader.want(self._rest)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether bytes that are fetched ahead are here."""
        end = offset + length
        reader = self._reader
        with self._moved:
            if reader.whole is not None:
                return reader.whole.received >= end
            if self._rest:
                parts = self._parts_with(offset, end)
                return all(min(end, part.end) <= part.position for part in parts)
            piece = self._pieces.get((offset, end), reader.beginning)
            return piece.first <= offset and end <= piece.position

    def reread(self, offset: int, length: int) -> bytes:
        """Return bytes that came damaged, asked for once more; see `read`."""
        return self._read(offset, length, again=True)

    def _read(self, offset: int, length: int, *, again: bool) -> bytes:
        require_within(self, offset, length)
        end = offset + length
        if not length:
            return b""
        reader = self._reader
        with self._moved:
            beginning = reader.beginning
            usable = not again and reader.whole is None and beginning.error is None
            if usable and end <= beginning.end:
                data = self._wait_for(beginning, offset, end)
            elif usable and self._rest:
                data = b"".join(
                    self._wait_for(part, max(offset, part.first), min(end, part.end))
                    for part in self._parts_with(offset, end)
                )
            else:
                piece = None if again else self._pieces.pop((offset, end), None)
                if piece is not None:
                    reader.hurry(piece)
                else:
                    piece = Piece(offset, end, is_fresh=again)
                    reader.want([piece], urgent=True)
                try:
                    data = self._wait_for(piece, offset, end)
                finally:
                    reader.release(piece)
        self._tell_of_no_ranges()
        return data

    @contextmanager
    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> Iterator[Cancel]:
        """Fetch ranges ahead of reading them, in this order, as long as the block lasts.

        What is read of them is given as soon as it is there; of what is not, the requests end with
        the block.

        Parameters
        ----------
        ranges : sequence of (int, int)
            Offset and length, as they will be read.
        any_order : bool
            Without effect: of one file, the order of the file takes the fewest requests.

        Yields
        ------
        callable
            Calling it, from any thread, ends all reads of the ranges with `Cancelled`.
        """
        beginning = self._reader.beginning
        with self._moved:
            own: list[Piece] = []
            # All of the file is on its way where its rest is.
            for offset, length in () if self._rest else ranges:
                key = offset, offset + length
                kept = key[1] <= beginning.end
                if key not in self._pieces and not kept and key[1] <= self._size:
                    piece = self._pieces[key] = Piece(*key)
                    if offset < beginning.end and beginning.is_whole:
                        # The rest of what the first request cut is all that is asked for.
                        piece.take(0, beginning.bytes_at(0, beginning.end))
                    own.append(piece)
            self._reader.want(own)

        def cancel() -> None:
            with self._moved:
                for piece in (*own, *self._rest):
                    piece.error = piece.error or Cancelled()
                self._moved.notify_all()

        try:
            yield cancel
        finally:
            with self._moved:
                for piece in own:
                    key = piece.first, piece.end
                    if self._pieces.get(key) is piece:
                        del self._pieces[key]
                        self._reader.release(piece)

    def _parts_with(self, first: int, end: int) -> list[Piece]:
        """Return the beginning and the parts behind it that have bytes of a range."""
        every = (self._reader.beginning, *self._rest)
        return [part for part in every if part.first < end and part.end > first]

    def close(self) -> None:
        """End all requests and the thread; reading is over."""
        self._reader.stop()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=_EventLoop) as runner:
            runner.run(self._reader.run())

    def _wait_for_size(self) -> int:
        reader = self._reader
        with self._moved:
            while reader.size is None:
                error = reader.error or reader.beginning.error
                if error is not None:
                    raise error
                self._moved.wait()
            return reader.size

    def _wait_for(self, piece: Piece, first: int, end: int) -> bytes:
        """Return bytes of a piece, or of the whole file, as soon as they are there."""
        reader = self._reader
        while first < end:
            whole = reader.whole
            if whole is not None:
                whole.wanted = max(whole.wanted, end)
                if whole.received >= end:
                    return whole.bytes_at(first, end)
                reader.wake()
                error = reader.error or whole.error
            else:
                if piece.first + piece.received >= end:
                    return piece.bytes_at(first, end)
                error = piece.error or reader.error
            if error is not None:
                raise error
            self._moved.wait()
        return b""

    def _tell_of_no_ranges(self) -> None:
        # What the first request brings costs no more without ranges.
        large = self._size > BEGINNING_BYTES
        if self._reader.whole is not None and large and not self._told:
            self._told = True
            warnings.warn(
                f"{self.name}: the server sends the whole file whatever range it is asked for, as "
                "python -m http.server does; it is read from the beginning",
                CogsplatWarning,
                stacklevel=3,
            )
