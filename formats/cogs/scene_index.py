"""Read the index of a file: root and pages, each checked alone, with the offset of each segment.

SPEC 3 to 5 list the checks, SPEC 8.1 their order.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cogsplat.codec.errors import CogsplatError, FormatError, TruncatedError
from cogsplat.formats.storage.source import (
    RemoteSource,
    Source,
    first_request_bytes,
    has_range,
    prefetching,
)

from . import canonical_msgpack, layout
from . import root as cogs_root
from .index_tables import ChunkTable, SegmentTable
from .layout import SegmentKind
from .page_tree import Index, PagePlace, in_file_order, read_page, root_index
from .root import Root
from .segment_rows import I64, IndexRows, find_rows


@dataclass(frozen=True, eq=False)
class SceneIndex:
    """Tables of a file: root, segments and chunks, and the segments of each chunk.

    A row is an index into `segments`; -1 stands for a segment that is absent, or whose page was not
    read.

    Parameters
    ----------
    root : Root
        Root of the file.
    file_length : int
        Length of the file according to the preamble, bytes.
    indices : sequence of Index
        Root and pages that were read, in file order.
    first_unread : PagePlace or None
        First page in file order that was not read.
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
    view_tables : mapping of tuple of int to int
        Row of the view table of each index that lists one, by the path of the index.
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
    indices: Sequence[Index]
    first_unread: PagePlace | None
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
    view_tables: Mapping[tuple[int, ...], int]
    description: int
    pictures: Mapping[str, int]
    codebooks: Sequence[Mapping[SegmentKind, int]]
    all_chunks: int

    @property
    def num_chunks(self) -> int:
        """Number of chunks in the tables."""
        return len(self.chunks)

    @property
    def subtrees(self) -> list[tuple[int, int]]:
        """First and end number of the chunks below each page that was read, in file order."""
        return [
            (index.first_chunk, index.first_chunk + index.tables.extent.chunks)
            for index in self.indices
            if index.path
        ]

    def at(self, path: tuple[int, ...]) -> Index | None:
        """Return the index with a path; None where it was not read, or is not in the file."""
        return next((index for index in self.indices if index.path == path), None)

    def whole(self) -> SceneIndex:
        """Return this index; `LazyIndex.whole` reads the missing pages first."""
        return self

    def for_path(self, path: tuple[int, ...]) -> SceneIndex:
        """Return this index; `LazyIndex.for_path` reads the pages of the path first."""
        return self

    def for_description(self, *, pictures: bool) -> SceneIndex:
        """Return this index; `LazyIndex.for_description` reads a page first for `pictures`."""
        return self


@dataclass(frozen=True)
class RootExtent:
    """Root of a file with the end of the root and of the file, byte offsets."""

    root: Root
    root_end: int
    file_length: int


def read_scene_index(source: Source, *, partial: bool) -> SceneIndex:
    """Read and check preamble, root and all pages; raises as `reader.open_cogs`.

    Parameters
    ----------
    source : Source
        Source of the file.
    partial : bool
        Whether to accept a source that ends before the file does. The index then ends before the
        first page that is not there.
    """
    tree = IndexTree(source, read_root(source, partial=partial))
    if partial:
        tree.read(lambda page: has_range(source, page.start, page.length), up_to_gap=True)
        return tree.up_to_first_gap()
    tree.read(lambda page: True)
    return tree.scene_index()


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
    _check_extent(name, root, root_end, preamble.file_length)
    return RootExtent(root, root_end, preamble.file_length)


def _check_extent(name: str, root: Root, root_end: int, file_length: int) -> None:
    """Check what the root states of the whole file (SPEC 8.1, step 6)."""
    extent = root.tables.extent
    if extent.segments > layout.MAX_SEGMENTS:
        raise FormatError(
            "segment-count",
            f"{name}: {extent.segments} segments, expected at most {layout.MAX_SEGMENTS}",
            clause="9.1",
        )
    if root_end + extent.span != file_length:
        raise FormatError(
            "segments-length",
            f"{name}: index and segments end at byte {root_end + extent.span}, expected "
            f"{file_length}",
            clause="5.1",
        )
    if extent.splats != root.splats:
        raise FormatError(
            "splat-count",
            f"{name}: chunks and pages of {extent.splats} splats, expected {root.splats} as in "
            "the root",
            clause="5.4",
        )
    if root.levels and root.levels[-1].chunks != extent.chunks:
        raise FormatError(
            "level-chunks",
            f"{name}: the last level has {root.levels[-1].chunks} chunks, expected all "
            f"{extent.chunks}",
            clause="5.11",
        )


# Kind of the placeholder rows of pages that were not read: a kind that readers skip.
_UNREAD_KIND = 255


