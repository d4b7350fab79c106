"""Fetches wanted ranges of one file: requests under way, asking again, and whether it changed."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterable
from contextlib import AbstractAsyncContextManager
from typing import Final

from cogsplat.codec.errors import StorageError

from .answers import Answer, Stated, Transport
from .faults import Backoff, PassingFault
from .options import KIB, NetworkOptions
from .range_queue import Piece, RangeQueue, Request
from .traffic import Traffic
from .whole_body import WholeBody

BEGINNING_BYTES: Final = 64 * KIB
"""The first request (SPEC 8.8); these bytes are kept."""

# The first requests are small, so that the first chunks come soon; each that ends doubles them.
_FIRST_PACE: Final = 256 * KIB

# A server that states another ETag so often while its bytes stay the same makes them up.
_MOST_ETAGS: Final = 4

# A piece that is wanted after so many bytes is waited for; joined with its neighbours it costs no
# request of its own.
_SOON: Final = 1 << 20

# A server without ranges is read so far ahead of what is wanted.
_WHOLE_AHEAD: Final = 4 << 20


class RangeReader:
    """Fetches what is wanted in an event loop of its own; others wait for it with `moved`.

    Parameters
    ----------
    transport : Transport
    name : str
        Names the file in messages.
    options : NetworkOptions
    fresh : bool
        Go around caches with every request.
    beginning_bytes : int
        What the first request asks for.

    Attributes
    ----------
    moved : threading.Condition
        Guards everything here; notified when bytes came, or will not come.
    beginning : Piece
        The first bytes of the file, which stay.
    size : int or None
        Bytes of the file, once they are known.
    whole : WholeBody or None
        What came so far, where the server knows no ranges.
    error : BaseException or None
        Why nothing comes any more.
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        options: NetworkOptions,
        *,
        fresh: bool,
        beginning_bytes: int = BEGINNING_BYTES,
    ) -> None:
        self.moved = threading.Condition()
        self.beginning = Piece(0, beginning_bytes)
        self.size: int | None = None
        self.whole: WholeBody | None = None
        self.error: BaseException | None = None
        self._transport = transport
        self._name = name
        self._options = options
        self._fresh = fresh
        self._queue = RangeQueue(options.gap_bytes, options.request_bytes)
        self._queue.add([self.beginning], urgent=True)
        self._pace = _FIRST_PACE
        self._held = 0
        self._awaited: set[Piece] = set()
        self._under_way: dict[Request, asyncio.Task[None]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._changed = asyncio.Event()
        self._stopping = False
        self._etags: set[str] = set()
        self.etag: str | None = None
        self._requests = self._failures = self._received = 0
        self._busy_seconds = self._busy_since = 0.0

    # What other threads call, holding `moved`.

    def want(self, pieces: Iterable[Piece], *, urgent: bool = False) -> None:
        """Fetch pieces after those that are wanted already; urgent ones before them."""
        self._queue.add(pieces, urgent=urgent)
        self.wake()

    def hurry(self, piece: Piece) -> None:
        """Fetch a piece that somebody waits for: at once, unless its turn comes soon."""
        if piece.is_started:
            return
        if self._queue.bytes_before(piece, _SOON) >= _SOON:
            self._queue.add([piece], urgent=True)
        self._awaited.add(piece)
        self.wake()

    def release(self, piece: Piece) -> None:
        """Give back the room of a piece that was read, or that nobody wants any more."""
        if piece.is_dropped:
            return
        piece.is_dropped = True
        if piece.is_started:
            self._held -= piece.length
        self.wake()

    def wake(self) -> None:
        """Have the loop look at what is wanted."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._changed.set)

    def stop(self) -> None:
        """End all requests; `run` returns."""
        self._stopping = True
        self.wake()

    def traffic(self) -> Traffic:
        """Return what was asked for and what came."""
        busy = self._busy_seconds
        if self._under_way:
            busy += time.monotonic() - self._busy_since
        return Traffic(self._requests, self._received, self._failures, busy)

    # What runs in the loop.

    async def run(self) -> None:
        """Fetch what is wanted until `stop`."""
        self._loop = asyncio.get_running_loop()
        try:
            while not self._stopping:
                self._changed.clear()
                with self.moved:
                    self._begin_requests()
                    self._cancel_dropped()
                await self._changed.wait()
        except BaseException as error:
            # A fault of this class: whoever waits must not wait for ever.
            self._fail(error)
            raise
        finally:
            tasks = list(self._under_way.values())
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._transport.close()
            self._fail(ValueError(f"{self._name}: is closed, expected it open"))

    def _begin_requests(self) -> None:
        if self.whole is not None:
            for piece in self._queue.clear():
                self.whole.wanted = max(self.whole.wanted, piece.end)
            return
        self._awaited = {
            piece for piece in self._awaited if not (piece.is_started or piece.is_dropped)
        }
        while self._may_begin():
            request = self._queue.next_request(self._pace)
            if request is None:
                return
            self._held += sum(piece.length for piece in request.pieces)
            if not self._under_way:
                self._busy_since = time.monotonic()
            task = asyncio.create_task(self._fetch(request))
            self._under_way[request] = task

    def _may_begin(self) -> bool:
        if len(self._under_way) >= self._options.in_flight:
            return False
        if self._queue.is_urgent:
            return True
        coming = sum(request.missing for request in self._under_way)
        # Whoever waits for a piece would wait for ever if those before it filled the window.
        has_room = self._held < self._options.window_bytes or bool(self._awaited)
        return coming <= self._pace and has_room

    def _cancel_dropped(self) -> None:
        for request, task in self._under_way.items():
            # One that has all its bytes ends by itself, and leaves its connection to the next.
            if request.is_dropped and request.missing:
                task.cancel()

    async def _fetch(self, request: Request) -> None:
        backoff = Backoff(self._options)
        try:
            while request.missing:
                try:
                    await self._fetch_rest(request, backoff)
                except PassingFault as fault:
                    self._failures += 1
                    await asyncio.sleep(backoff.pause_after(fault))
            with self.moved:
                self._pace = min(2 * self._pace, self._options.request_bytes)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            # Whoever waits is told, of faults of this class as well.
            with self.moved:
                if self.whole is not None:
                    self.whole.error = error
                for piece in request.pieces:
                    piece.error = error
                self.moved.notify_all()
        finally:
            with self.moved:
                self._under_way.pop(request, None)
                if not self._under_way:
                    self._busy_seconds += time.monotonic() - self._busy_since
                self._changed.set()

    async def _fetch_rest(self, request: Request, backoff: Backoff) -> None:
        """Ask for what a request lacks and give out what comes.

        Raises
        ------
        PassingFault
            The answer ended early, or did not come.
        StorageError
            The request failed for good.
        """
        fresh = self._fresh or request.is_fresh
        async with self._ask(request.position, request.end, fresh=fresh) as answer:
            await self._compare(answer.stated)
            if answer.stated.is_whole:
                await self._take_whole(answer, request)
                return
            with self.moved:
                self._learn_size(answer.stated)
                if self.size is not None and request.end > self.size:
                    request.end = self.size
            if answer.stated.first == answer.stated.end:
                return
            async for part in answer.parts:
                self._received += len(part)
                used = part[: request.missing]
                with self.moved:
                    request.take(used)
                    self.moved.notify_all()
                    # The next request begins while this one still runs.
                    self._changed.set()
                if used:
                    backoff.progressed()
                if len(used) < len(part):
                    # More than the answer states: the rest is of nothing that was asked for.
                    return
        if request.missing and request.position < answer.stated.end:
            raise PassingFault(
                "connection-broken",
                f"{self._name}: the answer ended at byte {request.position}, expected "
                f"{request.end}",
            )

    def _ask(self, first: int, end: int, *, fresh: bool) -> AbstractAsyncContextManager[Answer]:
        self._requests += 1
        return self._transport.get(first, end, fresh=fresh)

    def _learn_size(self, stated: Stated) -> None:
        if self.size is not None:
            return
        if stated.total is None:
            raise StorageError(
                "answer-range",
                f"{self._name}: the server does not state the length of the file, expected it in "
                "Content-Range",
            )
        self.size = stated.total
        self.beginning.end = min(self.beginning.end, self.size)
        self.moved.notify_all()

    async def _compare(self, stated: Stated) -> None:
        """Refuse an answer of another file than that of the first answer."""
        if self.size is not None and stated.total not in (None, self.size):
            raise StorageError(
                "source-changed",
                f"{self._name}: has {stated.total} bytes now, had {self.size}: it changed while "
                "it was read",
            )
        etag = stated.etag
        if etag is None or etag in self._etags or len(self._etags) >= _MOST_ETAGS:
            return
        # Servers of one name may state different ETags of the same bytes.
        if self._etags and not await self._begins_alike():
            raise StorageError(
                "source-changed",
                f"{self._name}: has the ETag {etag} now and begins with other bytes: it changed "
                "while it was read",
            )
        self._etags.add(etag)
        self.etag = self.etag or etag

    async def _begins_alike(self) -> bool:
        """Whether the file still begins with the bytes that were kept, which hold its root."""
        kept = self.beginning
        if not kept.is_whole or self.whole is not None:
            return False
        again = Piece(0, kept.end)
        async with self._ask(0, kept.end, fresh=True) as answer:
            async for part in answer.parts:
                self._received += len(part)
                again.take(again.received, part)
                if again.is_whole:
                    break
        return again.bytes_at(0, kept.end) == kept.bytes_at(0, kept.end)

    async def _take_whole(self, answer: Answer, request: Request) -> None:
        """Take the whole file, from the first byte on, as fast as it is wanted."""
        with self.moved:
            body = self._become_whole(answer.stated, request)
        at = 0
        async for part in answer.parts:
            self._received += len(part)
            with self.moved:
                body.take(at, part)
                at += len(part)
                request.position = min(body.received, request.end)
                self.moved.notify_all()
            while self.size is not None and body.received > body.wanted + _WHOLE_AHEAD:
                self._changed.clear()
                await self._changed.wait()
                with self.moved:
                    self._begin_requests()
        with self.moved:
            if answer.stated.total is not None and body.received < answer.stated.total:
                raise PassingFault(
                    "connection-broken",
                    f"{self._name}: the answer ended at byte {body.received}, expected "
                    f"{answer.stated.total}",
                )
            self.size = body.received
            request.end = request.position = body.received
            body.is_complete = True
            self.moved.notify_all()

    def _become_whole(self, stated: Stated, request: Request) -> WholeBody:
        """Go over to reading the file from its beginning; what is under way otherwise ends."""
        if self.whole is None:
            self.whole = WholeBody()
            for other, task in self._under_way.items():
                if other is not request:
                    task.cancel()
                    for piece in other.pieces:
                        self.whole.wanted = max(self.whole.wanted, piece.end)
            self._begin_requests()
        self.whole.wanted = max(self.whole.wanted, request.end)
        if stated.total is not None:
            self.size = stated.total
            # There is more to come than was asked for.
            request.end = stated.total
        self.moved.notify_all()
        return self.whole

    def _fail(self, error: BaseException) -> None:
        with self.moved:
            self.error = self.error or error
            if self.whole is not None and self._stopping:
                self.whole.close()
            self.moved.notify_all()
