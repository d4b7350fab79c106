"""Write the bytes of a COGS file from its root and segments (SPEC 3 to 5)."""

from __future__ import annotations

import hashlib
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError, FormatError, UnsupportedError
from cogsplat.codec.partition.chunk_tree import ChunkTree, chunk_tree, common_cell
from cogsplat.codec.segments.view_shares import ViewTable, encode_shares
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.formats.storage.pieced_source import Piece, PiecedSource, whole_piece

from . import canonical_msgpack, layout
from . import root as cogs_root
from .index_tables import (
    HASH_BYTES,
    Extent,
    IndexTables,
    PageTable,
    SegmentTable,
    pack_page,
)
from .layout import SegmentKind
from .page_tree import Index
from .root import Root
from .segment_rows import CHUNK_KINDS
from .view_table_segment import pack_view_table, unpack_view_table

Float = TypeVar("Float", bound=np.floating)

# Target size of pages in sequence, bytes, for one quick request each; and target number of pages,
# for rows that fit into the root.
_PAGE_TARGET: Final = 65536
_PAGES_TARGET: Final = 100


@dataclass(frozen=True)
class Segment:
    """Segment to write.

    Parameters
    ----------
    kind : int
        `SegmentKind`, or a kind from 128 on that readers may skip.
    owner : int
        Number of the chunk or codebook that the segment belongs to.
    payload : bytes
        Bytes of the segment.
    needs : tuple of int
        Numbers of the codebooks needed to decode the segment.
    """

    kind: int
    owner: int
    payload: bytes
    needs: tuple[int, ...] = ()


def write_cogs(root: Root, segments: Sequence[Segment], path: Path, *, force: bool = False) -> int:
    """Write a COGS file atomically.

    Parameters
    ----------
    root : Root
        Root of the file; its segment table and pages are replaced.
    segments : sequence of Segment
        Segments in file order.
    path : Path
        Output file.
    force : bool
        Whether to replace an existing file.

    Returns
    -------
    int
        Length of the written file, bytes.

    Raises
    ------
    StorageError
        ``exists``, ``disk-full``, ``permission``, ``not-found`` or ``io``.
    DataError
        The errors of `lay_out`.
    """
    parts = lay_out(root, segments)
    with atomic_write(path, force=force) as file:
        for part in parts:
            file.write(part)
    return sum(len(part) for part in parts)


def lay_out(root: Root, segments: Sequence[Segment]) -> list[bytes]:
    """Return the parts of a file in order: preamble, root, segments and pages.

    Parameters
    ----------
    root : Root
        Root of the file; its segment table and pages are replaced.
    segments : sequence of Segment
        Segments in file order; the description and pictures may stand anywhere among them. The
        columns of a view table are all chunks: each index gets a table of its own columns.

    Raises
    ------
    DataError
        ``bad-scene-info``: the root has a value that readers refuse; ``root-size``: the root is
        too long.
    """
    if len(segments) > layout.MAX_SEGMENTS:
        raise ValueError(f"{len(segments)} segments, expected at most {layout.MAX_SEGMENTS}")
    plan = plan_index(root, segment_table(segments))
    stored = list(segments)
    if plan.pages:
        for row, segment in enumerate(segments):
            if segment.kind == SegmentKind.VIEW_TABLE:
                tables = split_view_table(segment.payload, plan, len(root.chunks))
                stored[row] = tables[0]
                plan.add_view_tables(row, range(len(stored), len(stored) + len(tables) - 1))
                stored += tables[1:]
    parts: list[bytes] = []
    for part in lay_out_index(root, segment_table(stored), plan):
        parts.append(part.index)
        parts += [stored[row].payload for row in part.rows]
    return parts


@dataclass(frozen=True)
class IndexPart:
    """Root with its preamble, or page, and the segments that it lists.

    Parameters
    ----------
    index : bytes
        Bytes of the preamble and root, or of the page.
    rows : sequence of int
        Rows of its segments in the table that was laid out, in file order.
    """

    index: bytes
    rows: Sequence[int]


