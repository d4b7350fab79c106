"""Read the index of a file: root and pages, checked together, with the offset of each segment.

SPEC 3 to 5 list the checks, SPEC 8.1 their order.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.formats.storage.source import (
    RemoteSource,
    Source,
    first_request_bytes,
    has_range,
    prefetching,
)

from . import canonical_msgpack, layout
from . import root as cogs_root
from .layout import SegmentKind
from .root import ChunkTable, PageEntry, Root, SegmentTable
from .segment_rows import (
    I64,
    attribute_rows,
    camera_row,
    codebook_rows_by_kind,
    description_row,
    head_rows,
    layer_rows,
    opacity_rows,
    picture_rows,
    refinement_rows,
    tail_rows,
    view_table_row,
)


@dataclass(frozen=True, eq=False)
class Index:
    """Tables of a file: root, segments and chunks, and the segments of each chunk.

    A row is an index into `segments`; -1 stands for a segment that is absent, or whose page was not
    read.

    Parameters
    ----------
    root : Root
        Root of the file.
    file_length : int
        Length of the file according to the preamble, bytes.
    segments : SegmentTable
        Segments of the root and of all pages that were read.
    chunks : ChunkTable
        Chunks of the root and of all pages that were read.
    offsets : (s,) int64
        Byte offset of each segment.
    heads, tails, refinements : (c,) int64
        Row of each chunk's head, tail and refinement.
    opacities : mapping of int to sequence of int
        Rows of the opacity segments by chunk, in level order.
    attributes : (c,) int64
        Row of each chunk's extra attributes.
    cameras : int
        Row of the cameras.
    layers : sequence of int
        Rows of the compensation layers, in order.
    view_table : int
        Row of the view table.
    description : int
        Row of the description.
    pictures : mapping of str to int
        Rows of the pictures, by name.
    codebooks : sequence of mapping of SegmentKind to int
        Rows of each codebook's segments, by kind.
    all_chunks : int
        Number of chunks of the whole file, missing pages included.
    """

    root: Root
    file_length: int
    segments: SegmentTable
    chunks: ChunkTable
    offsets: I64
    heads: I64
    tails: I64
    refinements: I64
    opacities: Mapping[int, Sequence[int]]
    attributes: I64
    cameras: int
    layers: Sequence[int]
    view_table: int
    description: int
    pictures: Mapping[str, int]
    codebooks: Sequence[Mapping[SegmentKind, int]]
    all_chunks: int

    @property
    def num_chunks(self) -> int:
        """Number of chunks in the tables."""
        return len(self.chunks)

    def whole(self) -> Index:
        """Return this index; `LazyIndex.whole` reads the missing pages first."""
        return self

    def for_description(self, *, pictures: bool) -> Index:
        """Return this index; `LazyIndex.for_description` reads a page first for `pictures`."""
        return self


@dataclass(frozen=True)
class RootExtent:
    """Root of a file with the end of the root and of the file, byte offsets."""

    root: Root
    root_end: int
    file_length: int


@dataclass(frozen=True)
class Page:
    """Tables of an index page."""

    segments: SegmentTable
    chunks: ChunkTable


def read_index(source: Source, *, partial: bool) -> Index:
    """Read and check preamble, root and all pages; raises as `reader.open_cogs`.

    Parameters
    ----------
    source : Source
        Source of the file.
    partial : bool
        Whether to accept a source that ends before the file does.
    """
    extent = read_root(source, partial=partial)
    positions = page_positions(extent)
    entries = list(enumerate(zip(extent.root.pages, positions, strict=True)))
    there = [number for number, (e, at) in entries if at + e.length <= source.size]
    pages: dict[int, Page] = {}
    # Errors are reported in file order (SPEC 8.1): each page's position, then its content.
    with prefetching(source, page_ranges(extent, positions, there)):
        for number, (entry, position) in entries:
            if position + entry.length > extent.file_length:
                raise _end_error(source, position + entry.length, extent.file_length)
            if partial and not has_range(source, position, entry.length):
                break
            pages[number] = read_page(source, extent.root, number, position)
    if len(pages) == len(positions):
        require_end(source, extent, positions)
    return join_pages(source, extent, positions, pages)


def read_root(source: Source, *, partial: bool) -> RootExtent:
    """Read and check preamble and root; raises as `reader.open_cogs`."""
    name = source.name
    first = source.read(0, first_request_bytes(source, layout.FIRST_READ))
    preamble = layout.unpack_preamble(first[: layout.PREAMBLE_BYTES], name)
    root_end = layout.PREAMBLE_BYTES + preamble.root_length
    if len(first) < root_end:
        raise TruncatedError(
            "root-truncated",
            f"{name}: {len(first)} bytes, expected a root up to byte {root_end}",
            clause="3.3",
            needed=root_end,
        )
    data = first[layout.PREAMBLE_BYTES : root_end]
    if zlib.crc32(data) != preamble.root_crc:
        raise FormatError(
            "root-crc",
            f"{name}: the root's CRC does not match, expected {preamble.root_crc:#010x}",
            clause="3.3",
            offset=layout.PREAMBLE_BYTES,
        )
    root = cogs_root.parse_root(canonical_msgpack.unpack(data, f"{name}: root"), f"{name}: root")
    if source.size < preamble.file_length and not partial:
        raise TruncatedError(
            "file-truncated",
            f"{name}: {source.size} bytes, expected {preamble.file_length}",
            clause="3.3",
            needed=preamble.file_length,
        )
    if source.size > preamble.file_length:
        raise FormatError(
            "file-trailing",
            f"{name}: {source.size} bytes, expected {preamble.file_length}",
            clause="3.3",
            offset=preamble.file_length,
        )
    rows = len(root.segments) + sum(page.segments for page in root.pages)
    if rows > layout.MAX_SEGMENTS:
        raise FormatError(
            "segment-count",
            f"{name}: {rows} segments, expected at most {layout.MAX_SEGMENTS}",
            clause="9.1",
        )
    _check_levels(source, root, _all_chunks(root))
    _check_own_heads(root.segments, root.chunks, f"{name}: root")
    return RootExtent(root, root_end, preamble.file_length)


def page_positions(extent: RootExtent) -> list[int]:
    """Return the byte offset of each index page according to the root (SPEC 5.6)."""
    position = _root_segments_end(extent)
    positions = []
    for entry in extent.root.pages:
        positions.append(position)
        position += entry.length + entry.span
    return positions


def require_end(source: Source, extent: RootExtent, positions: Sequence[int]) -> None:
    """Refuse a root whose pages and segments end before or behind the end of the file.

    Parameters
    ----------
    source : Source
        Source of the file, for messages.
    extent : RootExtent
        Root of the file.
    positions : sequence of int
        Byte offsets of all pages.

    Raises
    ------
    FormatError
        ``segments-length``.
    """
    end = _root_segments_end(extent)
    if positions:
        last = extent.root.pages[-1]
        end = positions[-1] + last.length + last.span
    if end != extent.file_length:
        raise _end_error(source, end, extent.file_length)


def _root_segments_end(extent: RootExtent) -> int:
    """Return the byte offset behind the segments of the root."""
    return extent.root_end + int(extent.root.segments.length.sum(dtype=np.uint64))


def page_ranges(
    extent: RootExtent, positions: Sequence[int], pages: Iterable[int]
) -> list[tuple[int, int]]:
    """Return offset and length of index pages by their numbers, bytes."""
    return [(positions[number], extent.root.pages[number].length) for number in pages]


def read_page(source: Source, root: Root, number: int, position: int) -> Page:
    """Read and check one index page.

    Parameters
    ----------
    source : Source
        Source of the file.
    root : Root
        Root of the file.
    number : int
        Page number.
    position : int
        Byte offset of the page.

    Raises
    ------
    FormatError, UnsupportedError
        The page breaks SPEC 5.6, or its tables 5.3 and 5.4.
    """
    entry = root.pages[number]
    where = f"{source.name}: index page {number}"
    data = source.read(position, entry.length)
    if zlib.crc32(data) != entry.crc and isinstance(source, RemoteSource):
        # A cache may hold bytes of another version of the file (SPEC 8.8).
        data = source.reread(position, entry.length)
    if zlib.crc32(data) != entry.crc:
        raise FormatError(
            "page-crc",
            f"{where}: its CRC does not match, expected {entry.crc:#010x}",
            clause="5.6",
            offset=position,
        )
    page = Page(*cogs_root.parse_page(canonical_msgpack.unpack(data, where), entry, where))
    _check_own_heads(page.segments, page.chunks, where)
    return page


_SEGMENT_COLUMNS: Final = ("kind", "owner", "length", "crc", "hash", "needs")
_CHUNK_COLUMNS: Final = (
    "splats",
    "box",
    "contribution",
    "layer",
    "cell",
    "object",
    "quality",
    "until",
)

# Kind of the placeholder rows of pages that were not read: a kind that readers skip.
_UNREAD_KIND: Final = 255


def join_pages(
    source: Source,
    extent: RootExtent,
    positions: Sequence[int],
    pages: Mapping[int, Page],
    *,
    keep_numbers: bool = False,
) -> Index:
    """Join the tables of root and pages into a checked index.

    Parameters
    ----------
    source : Source
        Source of the file, for messages.
    extent : RootExtent
        Root of the file.
    positions : sequence of int
        Byte offsets of all pages.
    pages : mapping of int to Page
        Pages that were read, by number.
    keep_numbers : bool
        Whether to insert placeholder rows for pages that were not read, so that segments and chunks
        keep their numbers. Otherwise the index ends before the first page that was not read.
    """
    root = extent.root
    tables = [Page(root.segments, root.chunks)]
    offsets = [_offsets(root.segments, extent.root_end)]
    known = [np.ones(len(root.chunks), bool)]
    for number, entry in enumerate(root.pages):
        page = pages.get(number)
        if page is None and not keep_numbers:
            break
        tables.append(_unread(entry) if page is None else page)
        own = np.zeros(entry.segments, np.int64)
        offsets.append(
            own if page is None else _offsets(page.segments, positions[number] + entry.length)
        )
        known.append(np.full(entry.chunks, page is not None))
    whole = len(pages) == len(root.pages)
    table = SegmentTable(
        *(np.concatenate([getattr(t.segments, n) for t in tables]) for n in _SEGMENT_COLUMNS)
    )
    chunk_table = ChunkTable(
        *(np.concatenate([getattr(t.chunks, n) for t in tables]) for n in _CHUNK_COLUMNS)
    )
    heads = head_rows(source, table, np.concatenate(known))
    tails = tail_rows(source, root, table, heads)
    refinements = refinement_rows(source, table, heads)
    opacities = opacity_rows(source, root, table, chunk_table, heads)
    _check_ends(source, chunk_table, _all_chunks(root))
    _check_counts(source, root, table, chunk_table, whole=whole)
    return Index(
        root=root,
        file_length=extent.file_length,
        segments=table,
        chunks=chunk_table,
        offsets=np.concatenate(offsets),
        heads=heads,
        tails=tails,
        refinements=refinements,
        opacities=opacities,
        codebooks=codebook_rows_by_kind(source, root, table, whole=whole),
        attributes=attribute_rows(source, root, table, heads),
        cameras=camera_row(source, table),
        layers=layer_rows(source, table) if whole or not keep_numbers else [],
        view_table=view_table_row(source, table),
        description=description_row(source, root, table),
        pictures=picture_rows(source, root, table),
        all_chunks=_all_chunks(root),
    )


def _all_chunks(root: Root) -> int:
    """Return the number of chunks in the root and all pages."""
    return len(root.chunks) + sum(page.chunks for page in root.pages)


def _unread(entry: PageEntry) -> Page:
    """Return placeholder tables with the row counts of a page."""
    segments, chunks = entry.segments, entry.chunks
    nothing = np.zeros(segments, np.uint32)
    zeros = np.zeros(chunks, np.uint32)
    return Page(
        SegmentTable(
            np.full(segments, _UNREAD_KIND, np.uint8),
            nothing,
            nothing,
            nothing,
            np.zeros((segments, cogs_root.HASH_BYTES), np.uint8),
            nothing,
        ),
        ChunkTable(
            zeros,
            np.zeros((chunks, 6), np.float32),
            np.zeros(chunks),
            zeros,
            zeros,
            zeros,
            np.zeros(chunks, np.float32),
            zeros,
        ),
    )


def _offsets(table: SegmentTable, start: int) -> I64:
    """Return the byte offsets of consecutive segments, the first at `start`."""
    lengths = table.length.astype(np.int64)
    offsets: I64 = start + np.cumsum(lengths) - lengths
    return offsets


def _end_error(source: Source, end: int, file_length: int) -> FormatError:
    """Return the error for segments that end elsewhere than the file."""
    return FormatError(
        "segments-length",
        f"{source.name}: index and segments end at byte {end}, expected {file_length}",
        clause="5.1",
    )


def _check_own_heads(table: SegmentTable, chunks: ChunkTable, where: str) -> None:
    """Refuse a root or page whose numbers of heads and chunks differ (SPEC 5.4)."""
    heads = int((table.kind == SegmentKind.HEAD).sum())
    if heads != len(chunks):
        raise FormatError(
            "chunk-heads",
            f"{where}: {heads} heads, expected {len(chunks)}, one per chunk",
            clause="5.4",
        )


def _check_levels(source: Source, root: Root, all_chunks: int) -> None:
    """Refuse levels whose last one does not have all chunks of the file (SPEC 5.11)."""
    if root.levels and root.levels[-1].chunks != all_chunks:
        raise FormatError(
            "level-chunks",
            f"{source.name}: the last level has {root.levels[-1].chunks} chunks, expected all "
            f"{all_chunks}",
            clause="5.11",
        )


def _check_ends(source: Source, chunks: ChunkTable, all_chunks: int) -> None:
    """Refuse a nonzero `until` outside the chunks behind its own (SPEC 5.10)."""
    until = chunks.until.astype(np.int64)
    wrong = (until > 0) & ((until < np.arange(len(until)) + 2) | (until > all_chunks))
    if wrong.any():
        chunk = int(np.argmax(wrong))
        raise FormatError(
            "chunk-until",
            f"{source.name}: chunk {chunk}: until is {until[chunk]}, expected 0 or {chunk + 2} to "
            f"{all_chunks}",
            clause="5.10",
        )


def _check_counts(
    source: Source, root: Root, table: SegmentTable, chunks: ChunkTable, *, whole: bool
) -> None:
    """Check the number of splats (SPEC 5.4) and the codebook numbers (SPEC 5.3)."""
    total = int(chunks.splats.sum(dtype=np.uint64))
    if total > root.splats or (whole and total != root.splats):
        raise FormatError(
            "splat-count",
            f"{source.name}: chunks of {total} splats, expected {root.splats} as in the root",
            clause="5.4",
        )
    books = len(root.codebooks)
    if len(table) and int(table.needs.max()) >> books:
        raise FormatError(
            "needs-range",
            f"{source.name}: a segment needs codebook {int(table.needs.max()).bit_length() - 1}, "
            f"expected a number below {books}",
            clause="5.3",
        )
