"""Source made of byte ranges of other sources."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from .source import BytesSource, Source, require_within


@dataclass(frozen=True)
class Piece:
    """Range of a source."""

    source: Source
    offset: int
    length: int


def whole_piece(data: bytes) -> Piece:
    """Return bytes in memory as a piece."""
    return Piece(BytesSource(data), 0, len(data))


class PiecedSource:
    """Concatenation of byte ranges of open sources; `close` leaves the sources open."""

    def __init__(self, name: str, pieces: Sequence[Piece]) -> None:
        self.name = name
        self._pieces = pieces
        self._starts: list[int] = []
        self.size = 0
        for piece in pieces:
            self._starts.append(self.size)
            self.size += piece.length

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; see `Source.read`."""
        require_within(self, offset, length)
        parts = []
        number = bisect_right(self._starts, offset) - 1
        while length:
            piece = self._pieces[number]
            first = offset - self._starts[number]
            count = min(length, piece.length - first)
            parts.append(piece.source.read(piece.offset + first, count))
            offset, length, number = offset + count, length - count, number + 1
        return b"".join(parts)

    def close(self) -> None:
        """Do nothing: the sources belong to their files."""