def laid_out_source(
    name: str, parts: Sequence[IndexPart], piece_of: Callable[[int], Piece]
) -> PiecedSource:
    """Return the file that parts make, as a source.

    Parameters
    ----------
    name : str
        Name of the file in messages.
    parts : sequence of IndexPart
        Parts in file order (`lay_out_index`).
    piece_of : callable
        Returns the bytes of a segment by its row in the table that was laid out.
    """
    pieces: list[Piece] = []
    for part in parts:
        pieces += [whole_piece(part.index), *map(piece_of, part.rows)]
    return PiecedSource(name, pieces)


@dataclass(eq=False)
class IndexPlan:
    """Chunks and segments that an index lists, and the plans of its pages.

    Parameters
    ----------
    chunks : slice
        Chunks that the index lists, of those of the whole file.
    rows : list of int
        Rows of its segments in the table to lay out, in file order.
    pages : list of IndexPlan
        Plans of its pages.
    """

    chunks: slice
    rows: list[int]
    pages: list[IndexPlan]

    def every(self) -> Iterator[IndexPlan]:
        """Yield this plan, then the plans of the pages below it, in file order."""
        yield self
        for page in self.pages:
            yield from page.every()

    def chunks_below(self) -> slice:
        """Return the chunks of the index and of all pages below it."""
        last = self
        while last.pages:
            last = last.pages[-1]
        return slice(self.chunks.start, last.chunks.stop)

    def add_view_tables(self, first: int, others: Iterable[int]) -> None:
        """Add the rows of the view tables of all indices, in file order.

        Parameters
        ----------
        first : int
            Row of the root's table, which the root lists already.
        others : iterable of int
            Rows of the tables of the other indices that list chunks.
        """
        listing = (plan for plan in self.every() if plan.chunks.start < plan.chunks.stop)
        for plan, row in zip((x for x in listing if first not in x.rows), others, strict=True):
            plan.rows.insert(0, row)


def plan_index(
    root: Root, table: SegmentTable, parts: NDArray[np.int64] | None = None
) -> IndexPlan:
    """Distribute chunks and segments over the root and pages.

    Parameters
    ----------
    root : Root
        Root of the file; its segment table and pages are not used.
    table : SegmentTable
        Segments in file order.
    parts : (c,) int64, optional
        Number of the part of each chunk in a scene of parts (`chunk_tree`).

    Returns
    -------
    IndexPlan
        Plan of the root. It lists all where that fits. Else pages follow the cells of chunks that
        stand in the order of `chunk_tree`; the root lists pages of consecutive chunks otherwise.
    """
    kinds = table.kind.tolist()
    weights = _chunk_weights(root, table)
    fixed = len(canonical_msgpack.pack(cogs_root.root_map(_listing(root, slice(0)))))
    others = sum(kind not in CHUNK_KINDS for kind in kinds)
    room = layout.MAX_ROOT_END - layout.PREAMBLE_BYTES - fixed - _TABLE_OVERHEAD
    room -= _SEGMENT_ROW * others
    chunks = len(root.chunks)
    if sum(weights) <= room:
        plan = IndexPlan(slice(0, chunks), [], [])
    else:
        # Room for a description and a first view, so that a first title changes no page.
        room -= _SEGMENT_ROW * (SegmentKind.DESCRIPTION not in kinds)
        room -= _FIRST_VIEW * (root.first_view is None)
        plan = _plan_by_cells(root, weights, room, parts) or _plan_in_sequence(weights, room)
    _assign_rows(plan, table)
    return plan


