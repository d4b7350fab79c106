"""Queue of byte ranges to fetch, which joins neighbouring ranges into requests (SPEC 8.8)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable


class PendingRange:
    """Byte range to fetch, and the bytes of it received so far.

    Parameters
    ----------
    first, end : int
        Range in the file: the first byte, and one past the last.
    bypasses_caches : bool
        Whether its request bypasses HTTP caches.

    Attributes
    ----------
    received : int
        Number of bytes received, from the first on.
    error : BaseException or None
        Error that ended its request.
    is_started : bool
        Whether a request for the range was made.
    is_dropped : bool
        Whether the range was read, or is no longer needed.
    """

    def __init__(self, first: int, end: int, *, bypasses_caches: bool = False) -> None:
        self.first, self.end = first, end
        self.bypasses_caches = bypasses_caches
        self.received = 0
        self.error: BaseException | None = None
        self.is_started = False
        self.is_dropped = False
        self._bytes = bytearray()

    @property
    def length(self) -> int:
        """Length of the range, bytes."""
        return self.end - self.first

    @property
    def is_complete(self) -> bool:
        """Whether all bytes were received."""
        return self.received == self.length

    @property
    def position(self) -> int:
        """File offset of the first byte that is still missing."""
        return self.first + self.received

    def receive(self, at: int, part: bytes) -> None:
        """Append a part of a response, cut to the range; parts arrive in file order.

        Parameters
        ----------
        at : int
            File offset of the part.
        part : bytes
            Received bytes.
        """
        start, stop = self.position, min(self.end, at + len(part))
        if at <= start < stop:
            self._bytes += part[start - at : stop - at]
            self.received = len(self._bytes)

    def bytes_at(self, first: int, end: int) -> bytes:
        """Return the received bytes from file offset `first` up to `end`."""
        return bytes(self._bytes[first - self.first : end - self.first])


class Request:
    """One range request for several pending ranges, gaps included.

    Parameters
    ----------
    ranges : list of PendingRange
        Ranges that the request covers, at least one.
    """

    def __init__(self, ranges: list[PendingRange]) -> None:
        self.ranges = sorted(ranges, key=lambda pending: pending.position)
        self.first = self.ranges[0].position
        self.end = max(pending.end for pending in ranges)
        self.position = self.first

    @property
    def missing(self) -> int:
        """Number of bytes still to receive."""
        return self.end - self.position

    @property
    def bypasses_caches(self) -> bool:
        """Whether the request bypasses HTTP caches."""
        return any(pending.bypasses_caches for pending in self.ranges)

    @property
    def is_dropped(self) -> bool:
        """Whether none of its ranges is needed any more."""
        return all(pending.is_dropped for pending in self.ranges)

    def receive(self, part: bytes) -> None:
        """Distribute the next bytes of the response over the ranges."""
        for pending in self.ranges:
            if pending.position >= self.position + len(part):
                break
            pending.receive(self.position, part)
        self.position += len(part)


class RangeQueue:
    """Ranges to request, in two first-in-first-out queues: urgent, and prefetched.

    Parameters
    ----------
    gap_bytes : int
        Largest gap between two ranges of one request, bytes.
    request_bytes : int
        Maximum size of a request that joins several ranges, bytes.

    Examples
    --------
    >>> from cogsplat.formats.network.range_queue import PendingRange, RangeQueue
    >>> queue = RangeQueue(gap_bytes=10, request_bytes=1000)
    >>> queue.add([PendingRange(0, 100), PendingRange(105, 200), PendingRange(500, 600)])
    >>> request = queue.next_request(1000)
    >>> request.first, request.end, len(request.ranges)
    (0, 200, 2)
    """

    def __init__(self, gap_bytes: int, request_bytes: int) -> None:
        self._gap_bytes = gap_bytes
        self._request_bytes = request_bytes
        self._urgent: deque[PendingRange] = deque()
        self._prefetched: deque[PendingRange] = deque()

    def add(self, ranges: Iterable[PendingRange], *, urgent: bool = False) -> None:
        """Append ranges to the queue of prefetched ranges, or to the urgent one."""
        (self._urgent if urgent else self._prefetched).extend(ranges)

    @property
    def has_urgent(self) -> bool:
        """Whether an urgent range has no request yet."""
        _skip_settled(self._urgent)
        return bool(self._urgent)

    def bytes_before(self, pending: PendingRange, cap: int) -> int:
        """Return the number of prefetched bytes queued before a range, at most `cap`."""
        count = 0
        for other in self._prefetched:
            if other is pending or count >= cap:
                return min(count, cap)
            if not (other.is_dropped or other.is_started):
                count += other.length
        return cap

    def clear(self) -> list[PendingRange]:
        """Empty both queues and return their ranges."""
        ranges = [*self._urgent, *self._prefetched]
        self._urgent.clear()
        self._prefetched.clear()
        return ranges

    def next_request(self, max_bytes: int) -> Request | None:
        """Remove the next range and its close successors from a queue, joined into one request.

        Prefetched ranges are requested only when the urgent queue is empty.

        Parameters
        ----------
        max_bytes : int
            Maximum size of a request that joins several ranges, bytes; `request_bytes` limits it
            as well.

        Returns
        -------
        Request or None
            Next request; None if no range is queued.
        """
        queue = self._urgent if self.has_urgent else self._prefetched
        _skip_settled(queue)
        if not queue:
            return None
        ranges = [queue.popleft()]
        first, end = ranges[0].position, ranges[0].end
        while True:
            _skip_settled(queue)
            if not queue:
                break
            following = queue[0]
            start, stop = min(first, following.position), max(end, following.end)
            gap = max(following.position - end, first - following.end, 0)
            if gap > self._gap_bytes or stop - start > min(max_bytes, self._request_bytes):
                break
            first, end = start, stop
            ranges.append(queue.popleft())
        for pending in ranges:
            pending.is_started = True
        return Request(ranges)


def _skip_settled(queue: deque[PendingRange]) -> None:
    """Remove dropped and already requested ranges from the front of a queue."""
    while queue and (queue[0].is_dropped or queue[0].is_started):
        queue.popleft()
