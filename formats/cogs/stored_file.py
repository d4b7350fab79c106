"""Tables and segments of an open file, without decoding (SPEC 8)."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.codec.views.pose import down_direction
from cogsplat.codec.views.view_text import parse_view, unit_up
from cogsplat.formats.network.segment_cache import SegmentCache
from cogsplat.formats.network.traffic import Traffic
from cogsplat.formats.storage.source import RemoteSource, Source, has_range

from .drawn_chunks import drawn_chunks
from .fetch_order import needed_codebooks
from .folder_places import object_name
from .index_tables import ChunkTable, SegmentTable
from .layout import SegmentKind
from .lazy_index import LazyIndex
from .missing_segments import missing_segment_bytes
from .object_source import ObjectSource
from .page_tree import Index, PagePlace
from .scene_index import SceneIndex
from .segment_rows import I64, codebook_kinds
from .selection import select_chunks


@dataclass(frozen=True)
class ChunkRows:
    """Rows of one chunk's segments in the segment table.

    Parameters
    ----------
    head : int
        Row of the head.
    refinement, tail, attributes : int or None
        Row of the segment; None for none.
    opacities : tuple of int
        Rows of the opacity segments, in level order.
    """

    head: int
    refinement: int | None
    tail: int | None
    attributes: int | None
    opacities: tuple[int, ...]


class StoredFile:
    """Open file: its tables, and the bytes of its segments. A context manager.

    `chunk_decoder.ChunkDecoder` adds decoding.

    Parameters
    ----------
    source : Source
        Source of the file, closed with it.
    index : SceneIndex or LazyIndex
        Index of the file.

    Attributes
    ----------
    root : Root
        Root of the file.
    file_length : int
        Length of the file according to its preamble, bytes.
    missing_bytes : int
        Bytes that a partial source lacks; 0 for a complete one.
    """

    def __init__(self, source: Source, index: SceneIndex | LazyIndex) -> None:
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
    def _index(self) -> SceneIndex:
        """Whole index; missing pages are read."""
        return self._pages.whole()

    @property
    def segments(self) -> SegmentTable:
        """Segments of the root and of all pages in the source; reads pages not yet read."""
        return self._index.segments

    @property
    def chunks(self) -> ChunkTable:
        """Chunks of the root and of all pages in the source; reads pages not yet read."""
        return self._index.chunks

    @property
    def indices(self) -> Sequence[Index]:
        """Root and pages in the source, in file order; reads pages not yet read."""
        return self._index.indices

    def parents(self) -> I64:
        """Return the parent of each chunk; -1 for none (SPEC 5.4)."""
        return parents(self._index.chunks.cell, self._index.subtrees)

    @property
    def offsets(self) -> I64:
        """Byte offset of each segment, by row of `segments`."""
        return self._index.offsets

    @property
    def source(self) -> Source:
        """Source of the file's bytes."""
        return self._source

    @property
    def name(self) -> str:
        """Name of the file in messages."""
        return self._source.name

    @property
    def num_chunks(self) -> int:
        """Number of chunks in the tables; a partial file may lack the chunks of its last pages."""
        return self._pages.num_chunks

    @property
    def has_all_pages(self) -> bool:
        """Whether the tables have the segments of all pages; a partial file may lack its last."""
        return self._index.first_unread is None

    @property
    def first_missing_page(self) -> PagePlace | None:
        """First page in file order that the source lacks; None if it has all pages."""
        return self._index.first_unread

    @property
    def source_bytes(self) -> int:
        """Number of the file's bytes that the source holds."""
        return self.file_length - self.missing_bytes

    def read_bytes(self, offset: int, length: int) -> bytes:
        """Return stored bytes of the file; fewer if the source ends before the range does.

        Raises
        ------
        StorageError
            Reading failed.
        ValueError
            A negative offset or length.
        """
        if offset < 0 or length < 0:
            raise ValueError(f"{length} bytes from byte {offset}, expected no negative number")
        return self._source.read(offset, max(0, min(length, self._source.size - offset)))

    @property
    def traffic(self) -> Traffic | None:
        """Requests and received bytes so far; None for a local file."""
        found = getattr(self._source, "traffic", None)
        return found if isinstance(found, Traffic) else None

    @property
    def page_bytes(self) -> list[int]:
        """Length of each page in the source, in file order, bytes; reads pages not yet read."""
        return [index.end - index.start for index in self._index.indices if index.path]

    def complete_chunks(self) -> int:
        """Return the number of leading chunks whose heads can be decoded."""
        if not self.missing_bytes:
            return self.num_chunks
        for chunk in range(self.num_chunks):
            if not self._is_decodable(int(self._index.heads[chunk]), 0):
                return chunk
        return self.num_chunks

    def is_present(self, row: int) -> bool:
        """Whether all bytes of a segment, given by its row in `segments`, are present."""
        return has_range(self._source, int(self.offsets[row]), int(self.segments.length[row]))

    def has_tail(self, chunk: int, sh_degree: int = MAX_SH_DEGREE) -> bool:
        """Whether a chunk's tail can be decoded up to an SH degree, or the chunk has none."""
        row = int(self._index.tails[chunk])
        return row < 0 or self._is_decodable(row, min(sh_degree, self.root.sh_degree))

    def has_refinement(self, chunk: int) -> bool:
        """Whether a chunk's refinement is present, or the chunk has none."""
        row = int(self._index.refinements[chunk])
        return row < 0 or self.is_present(row)

    def has_extras(self, chunk: int) -> bool:
        """Whether a chunk's extra attributes are present."""
        row = int(self._index.attributes[chunk])
        return row >= 0 and self.is_present(row)

    @property
    def camera_row(self) -> int | None:
        """Row of the cameras' segment in `segments`; None if the file has no cameras."""
        return self._index.cameras if self._index.cameras >= 0 else None

    @property
    def view_table_rows(self) -> Mapping[tuple[int, ...], int]:
        """Row of each view table's segment in `segments`, by the path of its index.

        The root has the path ``()``, its page 3 the path ``(3,)``.
        """
        return self._index.view_tables

    @property
    def description_row(self) -> int | None:
        """Row of the description's segment in `segments`; None if the file has no description."""
        row = self._pages.for_description(pictures=False).description
        return row if row >= 0 else None

    def first_view(
        self, *, view: str | Camera | None = None, up: str | ArrayLike | None = None
    ) -> Camera | None:
        """Return the view where viewers start; None if there is none.

        Parameters
        ----------
        view : Camera or str, optional
            Another view, or its text (``"x,y,z,tx,ty,tz,fov"``).
        up : str or array-like of 3 float, optional
            Direction against gravity in which the text is level; by default the file's.

        Raises
        ------
        DataError
            ``bad-view-text``.
        """
        if view is None:
            return self.root.first_view
        if isinstance(view, Camera):
            return view
        return parse_view(view).camera(self.up if up is None else unit_up(up))

    @property
    def up(self) -> NDArray[np.float64]:
        """Direction against gravity in the frame of the means, a unit vector."""
        stored = self.root.up
        return -down_direction(self.root.info.axes) if stored is None else stored

    def select(
        self,
        *,
        chunks: tuple[int | None, int | None] | None = None,
        objects: Iterable[int] | None = None,
        splats: int | None = None,
    ) -> list[int]:
        """Return the numbers of the chunks that meet all given conditions, in file order.

        Parameters
        ----------
        chunks : tuple of (int or None, int or None), optional
            Half-open range of chunks; None leaves an end open. By default all complete chunks,
            without ended preview chunks (SPEC 5.10).
        objects : iterable of int, optional
            Object labels, of which a chunk must have one.
        splats : int, optional
            Minimum number of splats: the first chunks that together have at least this number.
            Counted after the other conditions.

        Returns
        -------
        list of int
            Chunk numbers, for `decode`.

        Raises
        ------
        ValueError
            A range outside the file's chunks, a label of no chunk, or a negative number of splats.
        """
        return select_chunks(self.chunks, self.complete_chunks(), chunks, objects, splats)

    def drawn_chunks(self, count: int) -> list[int]:
        """Return the numbers of the chunks that a prefix of `count` chunks draws (SPEC 5.10).

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks the page of a chunk of the prefix.
        """
        if count:
            self._require_chunk(count - 1)
        return drawn_chunks(self.chunks, count)

    def read_segment(self, row: int) -> memoryview:
        """Return a segment's bytes after a check of their CRC.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks the segment.
        FormatError
            ``segment-crc``.
        """
        offset = int(self.offsets[row])
        length = int(self.segments.length[row])
        crc = int(self.segments.crc[row])
        key = self.segments.hash[row].tobytes()
        cached = None if self._cache is None else self._cache.get(key, length)
        if cached is not None and zlib.crc32(cached) == crc:
            return memoryview(cached)
        data = self._source.read(offset, length)
        if zlib.crc32(data) != crc and isinstance(self._source, RemoteSource):
            # A cache may hold bytes of another version of the file (SPEC 8.8).
            data = self._source.reread(offset, length)
        if zlib.crc32(data) != crc:
            raise FormatError(
                "segment-crc",
                f"{self.name}: segment {row} at byte {offset}, {length} bytes: its CRC does not "
                f"match, expected {crc:#010x} as in the table",
                clause="5.3",
                offset=offset,
            )
        if self._cache is not None:
            self._cache.put(key, data)
        return memoryview(data)

    def objects(self) -> dict[str, int]:
        """Return the offset in the file of the first part that each object of a folder holds.

        By object name; empty for a file. An object of a single segment is left out: its name is the
        hash of the segment.

        Raises
        ------
        CogsplatError
            A page of the folder cannot be read, or breaks SPEC.
        """
        if not isinstance(self._source, ObjectSource):
            return {}
        found: dict[str, int] = {}
        for segments in self._source.placed_segments():
            same = (segments.places.objects == segments.hashes).all(axis=1)
            for row in np.flatnonzero(~same).tolist():
                name = object_name(segments.places.objects[row].tobytes())
                found.setdefault(name, int(segments.offsets[row]))
        for name, offset in self._source.page_objects().items():
            found.setdefault(name, offset)
        return found

    def read_object(self, name: str) -> bytes:
        """Return the bytes of an object of a folder, by a name of `objects`.

        Raises
        ------
        TruncatedError
            ``segment-missing``.
        FormatError
            ``segment-object``.
        """
        if not isinstance(self._source, ObjectSource):
            raise ValueError(f"{self.name}: is a file, expected a folder")
        return self._source.read_object(name)

    def is_cached(self, row: int) -> bool:
        """Whether a segment is in the disk cache of a network source."""
        cache = self._cache
        length = int(self.segments.length[row])
        return cache is not None and cache.has(self.segments.hash[row].tobytes(), length)

    def chunk_rows(self, chunk: int) -> ChunkRows:
        """Return the rows of a chunk's segments in the segment table."""
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
        """Return the rows of the segments of a kind with an owner, a chunk or a codebook."""
        mask = (self.segments.kind == kind) & (self.segments.owner == owner)
        return [int(row) for row in np.flatnonzero(mask)]

    def _require_chunk(self, chunk: int) -> None:
        """Refuse a chunk number outside the file, or of a missing page."""
        if not 0 <= chunk < self._pages.all_chunks:
            raise ValueError(f"chunk {chunk}, expected 0 to {self._pages.all_chunks - 1}")
        if chunk >= self.num_chunks:
            raise self._missing_error(f"the page of chunk {chunk}")

    def _missing_error(self, what: str) -> TruncatedError:
        """Return the error for a part of the file that a partial source lacks."""
        return TruncatedError(
            "file-truncated",
            f"{self.name}: {what} is missing: the source has {self._source.size} bytes, "
            f"expected {self.file_length}",
            clause="3.3",
            needed=self.file_length,
        )

    def _is_decodable(self, row: int, degree: int) -> bool:
        """Whether a segment and its codebooks, up to an SH degree, are present."""
        return self.is_present(row) and all(
            self._codebook_rows(book, degree) is not None for book in self._needed_codebooks(row)
        )

    def _needed_codebooks(self, row: int) -> list[int]:
        """Return the numbers of the codebooks that a segment needs."""
        return needed_codebooks(self.segments, row, len(self.root.codebooks))

    def _codebook_rows(self, book: int, degree: int) -> list[int] | None:
        """Return the rows of a codebook's segments up to an SH degree; None if one is missing."""
        kinds = codebook_kinds(self.root.codebooks[book].attribute, degree)
        found = self._index.codebooks[book]
        rows = [found[kind] for kind in kinds if kind in found]
        return rows if len(rows) == len(kinds) and all(map(self.is_present, rows)) else None