def plan_of_file(
    indices: Sequence[Index], kept: NDArray[np.int64], description: NDArray[np.uint8]
) -> IndexPlan:
    """Return the plan of a file as it is, with another description.

    Parameters
    ----------
    indices : sequence of Index
        All indices of the file, in file order.
    kept : (k,) int64
        Rows of the file's segments that are kept, the first `k` of the table to lay out.
    description : (d,) uint8
        Kinds of the other segments of that table: description and pictures.
    """
    plans: dict[tuple[int, ...], IndexPlan] = {}
    for index in indices:
        first = index.first_chunk
        plans[index.path] = IndexPlan(slice(first, first + len(index.tables.chunks)), [], [])
        segments = index.first_segment + np.array([0, len(index.tables.segments)])
        plans[index.path].rows += range(*np.searchsorted(kept, segments).tolist())
        if index.path:
            plans[index.path[:-1]].pages.append(plans[index.path])
    others = range(len(kept), len(kept) + len(description))
    _append_description(plans[()], others, description)
    return plans[()]


def lay_out_index(root: Root, table: SegmentTable, plan: IndexPlan) -> list[IndexPart]:
    """Return root and pages of a file with the segments behind each, without their payloads.

    Parameters
    ----------
    root : Root
        Root of the file; its segment table and pages are replaced.
    table : SegmentTable
        Segments in file order.
    plan : IndexPlan
        Chunks and segments of each index.

    Raises
    ------
    DataError
        ``bad-scene-info``: the root has a value that readers refuse; ``root-size``: the root is
        too long.
    """
    parts: list[IndexPart] = []
    pages = _pages(root, table, plan, parts)
    whole = replace(_listing(root, plan.chunks), segments=table.take(plan.rows), pages=pages)
    root_bytes = canonical_msgpack.pack(cogs_root.root_map(whole))
    try:
        cogs_root.parse_root(canonical_msgpack.unpack(root_bytes, "root"), "root")
    except (FormatError, UnsupportedError) as error:
        raise DataError("bad-scene-info", error.message) from error
    if layout.PREAMBLE_BYTES + len(root_bytes) > layout.MAX_ROOT_END:
        raise DataError(
            "root-size",
            f"a root of {len(root_bytes)} bytes, expected at most "
            f"{layout.MAX_ROOT_END - layout.PREAMBLE_BYTES}: use fewer attributes or shorter names",
        )
    length = layout.PREAMBLE_BYTES + len(root_bytes) + whole.tables.extent.span
    preamble = layout.pack_preamble(
        layout.Preamble(layout.MAJOR, layout.MINOR, len(root_bytes), length, zlib.crc32(root_bytes))
    )
    return [IndexPart(preamble + root_bytes, plan.rows), *parts]


def _pages(root: Root, table: SegmentTable, plan: IndexPlan, parts: list[IndexPart]) -> PageTable:
    """Return the table of the pages of an index, and append all parts below it in file order."""
    if not plan.pages:
        return PageTable.zeros(0)
    rows: list[tuple[int, int, Extent, slice]] = []
    for page in plan.pages:
        at = len(parts)
        below = _pages(root, table, page, parts)
        tables = IndexTables(table.take(page.rows), root.chunks.take(page.chunks), below)
        data = pack_page(tables)
        if len(data) > layout.MAX_PAGE_BYTES:
            raise ValueError(f"a page of {len(data)} bytes: expected chunks of smaller cells")
        parts.insert(at, IndexPart(data, page.rows))
        rows.append((len(data), zlib.crc32(data), tables.extent, page.chunks_below()))
    chunks = [root.chunks.take(below) for *_, below in rows]
    extents = [extent for _, _, extent, _ in rows]
    return PageTable(
        length=np.array([length for length, *_ in rows], np.uint32),
        crc=np.array([crc for _, crc, *_ in rows], np.uint32),
        segments=np.array([extent.segments for extent in extents], np.uint32),
        chunks=np.array([extent.chunks for extent in extents], np.uint32),
        span=np.array([extent.span for extent in extents], np.uint64),
        splats=np.array([extent.splats for extent in extents], np.uint32),
        box=np.stack([box_around(each.box) for each in chunks]),
        contribution=np.array([each.contribution.sum() for each in chunks], np.float64),
        cell=np.array([common_cell(each.cell) for each in chunks], np.uint32),
    )


