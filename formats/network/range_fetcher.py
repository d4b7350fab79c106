"""Fetches byte ranges of one file: concurrent requests, retries, and detection of changes."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractAsyncContextManager
from typing import Final

from cogsplat.codec.errors import StorageError

from .backoff import Backoff, TransientError
from .network_options import KIB, NetworkOptions
from .range_queue import PendingRange, RangeQueue, Request
from .range_responses import RangeResponse, ResponseHead, Transport
from .traffic import Traffic
from .whole_body import WholeBody

BEGINNING_BYTES: Final = 64 * KIB
"""Size of the first request (SPEC 8.8), whose bytes are kept."""

HEAD_BYTES: Final = 64
"""First bytes of a file, by which it is judged where the server does not state its length."""

# Requests start small, so that the first chunks arrive soon; each finished one doubles the limit.
_INITIAL_REQUEST_BYTES: Final = 256 * KIB

# After this many different ETags with unchanged bytes, the server's ETags are ignored.
_MAX_ETAGS: Final = 4

# A range queued behind fewer bytes than this keeps its place: joined with its neighbours it costs
# no request of its own.
_SOON_BYTES: Final = 1 << 20

# Read-ahead of a download from a server without range requests, bytes.
_WHOLE_AHEAD_BYTES: Final = 4 << 20


LengthOf = Callable[[bytes], int | None]
"""Function that gives the length of a file from its first 64 bytes, or its first 64 KiB."""


class RangeFetcher:
    """Fetcher of byte ranges in an event loop, for readers in further threads.

    Parameters
    ----------
    transport : Transport
        Transport of the file.
    name : str
        Name of the file in messages.
    options : NetworkOptions
        Timeouts, retries and request sizes.
    bypass_caches : bool
        Whether every request bypasses HTTP caches.
    beginning_bytes : int
        Size of the first request, bytes.
    length_of : callable, optional
        Function that returns the length which a file's header states. It gets the first 64 bytes
        and may return None; then it gets the first 64 KiB. It raises an error for a file of another
        format. Called where the server sends the whole file without stating its length.

    Attributes
    ----------
    arrival : threading.Condition
        Lock of all state; notified when bytes arrive and when a request fails.
    beginning : PendingRange
        First bytes of the file, kept until the end.
    size : int or None
        Length of the file, bytes; None until the first response.
    whole : WholeBody or None
        Download of the whole file, where the server has no range requests.
    error : BaseException or None
        Error that ended the event loop.
    etag : str or None
        First strong ETag of the server.
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        options: NetworkOptions,
        *,
        bypass_caches: bool,
        beginning_bytes: int = BEGINNING_BYTES,
        length_of: LengthOf | None = None,
    ) -> None:
        self.arrival = threading.Condition()
        self.beginning = PendingRange(0, beginning_bytes)
        self.size: int | None = None
        self.whole: WholeBody | None = None
        self.error: BaseException | None = None
        self._transport = transport
        self._name = name
        self._options = options
        self._bypass_caches = bypass_caches
        self._length_of = length_of
        self._judged_bytes = 0
        self._queue = RangeQueue(options.gap_bytes, options.request_bytes)
        self._queue.add([self.beginning], urgent=True)
        self._request_limit = _INITIAL_REQUEST_BYTES
        self._buffered_bytes = 0
        self._awaited: set[PendingRange] = set()
        self._in_flight: dict[Request, asyncio.Task[None]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._has_work = asyncio.Event()
        self._stopping = False
        self._etags: set[str] = set()
        self.etag: str | None = None
        self._requests = self._failures = self._received = 0
        self._busy_seconds = self._busy_since = 0.0

    # Called by other threads, which hold `arrival`.

    def fetch(self, ranges: Iterable[PendingRange], *, urgent: bool = False) -> None:
        """Queue ranges; urgent ones before all prefetched ones."""
        self._queue.add(ranges, urgent=urgent)
        self.wake()

    def prioritise(self, pending: PendingRange) -> None:
        """Move a queued range that a reader waits for to the urgent queue, unless it is next."""
        if pending.is_started:
            return
        if self._queue.bytes_before(pending, _SOON_BYTES) >= _SOON_BYTES:
            self._queue.add([pending], urgent=True)
        self._awaited.add(pending)
        self.wake()

    def release(self, pending: PendingRange) -> None:
        """Drop a range that was read or is no longer needed.

        A request is cancelled once all its ranges are dropped.
        """
        if pending.is_dropped:
            return
        pending.is_dropped = True
        if pending.is_started:
            self._buffered_bytes -= pending.length
        self.wake()

    def wake(self) -> None:
        """Make the event loop check the queue."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._has_work.set)

    def stop(self) -> None:
        """Cancel all requests and make `run` return."""
        self._stopping = True
        self.wake()

    def traffic(self) -> Traffic:
        """Return the counts of requests and bytes so far."""
        busy = self._busy_seconds
        if self._in_flight:
            busy += time.monotonic() - self._busy_since
        return Traffic(self._requests, self._received, self._failures, busy)

    def fail(self, error: BaseException) -> None:
        """Store the error that ended the event loop, for all waiting and later readers."""
        with self.arrival:
            self.error = self.error or error
            if self.whole is not None and self._stopping:
                self.whole.close()
            self.arrival.notify_all()

    # Called in the event loop.

    async def run(self) -> None:
        """Fetch queued ranges until `stop`."""
        self._loop = asyncio.get_running_loop()
        try:
            while not self._stopping:
                self._has_work.clear()
                with self.arrival:
                    self._begin_requests()
                    self._cancel_dropped()
                await self._has_work.wait()
        except BaseException as error:
            # A bug in this class: without this, waiting readers would wait for ever.
            self.fail(error)
            raise
        finally:
            tasks = list(self._in_flight.values())
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.fail(ValueError(f"{self._name}: is closed, expected it open"))
            await self._transport.close()

    def _begin_requests(self) -> None:
        """Start requests for queued ranges, up to the limits of concurrency and memory."""
        if self.whole is not None:
            for pending in self._queue.clear():
                self.whole.wanted = max(self.whole.wanted, pending.end)
            return
        self._awaited = {
            pending for pending in self._awaited if not (pending.is_started or pending.is_dropped)
        }
        while self._may_begin():
            request = self._queue.next_request(self._request_limit)
            if request is None:
                return
            self._buffered_bytes += sum(pending.length for pending in request.ranges)
            if not self._in_flight:
                self._busy_since = time.monotonic()
            task = asyncio.create_task(self._run_request(request))
            self._in_flight[request] = task

    def _may_begin(self) -> bool:
        """Whether another request may start now."""
        if len(self._in_flight) >= self._options.in_flight:
            return False
        if self._queue.has_urgent:
            return True
        missing = sum(request.missing for request in self._in_flight)
        # A reader would wait for ever if the ranges before its own filled the window.
        has_room = self._buffered_bytes < self._options.window_bytes or bool(self._awaited)
        return missing <= self._request_limit and has_room

    def _cancel_dropped(self) -> None:
        """Cancel requests of which no range is needed any more."""
        if self.whole is not None:
            # Later ranges come from the download that a range of the past began.
            return
        for request, task in self._in_flight.items():
            # A request without missing bytes ends by itself, and keeps its connection usable.
            if request.is_dropped and request.missing:
                task.cancel()

    async def _run_request(self, request: Request) -> None:
        """Run a request to its end, with retries; store a lasting error in its ranges."""
        backoff = Backoff(self._options)
        try:
            while request.missing:
                try:
                    await self._fetch_rest(request, backoff)
                except TransientError as error:
                    self._failures += 1
                    if request.missing:
                        await asyncio.sleep(backoff.pause_after(error))
            with self.arrival:
                self._request_limit = min(2 * self._request_limit, self._options.request_bytes)
        except Exception as error:
            # Errors of every type, bugs of this class too: readers that wait for the ranges raise
            # the error in their own threads. Without it, they would wait for ever.
            with self.arrival:
                if self.whole is not None:
                    self.whole.error = error
                for pending in request.ranges:
                    pending.error = error
                self.arrival.notify_all()
        finally:
            with self.arrival:
                self._in_flight.pop(request, None)
                if not self._in_flight:
                    self._busy_seconds += time.monotonic() - self._busy_since
                self._has_work.set()

    async def _fetch_rest(self, request: Request, backoff: Backoff) -> None:
        """Request the missing bytes of a request and distribute the response over its ranges.

        Raises
        ------
        TransientError
            The response failed or ended early, or brought no progress.
        StorageError
            The request failed for good.
        """
        bypass_caches = self._bypass_caches or request.bypasses_caches
        has_progressed = False
        async with self._get(
            request.position, request.end, bypass_caches=bypass_caches
        ) as response:
            head = response.head
            await self._require_unchanged(head)
            if head.is_whole or self.whole is not None:
                await self._receive_whole(response, request, backoff)
                return
            with self.arrival:
                self._set_size(head)
                if self.size is not None and request.end > self.size:
                    request.end = self.size
            if head.first == head.end:
                return
            async for part in response.parts:
                self._received += len(part)
                used = part[: request.missing]
                with self.arrival:
                    request.receive(used)
                    self.arrival.notify_all()
                    # The next request begins while this one still runs.
                    self._has_work.set()
                has_progressed |= backoff.add_bytes(len(used))
                if len(used) < len(part):
                    # The body is longer than the requested range: the rest is ignored.
                    return
        # Responses that are right but short would otherwise take a request for every byte.
        if request.missing and (request.position < head.end or not has_progressed):
            raise TransientError(
                "connection-broken",
                f"{self._name}: the response ended at byte {request.position}, expected "
                f"{request.end}",
            )

    def _get(
        self, first: int, end: int, *, bypass_caches: bool
    ) -> AbstractAsyncContextManager[RangeResponse]:
        """Count and send one range request."""
        self._requests += 1
        return self._transport.get(first, end, bypass_caches=bypass_caches)

    def _set_size(self, head: ResponseHead) -> None:
        """Set the length of the file from the first response."""
        if self.size is not None:
            return
        if head.total is None:
            raise StorageError(
                "answer-range",
                f"{self._name}: Content-Range without the length of the file, expected it; the "
                "server cannot serve this file by ranges",
            )
        self.size = head.total
        self.beginning.end = min(self.beginning.end, self.size)
        self.arrival.notify_all()

    async def _require_unchanged(self, head: ResponseHead) -> None:
        """Raise ``source-changed`` if a response shows that the file changed.

        A changed file has another length, or another ETag and other first bytes.
        """
        if self.size is not None and head.total not in (None, self.size):
            raise StorageError(
                "source-changed",
                f"{self._name}: {head.total} bytes, expected {self.size} as before; it changed "
                "while it was read: open it again",
            )
        etag = head.etag
        if etag is None or etag in self._etags or len(self._etags) >= _MAX_ETAGS:
            return
        # Servers of one name may state different ETags of the same bytes.
        if self._etags and not await self._has_same_beginning():
            raise StorageError(
                "source-changed",
                f"{self._name}: another ETag, {etag}, and other first bytes, expected the same "
                "file; it changed while it was read: open it again",
            )
        self._etags.add(etag)
        self.etag = self.etag or etag

    async def _has_same_beginning(self) -> bool:
        """Whether the file still begins with the bytes of the first request, root included."""
        kept = self.beginning
        if not kept.is_complete or self.whole is not None:
            return False
        again = PendingRange(0, kept.end)
        async with self._get(0, kept.end, bypass_caches=True) as response:
            async for part in response.parts:
                self._received += len(part)
                again.receive(again.received, part)
                if again.is_complete:
                    break
        return again.bytes_at(0, kept.end) == kept.bytes_at(0, kept.end)

    async def _receive_whole(
        self, response: RangeResponse, request: Request, backoff: Backoff
    ) -> None:
        """Receive a body of the whole file, or its rest, at most 4 MiB ahead of the readers."""
        head = response.head
        has_progressed = False
        with self.arrival:
            body = self._switch_to_whole(head, request)
        # A server that sent the whole file may answer a retry by a range.
        at = head.first
        async for part in response.parts:
            self._received += len(part)
            with self.arrival:
                new_bytes = body.receive(at, part, self.size)
                # A body that starts over is received again: it is no progress, however far it gets.
                has_progressed |= not head.is_whole and backoff.add_bytes(new_bytes)
                at += len(part)
                self._set_size_of_body(body, request)
                request.position = min(body.received, request.end)
                self.arrival.notify_all()
            if self.size is not None and body.received >= self.size:
                break
            while self.size is not None and body.received > body.wanted + _WHOLE_AHEAD_BYTES:
                self._has_work.clear()
                await self._has_work.wait()
                with self.arrival:
                    self._begin_requests()
        with self.arrival:
            if self.size is not None and body.received < self.size:
                if has_progressed and body.received == head.end:
                    return
                raise TransientError(
                    "connection-broken",
                    f"{self._name}: the response ended at byte {body.received}, expected "
                    f"{self.size}",
                )
            self.size = body.received
            request.end = request.position = body.received
            body.is_complete = True
            self.arrival.notify_all()

    def _set_size_of_body(self, body: WholeBody, request: Request) -> None:
        """Set the length of the file to the length that its header states, if the server sent none.

        Raises
        ------
        StorageError
            ``answer-length``: the body exceeds `NetworkOptions.unstated_bytes`.
        """
        for count in (HEAD_BYTES, BEGINNING_BYTES):
            if self.size is None and self._judged_bytes < count <= body.received:
                # Refuses a file of another format; a body without end is received no further.
                self._judged_bytes = count
                if self._length_of is not None:
                    self.size = self._length_of(body.bytes_at(0, count))
                    request.end = self.size or request.end
        limit = self._options.unstated_bytes
        if self.size is None and body.received > limit:
            raise StorageError(
                "answer-length",
                f"{self._name}: more than {limit} bytes in a response without a length, expected "
                "Content-Length; NetworkOptions.unstated_bytes raises the limit",
            )

    def _switch_to_whole(self, head: ResponseHead, request: Request) -> WholeBody:
        """Cancel all requests but one, which downloads the whole file."""
        if self.whole is None:
            self.whole = WholeBody()
            self.whole.wanted = request.end
            for other, task in self._in_flight.items():
                if other is not request:
                    task.cancel()
                    for pending in other.ranges:
                        self.whole.wanted = max(self.whole.wanted, pending.end)
            self._begin_requests()
        if head.total is not None:
            self.size = head.total
        # The body is longer than the requested range.
        request.end = self._options.unstated_bytes + 1 if self.size is None else self.size
        self.arrival.notify_all()
        return self.whole
