"""Index of a file in the reference decoder, written from SPEC 3 to 5 alone; valid files only."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import msgpack

from . import reference_streams as streams
from .reference_streams import Payload

IndexPath = tuple[int, ...]
"""Rows of the pages from the root to an index."""

_SHAPE_BOOK = 3


@dataclass(frozen=True)
class Segment:
    """A row of the segment table, with the start and end of the segment in the file.

    Bit k of `needs` is set if the segment needs codebook k.
    """

    kind: int
    owner: int
    start: int
    end: int
    needs: int


class File:
    """Root, segments and payloads of a valid file."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        root_length, self.length = struct.unpack_from("<IQ", data, 12)
        self.root_end = 64 + root_length
        self.root = msgpack.unpackb(data[64 : self.root_end])
        self.segments: list[Segment] = []
        self.chunk_splats: list[int] = []
        self.until: list[int] = []
        self.cells: list[int] = []
        # Index that lists each chunk, and each segment.
        self.chunk_paths: list[IndexPath] = []
        self.paths: list[IndexPath] = []
        # End offset of the index that lists each segment.
        self.known_at: list[int] = []
        # Number of columns of a view table of each index: its chunks and pages.
        self.columns: dict[IndexPath, int] = {}
        self._add(self.root, self.root_end, ())

    def _add(self, index: dict[str, dict[str, bytes]], start: int, path: IndexPath) -> int:
        """Append what an index lists and all below it; return the offset behind."""
        position = self._add_tables(index, start, path)
        lengths = index.get("pages", {}).get("length", b"")
        for row, (length,) in enumerate(struct.iter_unpack("<I", lengths)):
            end = position + length
            position = self._add(msgpack.unpackb(self.data[position:end]), end, (*path, row))
        self.columns[path] = len(index["chunks"]["splats"]) // 4 + len(lengths) // 4
        return position

    def parents(self) -> list[int | None]:
        """Return each chunk's parent (SPEC 5.4)."""
        found: list[int | None] = []
        for chunk, (cell, path) in enumerate(zip(self.cells, self.chunk_paths, strict=True)):
            around = [cell >> k for k in range(32)]
            before = (
                c
                for c, above in reversed(list(enumerate(self.chunk_paths[:chunk])))
                if self.cells[c] in around and path[: len(above)] == above
            )
            found.append(next(before, None) if cell else None)
        return found

    def _add_tables(self, index: dict[str, dict[str, bytes]], start: int, path: IndexPath) -> int:
        """Append the segments and chunks of an index; return the offset after its payloads."""
        table = index["segments"]
        columns = [
            table["kind"],
            *(
                struct.unpack(f"<{len(table[name]) // 4}I", table[name])
                for name in ("owner", "length", "needs")
            ),
        ]
        position = start
        for kind, owner, length, needs in zip(*columns, strict=True):
            self.segments.append(Segment(kind, owner, position, position + length, needs))
            self.known_at.append(start)
            self.paths.append(path)
            position += length
        splats = index["chunks"]["splats"]
        self.chunk_paths += [path] * (len(splats) // 4)
        self.chunk_splats += struct.unpack(f"<{len(splats) // 4}I", splats)
        for name, values in (("until", self.until), ("cell", self.cells)):
            column = index["chunks"].get(name, bytes(len(splats)))
            values += struct.unpack(f"<{len(column) // 4}I", column)
        return position

    def drawn(self, chunks: int) -> list[int]:
        """Return the chunks that a prefix of `chunks` chunks draws (SPEC 5.10)."""
        return [c for c in range(chunks) if self.until[c] == 0 or self.until[c] > chunks]

    def payload(self, segment: Segment) -> Payload:
        """Return the streams of a segment."""
        return streams.parse(self.data[segment.start : segment.end])

    def segments_of(self, kind: int, owner: int) -> list[Segment]:
        """Return the segments of a kind with an owner, a chunk or a codebook."""
        return [s for s in self.segments if (s.kind, s.owner) == (kind, owner)]

    def book_segments(self, book: int) -> list[Segment]:
        """Return the segments of a codebook in band order."""
        if self.root["codebooks"][book]["attribute"] == "shape":
            return self.segments_of(_SHAPE_BOOK, book)
        return [s for k in range(self.root["sh_degree"]) for s in self.segments_of(4 + k, book)]