def box_around(boxes: NDArray[Float]) -> NDArray[Float]:
    """Return the bounding box of boxes, (6,); zeros for none."""
    if not len(boxes):
        return np.zeros(6, boxes.dtype)
    return np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])


def split_view_table(payload: bytes, plan: IndexPlan, chunks: int) -> list[Segment]:
    """Cut a view table of all chunks into a view table for each index that lists chunks.

    Parameters
    ----------
    payload : bytes
        View table whose columns are all chunks.
    plan : IndexPlan
        Plan of the root.
    chunks : int
        Number of chunks of the file.

    Returns
    -------
    list of Segment
        Tables in file order. The share of a page is the sum of the shares of its chunks.
    """
    table = unpack_view_table(payload, "view table", chunks, layout.MAX_FILE_BYTES)
    columns = np.arange(chunks)
    found = []
    for index in plan.every():
        if index is not plan and index.chunks.start == index.chunks.stop:
            continue
        pages = [columns[page.chunks_below()] for page in index.pages]
        own = table_of_index(table, columns[index.chunks], pages)
        found.append(Segment(SegmentKind.VIEW_TABLE, 0, pack_view_table(own)))
    return found


def table_of_index(
    table: ViewTable, chunks: NDArray[np.int64], pages: Sequence[NDArray[np.int64]]
) -> ViewTable:
    """Return the view table of an index, with all viewpoints: that one sees nothing tells as much.

    Parameters
    ----------
    table : ViewTable
        View table of chunks.
    chunks : (c,) int64
        Columns of the chunks that the index lists.
    pages : sequence of (k,) int64
        Columns of the chunks below each page that it lists. Their shares are added up.
    """
    views = len(table.positions)
    # Decodes the columns of one page. All columns for every page would take quadratic time.
    below = [ViewTable(table.positions, table.codes[:, own]).shares.sum(axis=1) for own in pages]
    codes = np.concatenate(
        [table.codes[:, chunks], encode_shares(np.reshape(below, (-1, views)).T)], axis=1
    )
    return ViewTable(table.positions, codes)


def segment_table(segments: Sequence[Segment]) -> SegmentTable:
    """Return the segment table of segments."""
    digests = [hashlib.sha256(s.payload).digest()[:HASH_BYTES] for s in segments]
    return SegmentTable(
        kind=np.array([s.kind for s in segments], np.uint8),
        owner=np.array([s.owner for s in segments], np.uint32),
        length=np.array([len(s.payload) for s in segments], np.uint32),
        crc=np.array([zlib.crc32(s.payload) for s in segments], np.uint32),
        hash=np.frombuffer(b"".join(digests), np.uint8).reshape(-1, HASH_BYTES),
        needs=np.array([sum(1 << need for need in s.needs) for s in segments], np.uint32),
    )


# Bytes of a row in an index with all columns (SPEC 5.3, 5.4, 5.6).
_SEGMENT_ROW: Final = 1 + 4 + 4 + 4 + HASH_BYTES + 4
_CHUNK_ROW: Final = 4 + 24 + 8 + 12 + 4
_PAGE_ROW: Final = 4 + 4 + 4 + 4 + 8 + 4 + 24 + 8 + 4
# Bytes of a chunk's optional `until` (SPEC 5.10).
_UNTIL: Final = 4
# Keys and bin headers of the three tables.
_TABLE_OVERHEAD: Final = 256
_PAGE_TABLE_OVERHEAD: Final = 128
# Bytes of a first view with a target (SPEC 4.4).
_FIRST_VIEW: Final = 288


def _listing(root: Root, chunks: slice) -> Root:
    """Return a root that lists some chunks, and no segments and pages."""
    return replace(
        root,
        segments=SegmentTable.zeros(0),
        chunks=root.chunks.take(chunks),
        pages=PageTable.zeros(0),
    )


