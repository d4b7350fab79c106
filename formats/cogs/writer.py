"""Write the bytes of a COGS file from its root and segments (SPEC 3 to 5)."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from cogsplat.codec.errors import DataError, FormatError, UnsupportedError
from cogsplat.formats.storage.atomic import atomic_write

from . import canonical_msgpack, layout
from . import root as cogs_root
from .layout import SegmentKind
from .root import HASH_BYTES, ChunkTable, PageEntry, Root, SegmentTable

# Target size of an index page, bytes, for one quick request each; and target number of pages, for
# entries that fit into the root.
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
        Segments in file order; the description and pictures may stand anywhere among them.

    Raises
    ------
    DataError
        ``bad-scene-info``: the root has a value that readers refuse; ``root-size``: the root is
        too long.
    """
    if len(segments) > layout.MAX_SEGMENTS:
        raise ValueError(f"{len(segments)} segments, expected at most {layout.MAX_SEGMENTS}")
    parts: list[bytes] = []
    for part in lay_out_index(root, segment_table(segments)):
        parts.append(part.index)
        parts += [segments[row].payload for row in part.rows]
    return parts


@dataclass(frozen=True)
class IndexPart:
    """Root with its preamble, or index page, and the segments that it lists.

    Parameters
    ----------
    index : bytes
        Bytes of the preamble and root, or of the page.
    rows : sequence of int
        Rows of its segments in the table that was laid out, in file order.
    """

    index: bytes
    rows: Sequence[int]


def lay_out_index(root: Root, table: SegmentTable) -> list[IndexPart]:
    """Return root and pages of a file with the segments behind each, without their payloads.

    Parameters
    ----------
    root : Root
        Root of the file; its segment table and pages are replaced.
    table : SegmentTable
        Segments in file order; the description and pictures may stand anywhere among them.

    Raises
    ------
    DataError
        ``bad-scene-info``: the root has a value that readers refuse; ``root-size``: the root is
        too long.
    """
    groups = _split(root, table)
    pages: list[PageEntry] = []
    parts: list[IndexPart] = []
    for group in groups[1:]:
        value: dict[str, canonical_msgpack.Value] = {
            "segments": cogs_root.segment_columns(_rows(table, group.rows)),
            "chunks": cogs_root.chunk_columns(_chunk_rows(root.chunks, group.chunks)),
        }
        data = canonical_msgpack.pack(value)
        span = int(table.length[group.rows].sum(dtype=np.uint64))
        chunks = group.chunks.stop - group.chunks.start
        pages.append(PageEntry(len(data), zlib.crc32(data), len(group.rows), chunks, span))
        parts.append(IndexPart(data, group.rows))
    first = groups[0]
    whole = replace(
        root,
        segments=_rows(table, first.rows),
        chunks=_chunk_rows(root.chunks, first.chunks),
        pages=pages,
    )
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
    length = layout.PREAMBLE_BYTES + len(root_bytes) + sum(len(part.index) for part in parts)
    length += int(table.length.sum(dtype=np.uint64))
    preamble = layout.pack_preamble(
        layout.Preamble(layout.MAJOR, layout.MINOR, len(root_bytes), length, zlib.crc32(root_bytes))
    )
    return [IndexPart(preamble + root_bytes, first.rows), *parts]


@dataclass(frozen=True)
class _Group:
    """Contents of one index (root or page): rows of the segment table and slice of the chunks."""

    rows: list[int]
    chunks: slice


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


def _rows(table: SegmentTable, rows: list[int]) -> SegmentTable:
    """Return rows of a segment table."""
    return SegmentTable(
        table.kind[rows],
        table.owner[rows],
        table.length[rows],
        table.crc[rows],
        table.hash[rows],
        table.needs[rows],
    )


def _chunk_rows(table: ChunkTable, rows: slice) -> ChunkTable:
    """Return a slice of a chunk table."""
    return ChunkTable(
        table.splats[rows],
        table.box[rows],
        table.contribution[rows],
        table.layer[rows],
        table.cell[rows],
        table.object[rows],
        table.quality[rows],
        table.until[rows],
    )


# Bytes of a row in an index with all columns (SPEC 5.3, 5.4).
_SEGMENT_ROW: Final = 1 + 4 + 4 + 4 + HASH_BYTES + 4
_CHUNK_ROW: Final = 4 + 24 + 8 + 12 + 4
# Bytes of a chunk's optional `until` (SPEC 5.10).
_UNTIL: Final = 4
# Keys and bin headers of the two tables.
_TABLE_OVERHEAD: Final = 256
# A page's entry in the root: keys, and integers of up to nine bytes.
_PAGE_ENTRY: Final = 96


def _split(root: Root, table: SegmentTable) -> list[_Group]:
    """Distribute the segments over root and pages; a chunk's row and its head stay together.

    The root lists the description, the last index the pictures (SPEC 5.13, 5.14).
    """
    empty = replace(
        root,
        segments=_rows(table, []),
        chunks=_chunk_rows(root.chunks, slice(0)),
        pages=[],
    )
    fixed = layout.PREAMBLE_BYTES + len(canonical_msgpack.pack(cogs_root.root_map(empty)))
    kinds = table.kind.tolist()
    descriptions = [row for row, kind in enumerate(kinds) if kind == SegmentKind.DESCRIPTION]
    pictures = [row for row, kind in enumerate(kinds) if kind == SegmentKind.PICTURE]
    apart = {*descriptions, *pictures}
    others = [row for row in range(len(kinds)) if row not in apart]
    room = layout.MAX_ROOT_END - fixed - _TABLE_OVERHEAD
    chunk_row = _CHUNK_ROW + (_UNTIL if root.chunks.until.any() else 0)
    weights = {
        row: _SEGMENT_ROW + (chunk_row if kinds[row] == SegmentKind.HEAD else 0) for row in others
    }
    total = sum(weights.values())
    if total <= room - _SEGMENT_ROW * len(apart):
        return [_Group([*others, *descriptions, *pictures], slice(0, len(root.chunks)))]
    page = max(_PAGE_TARGET, total // _PAGES_TARGET) - _TABLE_OVERHEAD
    # Room for a description, so that a first title changes no page.
    room -= _SEGMENT_ROW * max(1, len(descriptions))
    limit = room - _PAGE_ENTRY * (total // (page - _SEGMENT_ROW - chunk_row) + 1)
    groups: list[_Group] = []
    rows: list[int] = []
    first_chunk, chunk, used = 0, 0, 0
    for row in others:
        if used + weights[row] > limit:
            groups.append(_Group(rows, slice(first_chunk, chunk)))
            rows, first_chunk, used, limit = [], chunk, 0, page
        rows.append(row)
        used += weights[row]
        chunk += kinds[row] == SegmentKind.HEAD
    groups.append(_Group(rows, slice(first_chunk, chunk)))
    groups[0].rows.extend(descriptions)
    groups[-1].rows.extend(pictures)
    return groups
