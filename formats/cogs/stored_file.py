"""An open file's tables, and its segments' bytes: what there is and what has arrived (SPEC 8)."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.formats.network.segment_cache import SegmentCache
from cogsplat.formats.network.traffic import Traffic
from cogsplat.formats.storage.source import RemoteSource, Source, has_range

from .fetch_order import needed_codebooks
from .folder_places import object_name
from .index import I64, Index, codebook_kinds
from .layout import SegmentKind
from .lazy_index import LazyIndex
from .missing_segments import missing_segment_bytes
from .object_source import ObjectSource
from .root import ChunkTable, SegmentTable
from .selection import select_chunks


@dataclass(frozen=True)
class ChunkRows:
    """Rows of the segment table that belong to one chunk.

    Parameters
    ----------
    head : int
    refinement, tail, attributes : int or None
        None where the chunk has none.
    opacities : tuple of int
        One for each later level that changes them, in the order of the levels.
    """

    head: int
    refinement: int | None
    tail: int | None
    attributes: int | None
    opacities: tuple[int, ...]


class StoredFile:
    """An open file's tables and bytes: which segments it has, and which of them have arrived.

    A context manager. `reader.CogsFile` decodes them.

    Attributes
    ----------
    root : Root
    missing_bytes : int
        Bytes that a partial source lacks; 0 for a complete one.
    """

    def __init__(self, source: Source, index: Index | LazyIndex) -> None:
        self._source = source
        self._pages = index
        cache = getattr(source, "cache", None)
        self._cache = cache if isinstance(cache, SegmentCache) else None
        self.root = index.root
        self.file_length = index.file_length
        self.missing_bytes = max(0, index.file_length - source.size) + missing_segment_bytes(
            source, index
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the source."""
        self._source.close()

    @property
    def _index(self) -> Index:
        """Whole index; missing pages are read."""
        return self._pages.whole()

    @property
    def segments(self) -> SegmentTable:
        """Segments of the root and of all pages that are there."""
        return self._index.segments

    @property
    def chunks(self) -> ChunkTable:
        """Chunks of the root and of all pages that are there."""
        return self._index.chunks

    @property
    def offsets(self) -> I64:
        """Byte offset of each segment."""
        return self._index.offsets

    @property
    def name(self) -> str:
        """Names the file in messages."""
        return self._source.name

    @property
    def num_chunks(self) -> int:
        """Chunks the tables list; a partial file may lack the last pages' chunks."""
        return self._pages.num_chunks

    @property
    def source_bytes(self) -> int:
        """Bytes of the file that the source holds; a partial one lacks some."""
        return self.file_length - self.missing_bytes

    def read_bytes(self, offset: int, length: int) -> bytes:
        """Return bytes of the file as they are stored; fewer where it ends or has not arrived.

        Raises
        ------
        StorageError
            They cannot be read.
        ValueError
            A negative offset or length.
        """
        if offset < 0 or length < 0:
            raise ValueError(f"{length} bytes from byte {offset}, expected no negative number")
        return self._source.read(offset, max(0, min(length, self._source.size - offset)))

    @property
    def traffic(self) -> Traffic | None:
        """Requests and bytes so far, where the file is read over a network."""
        found = getattr(self._source, "traffic", None)
        return found if isinstance(found, Traffic) else None

    @property
    def page_bytes(self) -> int:
        """Bytes of all index pages."""
        return sum(page.length for page in self.root.pages)

    def complete_chunks(self) -> int:
        """Return how many chunks, counted from the first, have heads that can be decoded."""
        if not self.missing_bytes:
            return self.num_chunks
        for chunk in range(self.num_chunks):
            if not self._complete(int(self._index.heads[chunk]), 0):
                return chunk
        return self.num_chunks

    def is_present(self, row: int) -> bool:
        """Whether a segment, by its row in the segment table, has arrived whole."""
        return has_range(self._source, int(self.offsets[row]), int(self.segments.length[row]))

    def has_tail(self, chunk: int, sh_degree: int = MAX_SH_DEGREE) -> bool:
        """Whether a chunk's shN can be decoded up to an SH degree, or there is none to decode."""
        row = int(self._index.tails[chunk])
        return row < 0 or self._complete(row, min(sh_degree, self.root.sh_degree))

    def has_refinement(self, chunk: int) -> bool:
        """Whether a chunk's values can be decoded as fine as the whole file has them."""
        row = int(self._index.refinements[chunk])
        return row < 0 or self.is_present(row)

    def has_extras(self, chunk: int) -> bool:
        """Whether the extra attributes of a chunk's splats can be decoded."""
        row = int(self._index.attributes[chunk])
        return row >= 0 and self.is_present(row)

    @property
    def camera_row(self) -> int | None:
        """Row of the segment of cameras, None where the file has none."""
        return self._index.cameras if self._index.cameras >= 0 else None

    @property
    def view_table_row(self) -> int | None:
        """Row of the segment of the view table, None where the file has none."""
        return self._index.view_table if self._index.view_table >= 0 else None

    def select(
        self,
        *,
        chunks: tuple[int | None, int | None] | None = None,
        objects: Iterable[int] | None = None,
        splats: int | None = None,
    ) -> list[int]:
        """Return the numbers of the chunks that make up a part of the scene, in file order.

        Conditions that are given together all hold; `splats` counts what the others leave.

        Parameters
        ----------
        chunks : tuple of (int or None, int or None), optional
            Half-open range of chunks; None leaves an end open. By default all chunks that are
            complete and have not ended (SPEC 5.10).
        objects : iterable of int, optional
            Labels of objects: only chunks that hold one of them.
        splats : int, optional
            Whole chunks from the first until they hold at least so many splats.

        Returns
        -------
        list of int
            As `decode` takes them.

        Raises
        ------
        ValueError
            A range that does not lie within the file's chunks, a label that no chunk has, or a
            negative number of splats.
        """
        return select_chunks(self.chunks, self.complete_chunks(), chunks, objects, splats)

    def read_segment(self, row: int) -> memoryview:
        """Return a segment's bytes, its CRC checked.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source does not hold it.
        FormatError
            ``segment-crc``.
        """
        offset = int(self.offsets[row])
        length = int(self.segments.length[row])
        crc = int(self.segments.crc[row])
        key = self.segments.hash[row].tobytes()
        kept = None if self._cache is None else self._cache.get(key)
        if kept is not None and len(kept) == length and zlib.crc32(kept) == crc:
            return memoryview(kept)
        data = self._source.read(offset, length)
        if zlib.crc32(data) != crc and isinstance(self._source, RemoteSource):
            # A cache may hold bytes of another version of the file (SPEC 8.8).
            data = self._source.reread(offset, length)
        if zlib.crc32(data) != crc:
            raise FormatError(
                "segment-crc",
                f"{self.name}: segment {row} at byte {offset}, {length} bytes: "
                "its CRC does not match the table's",
                clause="5.3",
                offset=offset,
            )
        if self._cache is not None:
            self._cache.put(key, data)
        return memoryview(data)

    def objects(self) -> dict[str, int]:
        """Return the first segment in each object of a folder by the object's name; of a file none.

        An object that is one whole segment is left out: its name is the segment's hash.

        Raises
        ------
        CogsplatError
            A page of the manifest cannot be read, or breaks SPEC.
        """
        if not isinstance(self._source, ObjectSource):
            return {}
        found: dict[str, int] = {}
        row = 0
        for table, places in self._source.tables():
            same = (places.objects == table.hash).all(axis=1)
            for at in np.flatnonzero(~same).tolist():
                found.setdefault(object_name(places.objects[at].tobytes()), row + at)
            row += len(places)
        return found

    def read_object(self, name: str) -> bytes:
        """Return the bytes of an object of a folder, as `objects` names it.

        Raises
        ------
        TruncatedError
            ``segment-missing``.
        FormatError
            ``segment-object``.
        """
        if not isinstance(self._source, ObjectSource):
            raise ValueError(f"{self.name}: is no folder, expected one")
        return self._source.read_object(name)

    def is_kept(self, row: int) -> bool:
        """Whether a segment is on disk already, of a file that is read over a network."""
        cache = self._cache
        return cache is not None and cache.has(self.segments.hash[row].tobytes())

    def rows_of(self, chunk: int) -> ChunkRows:
        """Return where a chunk's segments stand in the segment table."""
        index = self._index

        def row(table: I64) -> int | None:
            return int(table[chunk]) if table[chunk] >= 0 else None

        return ChunkRows(
            int(index.heads[chunk]),
            row(index.refinements),
            row(index.tails),
            row(index.attributes),
            tuple(index.opacities.get(chunk, ())),
        )

    def segment_rows(self, kind: SegmentKind, owner: int) -> list[int]:
        """Return the rows of the segments of a kind that belong to a chunk or codebook."""
        mask = (self.segments.kind == kind) & (self.segments.owner == owner)
        return [int(row) for row in np.flatnonzero(mask)]

    def _require_chunk(self, chunk: int) -> None:
        if not 0 <= chunk < self._pages.all_chunks:
            raise ValueError(f"chunk {chunk}, expected 0 to {self._pages.all_chunks - 1}")
        if chunk >= self.num_chunks:
            raise self._not_there(f"chunk {chunk}: the index page that lists it")

    def _not_there(self, what: str) -> TruncatedError:
        return TruncatedError(
            "file-truncated",
            f"{self.name}: {what} is behind the {self._source.size} bytes there are, "
            f"expected {self.file_length}",
            clause="3.3",
            needed=self.file_length,
        )

    def _complete(self, row: int, degree: int) -> bool:
        """Whether a segment and the codebooks it needs are there, up to an SH degree."""
        return self.is_present(row) and all(
            self._codebook_rows(book, degree) is not None for book in self._needed(row)
        )

    def _needed(self, row: int) -> list[int]:
        return needed_codebooks(self.segments, row, len(self.root.codebooks))

    def _codebook_rows(self, book: int, degree: int) -> list[int] | None:
        """Return the segments of a codebook up to an SH degree, None where one is not there."""
        kinds = codebook_kinds(self.root.codebooks[book].attribute, degree)
        found = self._index.codebooks[book]
        rows = [found[kind] for kind in kinds if kind in found]
        return rows if len(rows) == len(kinds) and all(map(self.is_present, rows)) else None