def _chunk_weights(root: Root, table: SegmentTable) -> list[int]:
    """Return the bytes that each chunk's row and the rows of its segments take in an index."""
    row = _CHUNK_ROW + (_UNTIL if root.chunks.until.any() else 0)
    owners = table.owner[np.isin(table.kind, CHUNK_KINDS)]
    counts = np.bincount(owners, minlength=len(root.chunks))
    return [row + _SEGMENT_ROW * int(count) for count in counts]


def _most_chunks(weights: Sequence[int], room: int) -> int:
    """Return the number of first chunks that fit."""
    return int(np.searchsorted(np.cumsum(weights), room, side="right"))


def _plan_by_cells(
    root: Root, weights: Sequence[int], room: int, parts: NDArray[np.int64] | None
) -> IndexPlan | None:
    """Return a plan whose pages follow the cells; None where chunks do not stand in that order."""
    cells = root.chunks.cell
    if not cells.all():
        return None
    tree = chunk_tree(cells, parts)
    if not np.array_equal(tree.order(), np.arange(len(cells))):
        return None
    plan = _plan_of_tree(tree)
    own = plan.chunks.stop
    room -= _PAGE_TABLE_OVERHEAD + _PAGE_ROW * (len(plan.pages) + 1)
    fit = _most_chunks(weights[:own], room)
    if fit < own:
        # A first page lists what does not fit.
        plan.pages.insert(0, IndexPlan(slice(fit, own), [], []))
        plan.chunks = slice(0, fit)
    return plan


def _plan_of_tree(tree: ChunkTree) -> IndexPlan:
    """Return the plan of a tree whose chunks stand in its order."""
    first = int(tree.chunks[0])
    return IndexPlan(
        slice(first, first + len(tree.chunks)), [], [_plan_of_tree(page) for page in tree.pages]
    )


def _plan_in_sequence(weights: Sequence[int], room: int) -> IndexPlan:
    """Return a plan whose pages, all listed by the root, have the chunks in sequence."""
    page = max(_PAGE_TARGET, sum(weights) // _PAGES_TARGET) - _TABLE_OVERHEAD
    room -= _PAGE_TABLE_OVERHEAD
    room -= _PAGE_ROW * (sum(weights) // max(page - max(weights, default=0), 1) + 2)
    stop = _most_chunks(weights, room)
    plan = IndexPlan(slice(0, stop), [], [])
    while stop < len(weights):
        first = stop
        stop += max(1, _most_chunks(weights[stop:], page))
        plan.pages.append(IndexPlan(slice(first, stop), [], []))
    return plan


def _assign_rows(plan: IndexPlan, table: SegmentTable) -> None:
    """Assign the segments to indices (SPEC 5.2), each in the order given.

    The description comes behind the root's other segments, pictures behind those of the root's last
    page.
    """
    plans = list(plan.every())
    starts = [each.chunks.start for each in plans]
    last: list[int] = []
    for row, kind in enumerate(table.kind.tolist()):
        if kind in CHUNK_KINDS:
            plans[bisect_right(starts, int(table.owner[row])) - 1].rows.append(row)
        elif kind in (SegmentKind.DESCRIPTION, SegmentKind.PICTURE):
            last.append(row)
        else:
            plan.rows.append(row)
    _append_description(plan, last, table.kind[last])


def _append_description(plan: IndexPlan, rows: Sequence[int], kinds: NDArray[np.uint8]) -> None:
    """Append the rows of a description and its pictures to the root and the root's last page."""
    for row, kind in sorted(zip(rows, kinds.tolist(), strict=True), key=itemgetter(1)):
        with_pictures = plan.pages[-1] if plan.pages else plan
        (plan if kind == SegmentKind.DESCRIPTION else with_pictures).rows.append(row)
