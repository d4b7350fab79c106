"""Ranges that are wanted, in the order of the wishes, joined into requests (SPEC 8.8)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable


class Piece:
    """A range that is wanted, and what has come of it.

    Parameters
    ----------
    first, end : int
        First byte and the end behind the last one.
    is_fresh : bool
        Whether caches are gone around for it.

    Attributes
    ----------
    received : int
        Bytes that have come, from the first on.
    error : BaseException or None
        Why the rest does not come.
    is_started : bool
        Whether a request for it was made.
    is_dropped : bool
        Whether nobody wants it any more.
    """

    def __init__(self, first: int, end: int, *, is_fresh: bool = False) -> None:
        self.first, self.end = first, end
        self.is_fresh = is_fresh
        self.received = 0
        self.error: BaseException | None = None
        self.is_started = False
        self.is_dropped = False
        self._bytes = bytearray()

    @property
    def length(self) -> int:
        """Bytes that are wanted."""
        return self.end - self.first

    @property
    def is_whole(self) -> bool:
        """Whether all bytes have come."""
        return self.received == self.length

    @property
    def position(self) -> int:
        """Place in the file of the first byte that has not come."""
        return self.first + self.received

    def take(self, at: int, part: bytes) -> None:
        """Keep what falls into the range of bytes that stand at `at`; bytes come in order."""
        start, stop = self.position, min(self.end, at + len(part))
        if at <= start < stop:
            self._bytes += part[start - at : stop - at]
            self.received = len(self._bytes)

    def bytes_at(self, first: int, end: int) -> bytes:
        """Return bytes that have come, by their place in the file."""
        return bytes(self._bytes[first - self.first : end - self.first])


class Request:
    """One request: a range, and the pieces in it that are wanted.

    Parameters
    ----------
    pieces : list of Piece
        At least one.
    """

    def __init__(self, pieces: list[Piece]) -> None:
        self.pieces = sorted(pieces, key=lambda piece: piece.position)
        self.first = self.pieces[0].position
        self.end = max(piece.end for piece in pieces)
        self.position = self.first

    @property
    def missing(self) -> int:
        """Bytes that have not come."""
        return self.end - self.position

    @property
    def is_fresh(self) -> bool:
        """Whether caches are gone around."""
        return any(piece.is_fresh for piece in self.pieces)

    @property
    def is_dropped(self) -> bool:
        """Whether nobody wants any of it."""
        return all(piece.is_dropped for piece in self.pieces)

    def take(self, part: bytes) -> None:
        """Give the pieces their share of the next bytes."""
        for piece in self.pieces:
            if piece.position >= self.position + len(part):
                break
            piece.take(self.position, part)
        self.position += len(part)


class RangeQueue:
    """Pieces that were not asked for yet.

    Parameters
    ----------
    gap_bytes : int
        Largest gap between pieces of one request.
    request_bytes : int
        Most bytes of a request for several pieces.

    Examples
    --------
    >>> from cogsplat.formats.network.range_queue import Piece, RangeQueue
    >>> queue = RangeQueue(gap_bytes=10, request_bytes=1000)
    >>> queue.add([Piece(0, 100), Piece(105, 200), Piece(500, 600)])
    >>> request = queue.next_request(1000)
    >>> request.first, request.end, len(request.pieces)
    (0, 200, 2)
    """

    def __init__(self, gap_bytes: int, request_bytes: int) -> None:
        self._gap_bytes = gap_bytes
        self._request_bytes = request_bytes
        self._urgent: deque[Piece] = deque()
        self._waiting: deque[Piece] = deque()

    def add(self, pieces: Iterable[Piece], *, urgent: bool = False) -> None:
        """Put pieces at the end, or at the end of those that somebody waits for."""
        (self._urgent if urgent else self._waiting).extend(pieces)

    @property
    def is_urgent(self) -> bool:
        """Whether somebody waits for a piece that was not asked for."""
        _skip(self._urgent)
        return bool(self._urgent)

    def bytes_before(self, piece: Piece, most: int) -> int:
        """Return how many wanted bytes are to be asked for before a piece, `most` at most."""
        count = 0
        for other in self._waiting:
            if other is piece or count >= most:
                return min(count, most)
            if not (other.is_dropped or other.is_started):
                count += other.length
        return most

    def clear(self) -> list[Piece]:
        """Take all pieces out."""
        pieces = [*self._urgent, *self._waiting]
        self._urgent.clear()
        self._waiting.clear()
        return pieces

    def next_request(self, most_bytes: int) -> Request | None:
        """Take the pieces that come next, joined as long as they lie close together.

        Parameters
        ----------
        most_bytes : int
            Most bytes of a request for several pieces, where that is fewer than usual.

        Returns
        -------
        Request or None
            None where nothing is wanted.
        """
        waiting = self._urgent if self.is_urgent else self._waiting
        _skip(waiting)
        if not waiting:
            return None
        pieces = [waiting.popleft()]
        first, end = pieces[0].position, pieces[0].end
        while True:
            _skip(waiting)
            if not waiting:
                break
            following = waiting[0]
            start, stop = min(first, following.position), max(end, following.end)
            gap = max(following.position - end, first - following.end, 0)
            if gap > self._gap_bytes or stop - start > min(most_bytes, self._request_bytes):
                break
            first, end = start, stop
            pieces.append(waiting.popleft())
        for piece in pieces:
            piece.is_started = True
        return Request(pieces)


def _skip(pieces: deque[Piece]) -> None:
    """Remove what nobody wants any more, and what was asked for by now, from the front."""
    while pieces and (pieces[0].is_dropped or pieces[0].is_started):
        pieces.popleft()