class IndexTree:
    """Root and pages of a file that were read so far, with placeholder rows for the others.

    Segments and chunks have their numbers of the whole file from the beginning.

    Parameters
    ----------
    source : Source
        Source of the file.
    extent : RootExtent
        Root of the file.

    Raises
    ------
    FormatError
        The segments or chunks of the root break SPEC 5.
    """

    def __init__(self, source: Source, extent: RootExtent) -> None:
        self._source = source
        self._extent = extent
        sums = extent.root.tables.extent
        segments, chunks = sums.segments, sums.chunks
        self._segments = SegmentTable.zeros(segments)
        self._segments.kind[:] = _UNREAD_KIND
        self._chunks = ChunkTable.zeros(chunks)
        self._offsets = np.zeros(segments, np.int64)
        self._rows = {
            name: np.full(chunks, -1, np.int64)
            for name in ("heads", "tails", "refinements", "attributes")
        }
        self._opacities: dict[int, Sequence[int]] = {}
        self._view_tables: dict[tuple[int, ...], int] = {}
        self._pictures: Mapping[str, int] = {}
        self._indices: list[Index] = []
        self._unread: dict[tuple[int, ...], PagePlace] = {}
        self._root_rows = self._add(root_index(extent.root.tables, extent.root_end))

    @property
    def unread(self) -> list[PagePlace]:
        """Pages that were not read while the index above was, in file order."""
        return sorted(self._unread.values(), key=lambda page: page.start)

    @property
    def indices(self) -> Sequence[Index]:
        """Root and pages that were read, in file order."""
        return in_file_order(self._indices)

    def read(self, is_wanted: Callable[[PagePlace], bool], *, up_to_gap: bool = False) -> None:
        """Read the unread pages that are wanted, and then those below.

        Pages of one depth are requested together.

        Parameters
        ----------
        is_wanted : callable
            Function that tells whether to read a page.
        up_to_gap : bool
            Whether to overlook faults of pages behind the first that is not wanted.

        Raises
        ------
        CogsplatError
            The fault of the first page in file order that cannot be read or breaks SPEC 5.
        """
        faults: dict[tuple[int, ...], CogsplatError] = {}
        while pages := [x for x in self.unread if x.path not in faults and is_wanted(x)]:
            with prefetching(self._source, [(page.start, page.length) for page in pages]):
                for page in pages:
                    try:
                        self._add(_fetch_page(self._source, page))
                    except CogsplatError as error:
                        faults[page.path] = error
        for page in self.unread:
            if page.path in faults:
                raise faults[page.path]
            if up_to_gap:
                return

    def _add(self, index: Index) -> IndexRows:
        """Add an index after a check of its segments and chunks."""
        rows = find_rows(self._source.name, self._extent.root, index)
        tables = index.tables
        own = slice(index.first_segment, index.first_segment + len(tables.segments))
        self._segments.put(own, tables.segments)
        lengths = tables.segments.length.astype(np.int64)
        self._offsets[own] = index.end + np.cumsum(lengths) - lengths
        chunks = slice(index.first_chunk, index.first_chunk + len(tables.chunks))
        self._chunks.put(chunks, tables.chunks)
        for name, column in self._rows.items():
            column[chunks] = getattr(rows, name)
        self._opacities.update(rows.opacities)
        self._pictures = rows.pictures or self._pictures
        if rows.view_table >= 0:
            self._view_tables[index.path] = rows.view_table
        self._indices.append(index)
        self._unread.pop(index.path, None)
        self._unread.update({page.path: page for page in index.pages()})
        return rows

    def scene_index(self) -> SceneIndex:
        """Return an index of all that was read; other rows are placeholders."""
        return self._scene_index(self.indices, len(self._segments), len(self._chunks))

    def up_to_first_gap(self) -> SceneIndex:
        """Return an index of all that was read and stands before the first page that was not."""
        if not self._unread:
            return self.scene_index()
        first = self.unread[0]
        indices = [index for index in self.indices if index.start < first.start]
        return self._scene_index(indices, first.first_segment, first.first_chunk)

    def _scene_index(self, indices: Sequence[Index], segments: int, chunks: int) -> SceneIndex:
        """Return an index of some indices and of the first rows of the tables."""
        unread, rows, found = self.unread, self._root_rows, self._rows
        return SceneIndex(
            root=self._extent.root,
            file_length=self._extent.file_length,
            indices=indices,
            first_unread=unread[0] if unread else None,
            segments=self._segments.take(slice(segments)),
            chunks=self._chunks.take(slice(chunks)),
            offsets=self._offsets[:segments],
            heads=found["heads"][:chunks],
            tails=found["tails"][:chunks],
            refinements=found["refinements"][:chunks],
            attributes=found["attributes"][:chunks],
            opacities={k: v for k, v in self._opacities.items() if k < chunks},
            codebooks=rows.codebooks,
            cameras=rows.cameras,
            layers=rows.layers,
            view_tables={k: v for k, v in self._view_tables.items() if v < segments},
            description=rows.description,
            pictures={k: v for k, v in self._pictures.items() if v < segments},
            all_chunks=len(self._chunks),
        )


def _fetch_page(source: Source, page: PagePlace) -> Index:
    """Read and check a page."""
    data = source.read(page.start, page.length)
    if zlib.crc32(data) != page.crc and isinstance(source, RemoteSource):
        # A cache may hold bytes of another version of the file (SPEC 8.8).
        data = source.reread(page.start, page.length)
    return read_page(page, data, source.name)
