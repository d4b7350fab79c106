"""Byte source of a file on a network, with prefetching."""

from __future__ import annotations

import asyncio
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import Context
from pathlib import Path
from typing import Final, TypeVarTuple, Unpack

from cogsplat.codec.errors import Cancelled, CogsplatWarning
from cogsplat.formats.storage.atomic import storage_error
from cogsplat.formats.storage.source import Cancel, require_within

from .network_options import KIB, NetworkOptions
from .range_fetcher import BEGINNING_BYTES, LengthOf, RangeFetcher
from .range_queue import PendingRange
from .range_responses import Transport
from .segment_cache import SegmentCache
from .traffic import Traffic

# Size of the ranges in which `fetch_all` requests a file; small, so that the first arrives soon.
_PART_BYTES: Final = 256 * KIB

_Arguments = TypeVarTuple("_Arguments")


class _EventLoop(asyncio.SelectorEventLoop):
    """Event loop that, once closed, ignores calls from further threads.

    obstore's threads report the end of a cancelled request as well, perhaps after the loop is
    closed. asyncio's own loop raises an error then, and obstore prints its traceback.
    """

    def call_soon_threadsafe(
        self,
        callback: Callable[[Unpack[_Arguments]], object],
        *args: *_Arguments,
        context: Context | None = None,
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
    """Source of a file on a network; safe to read from several threads.

    A thread makes the requests until `close`. The constructor requests the first 64 KiB and returns
    once the length of the file is known.

    Parameters
    ----------
    transport : Transport
        Transport of the file; closed with the source.
    name : str
        Name of the file in messages.
    options : NetworkOptions, optional
        Timeouts, retries, request sizes and the disk cache.
    bypass_caches : bool
        Whether to bypass HTTP caches, because a cached response was damaged.
    beginning_bytes : int
        Size of the first request, bytes.
    length_of : callable, optional
        Length of the file from its first 64 bytes; see `RangeFetcher`.

    Raises
    ------
    StorageError
        ``host-unreachable``, ``network-timeout``, ``connection-broken``, ``http-status``,
        ``not-found``, ``permission``, ``answer-range``, ``answer-encoding``, ``answer-length``,
        ``redirect-loop``, ``redirect-refused``, ``private-address``.

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
        bypass_caches: bool = False,
        beginning_bytes: int = BEGINNING_BYTES,
        length_of: LengthOf | None = None,
    ) -> None:
        self.name = name
        self._fetcher = RangeFetcher(
            transport,
            name,
            options or NetworkOptions(),
            bypass_caches=bypass_caches,
            beginning_bytes=beginning_bytes,
            length_of=length_of,
        )
        self._arrival = self._fetcher.arrival
        self._prefetched: dict[tuple[int, int], PendingRange] = {}
        # Ranges of `fetch_all`: the whole file behind its first bytes.
        self._rest: list[PendingRange] = []
        self._has_warned = False
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
        self._warn_without_ranges()

    def __enter__(self) -> RangeSource:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Length of the file according to the first response, bytes."""
        return self._size

    @property
    def etag(self) -> str | None:
        """First strong ETag of the server; None if it sends none."""
        with self._arrival:
            return self._fetcher.etag

    @property
    def traffic(self) -> Traffic:
        """Requests and received bytes so far."""
        with self._arrival:
            return self._fetcher.traffic()

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`.

        Raises
        ------
        TruncatedError
            ``file-truncated``: the file ends before the range does.
        StorageError
            The errors of the constructor; ``source-changed``: the file changed while it was read.
        """
        return self._read(offset, length, again=False)

    def fetch_all(self) -> None:
        """Request the whole file, before its index is read.

        All bytes are kept in memory until `close`. No effect on a file that is longer than
        `NetworkOptions.window_bytes`.
        """
        first = self._fetcher.beginning.end
        with self._arrival:
            if self._rest or self._size > self._window_bytes:
                return
            ends = [*range(first + _PART_BYTES, self._size, _PART_BYTES), self._size]
            starts = [first, *ends[:-1]]
            self._rest = [
                PendingRange(start, end)
                for start, end in zip(starts, ends, strict=True)
                if start < end
            ]
            self._fetcher.fetch(self._rest)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether a range was received: by the first request, a prefetch or `fetch_all`."""
        end = offset + length
        fetcher = self._fetcher
        with self._arrival:
            if fetcher.whole is not None:
                return fetcher.whole.received >= end
            if self._rest:
                parts = self._parts_with(offset, end)
                return all(min(end, part.end) <= part.position for part in parts)
            pending = self._prefetched.get((offset, end), fetcher.beginning)
            return pending.first <= offset and end <= pending.position

    def reread(self, offset: int, length: int) -> bytes:
        """Request damaged bytes again, bypassing HTTP caches; otherwise as `read`."""
        return self._read(offset, length, again=True)

    def _read(self, offset: int, length: int, *, again: bool) -> bytes:
        """Return a range from buffered, prefetched or newly requested bytes.

        With `again`, the bytes are requested anew, bypassing HTTP caches.
        """
        require_within(self, offset, length)
        end = offset + length
        if not length:
            return b""
        fetcher = self._fetcher
        with self._arrival:
            beginning = fetcher.beginning
            usable = not again and fetcher.whole is None and beginning.error is None
            if usable and end <= beginning.end:
                data = self._wait_for(beginning, offset, end)
            elif usable and self._rest:
                data = b"".join(
                    self._wait_for(part, max(offset, part.first), min(end, part.end))
                    for part in self._parts_with(offset, end)
                )
            else:
                pending = None if again else self._prefetched.pop((offset, end), None)
                if pending is not None:
                    fetcher.prioritise(pending)
                else:
                    pending = PendingRange(offset, end, bypasses_caches=again)
                    fetcher.fetch([pending], urgent=True)
                try:
                    data = self._wait_for(pending, offset, end)
                finally:
                    fetcher.release(pending)
        self._warn_without_ranges()
        return data

    @contextmanager
    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> Iterator[Cancel]:
        """Prefetch ranges, in the given order, while a ``with`` block runs.

        Each read of a range returns as soon as the range has arrived. The end of the block cancels
        the requests of ranges that were not read.

        Parameters
        ----------
        ranges : sequence of (int, int)
            Offset and length of each later read, bytes.
        any_order : bool
            No effect: within one file, the given order already takes the fewest requests.

        Yields
        ------
        callable
            Cancels the prefetch from any thread: reads of the ranges raise `Cancelled`.
        """
        beginning = self._fetcher.beginning
        with self._arrival:
            own: list[PendingRange] = []
            # After `fetch_all`, every range is already requested.
            for offset, length in () if self._rest else ranges:
                key = offset, offset + length
                kept = key[1] <= beginning.end
                if key not in self._prefetched and not kept and key[1] <= self._size:
                    pending = self._prefetched[key] = PendingRange(*key)
                    if offset < beginning.end and beginning.is_complete:
                        # The first request has the range's first bytes: request only the rest.
                        pending.receive(0, beginning.bytes_at(0, beginning.end))
                    own.append(pending)
            self._fetcher.fetch(own)

        def cancel() -> None:
            with self._arrival:
                for pending in (*own, *self._rest):
                    pending.error = pending.error or Cancelled()
                self._arrival.notify_all()

        try:
            yield cancel
        finally:
            with self._arrival:
                for pending in own:
                    key = pending.first, pending.end
                    if self._prefetched.get(key) is pending:
                        del self._prefetched[key]
                        self._fetcher.release(pending)

    def _parts_with(self, first: int, end: int) -> list[PendingRange]:
        """Return the ranges of the first request and of `fetch_all` that overlap a range."""
        every = (self._fetcher.beginning, *self._rest)
        return [part for part in every if part.first < end and part.end > first]

    def close(self) -> None:
        """Cancel all requests and end the thread; later reads fail."""
        self._fetcher.stop()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        """Run the event loop of the requests, in the thread of this source."""
        try:
            with asyncio.Runner(loop_factory=_EventLoop) as runner:
                runner.run(self._fetcher.run())
        except OSError as error:
            # Without descriptors for the loop, readers would wait for ever.
            self._fetcher.fail(storage_error(error, self.name))

    def _wait_for_size(self) -> int:
        """Wait for the first response and return the length of the file, bytes."""
        fetcher = self._fetcher
        with self._arrival:
            while fetcher.size is None:
                error = fetcher.error or fetcher.beginning.error
                if error is not None:
                    raise error
                self._arrival.wait()
            return fetcher.size

    def _wait_for(self, pending: PendingRange, first: int, end: int) -> bytes:
        """Return the bytes `first` to `end` of a pending range once all have arrived.

        If the server ignores ranges, the bytes come from the whole-file download instead.
        """
        fetcher = self._fetcher
        while first < end:
            whole = fetcher.whole
            if whole is not None:
                whole.wanted = max(whole.wanted, end)
                if whole.received >= end:
                    return whole.bytes_at(first, end)
                fetcher.wake()
                error = fetcher.error or whole.error
            else:
                if pending.position >= end:
                    return pending.bytes_at(first, end)
                error = pending.error or fetcher.error
            if error is not None:
                raise error
            self._arrival.wait()
        return b""

    def _warn_without_ranges(self) -> None:
        """Warn once that the server ignores ranges and the file is read from its beginning."""
        # A file within the first request costs no more without ranges.
        large = self._size > BEGINNING_BYTES
        if self._fetcher.whole is not None and large and not self._has_warned:
            self._has_warned = True
            warnings.warn(
                f"{self.name}: the server ignores range requests and sends the whole file, as "
                "python -m http.server does; the file is read from the beginning",
                CogsplatWarning,
                stacklevel=3,
            )
