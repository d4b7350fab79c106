"""Tables of an index, the root or a page: segments, chunks and further pages (SPEC 5.3 to 5.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import UnsupportedError
from cogsplat.codec.metrics import PSNR_CAP_DB
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS

from . import canonical_msgpack, layout
from .canonical_msgpack import Value
from .msgpack_map import CheckedMap

U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

HASH_BYTES: Final = 16
"""Bytes of a segment's SHA-256 that are stored (SPEC 5.3)."""


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """Segments of an index in file order, one row each (SPEC 5.3).

    Parameters
    ----------
    kind : (s,) uint8
        `SegmentKind`, or an unknown kind from 128 on.
    owner : (s,) uint32
        Number of the chunk or codebook that the segment belongs to.
    length : (s,) uint32
        Length of the segment, bytes.
    crc : (s,) uint32
        CRC-32 of the segment.
    hash : (s, 16) uint8
        First 16 bytes of the segment's SHA-256.
    needs : (s,) uint32
        Bit mask of the codebooks needed to decode the segment.
    """

    kind: NDArray[np.uint8]
    owner: U32
    length: U32
    crc: U32
    hash: NDArray[np.uint8]
    needs: U32

    def __len__(self) -> int:
        return len(self.kind)


def no_segments() -> SegmentTable:
    """Return a segment table without rows."""
    none = np.zeros(0, np.uint32)
    kinds = np.zeros(0, np.uint8)
    return SegmentTable(kinds, none, none, none, np.zeros((0, HASH_BYTES), np.uint8), none)


@dataclass(frozen=True, eq=False)
class ChunkTable:
    """Chunks of an index in order, one row each (SPEC 5.4).

    Parameters
    ----------
    splats : (c,) uint32
        Number of splats.
    box : (c, 6) float32
        Bounding box of the splats with their extents: minimum corner, maximum corner; scene units.
    contribution : (c,) float64
        Sum of the splats' contributions; 0 in a scene without scores.
    layer, cell, object : (c,) uint32
        Layer, cell and object number; 0 in a scene without them.
    quality : (c,) float32
        Predicted PSNR of the prefix that ends with the chunk, dB; 0 for no prediction.
    until : (c,) uint32
        Prefixes of this number of chunks or more do not draw the chunk; 0 if all prefixes draw it
        (SPEC 5.10).
    """

    splats: U32
    box: NDArray[np.float32]
    contribution: NDArray[np.float64]
    layer: U32
    cell: U32
    object: U32
    quality: NDArray[np.float32]
    until: U32

    def __len__(self) -> int:
        return len(self.splats)


@dataclass(frozen=True, eq=False)
class PageTable:
    """Pages that an index lists, one row each; a row counts all that is below its page (SPEC 5.6).

    Parameters
    ----------
    length : (p,) uint32
        Length of the page, bytes.
    crc : (p,) uint32
        CRC-32 of the page.
    segments, chunks : (p,) uint32
        Numbers of segments and chunks below the page.
    span : (p,) int64
        Total length of the segments and pages below the page, which follow it, bytes.
    splats : (p,) uint32
        Number of splats below the page.
    box : (p, 6) float32
        Bounding box of the chunks below the page: minimum corner, maximum corner; scene units.
    contribution : (p,) float64
        Sum of the contributions of the chunks below the page.
    cell : (p,) uint32
        Cell that contains the cells of the chunks below the page; 0 in a scene without cells.
    """

    length: U32
    crc: U32
    segments: U32
    chunks: U32
    span: I64
    splats: U32
    box: F32
    contribution: F64
    cell: U32

    def __len__(self) -> int:
        return len(self.length)


def no_pages() -> PageTable:
    """Return a page table without rows."""
    none = np.zeros(0, np.uint32)
    return PageTable(
        none,
        none,
        none,
        none,
        np.zeros(0, np.int64),
        none,
        np.zeros((0, 6), np.float32),
        np.zeros(0),
        none,
    )


@dataclass(frozen=True)
class Extent:
    """Sums over all that an index lists and all that is below its pages.

    Parameters
    ----------
    segments, chunks, splats : int
        Numbers of segments, chunks and splats.
    span : int
        Bytes behind the index: of its segments and pages, and of all that is below them.
    """

    segments: int
    chunks: int
    span: int
    splats: int


@dataclass(frozen=True, eq=False)
class IndexTables:
    """Tables of one index, the root or a page."""

    segments: SegmentTable
    chunks: ChunkTable
    pages: PageTable

    @property
    def segment_bytes(self) -> int:
        """Total length of the segments that the index lists, bytes."""
        return int(self.segments.length.sum(dtype=np.uint64))

    @property
    def extent(self) -> Extent:
        """Sums over all that is below the index."""
        pages = self.pages
        return Extent(
            segments=len(self.segments) + int(pages.segments.sum(dtype=np.uint64)),
            chunks=len(self.chunks) + int(pages.chunks.sum(dtype=np.uint64)),
            span=self.segment_bytes + sum(pages.length.tolist()) + sum(pages.span.tolist()),
            splats=int(self.chunks.splats.sum(dtype=np.uint64))
            + int(pages.splats.sum(dtype=np.uint64)),
        )


def column_bytes(values: NDArray[np.generic], dtype: str) -> bytes:
    """Return a table column as little-endian bytes."""
    return np.ascontiguousarray(values).astype(dtype).tobytes()


def segment_columns(table: SegmentTable) -> dict[str, Value]:
    """Return a segment table as msgpack columns."""
    return {
        "kind": column_bytes(table.kind, "u1"),
        "owner": column_bytes(table.owner, "<u4"),
        "length": column_bytes(table.length, "<u4"),
        "crc": column_bytes(table.crc, "<u4"),
        "hash": column_bytes(table.hash, "u1"),
        "needs": column_bytes(table.needs, "<u4"),
    }


def chunk_columns(table: ChunkTable) -> dict[str, Value]:
    """Return a chunk table as msgpack columns; optional columns of zeros are left out."""
    value: dict[str, Value] = {
        "splats": column_bytes(table.splats, "<u4"),
        "box": column_bytes(table.box, "<f4"),
        "contribution": column_bytes(table.contribution, "<f8"),
    }
    for name in ("layer", "cell", "object"):
        column = getattr(table, name)
        if column.any():
            value[name] = column_bytes(column, "<u4")
    if table.quality.any():
        value["quality"] = column_bytes(table.quality, "<f4")
    if table.until.any():
        value["until"] = column_bytes(table.until, "<u4")
    return value


def page_columns(table: PageTable) -> dict[str, Value]:
    """Return a page table as msgpack columns; a column of cells that are all 0 is left out."""
    value: dict[str, Value] = {
        "length": column_bytes(table.length, "<u4"),
        "crc": column_bytes(table.crc, "<u4"),
        "segments": column_bytes(table.segments, "<u4"),
        "chunks": column_bytes(table.chunks, "<u4"),
        "span": column_bytes(table.span, "<u8"),
        "splats": column_bytes(table.splats, "<u4"),
        "box": column_bytes(table.box, "<f4"),
        "contribution": column_bytes(table.contribution, "<f8"),
    }
    if table.cell.any():
        value["cell"] = column_bytes(table.cell, "<u4")
    return value


def pack_page(tables: IndexTables) -> bytes:
    """Encode a page."""
    value: dict[str, Value] = {
        "segments": segment_columns(tables.segments),
        "chunks": chunk_columns(tables.chunks),
    }
    if len(tables.pages):
        value["pages"] = page_columns(tables.pages)
    return canonical_msgpack.pack(value)


def parse_segments(value: Value, where: str) -> SegmentTable:
    """Parse and check a segment table.

    Parameters
    ----------
    value : Value
        Unpacked msgpack map.
    where : str
        Name of the root or page in messages.

    Raises
    ------
    FormatError
        ``root-missing``, ``root-type``, ``root-columns``, ``root-value``.
    UnsupportedError
        ``segment-kind-unknown``, ``root-must-understand``.
    """
    table = CheckedMap(value, f"{where}, segments", "5.3")
    kind = table.column("kind", "u1", None).astype(np.uint8)
    rows = len(kind)
    owner = table.column("owner", "<u4", rows)
    length = table.column("length", "<u4", rows)
    crc = table.column("crc", "<u4", rows)
    digest = table.column("hash", "u1", rows, HASH_BYTES)
    needs = table.column("needs", "<u4", rows)
    table.finish()
    known = [int(k) for k in layout.SegmentKind]
    unknown = np.flatnonzero((kind < layout.SKIPPABLE_KIND) & ~np.isin(kind, known))
    if len(unknown):
        raise UnsupportedError(
            "segment-kind-unknown",
            f"{where}, segment {unknown[0]}: kind {kind[unknown[0]]}, expected {known} or "
            f"{layout.SKIPPABLE_KIND} and above (SPEC 5.2)",
        )
    if rows and int(length.min()) == 0:
        raise table.error("length", "a segment of 0 bytes, expected at least 1")
    return SegmentTable(
        kind,
        owner.astype(np.uint32),
        length.astype(np.uint32),
        crc.astype(np.uint32),
        digest.astype(np.uint8).reshape(rows, HASH_BYTES),
        needs.astype(np.uint32),
    )


def parse_chunks(value: Value, where: str) -> ChunkTable:
    """Parse and check a chunk table; raises as `parse_segments`."""
    table = CheckedMap(value, f"{where}, chunks", "5.4")
    splats = table.column("splats", "<u4", None).astype(np.uint32)
    rows = len(splats)
    box = table.column("box", "<f4", rows, 6).astype(np.float32).reshape(rows, 6)
    contribution = table.column("contribution", "<f8", rows).astype(np.float64)
    optional = {
        name: (
            table.column(name, "<u4", rows).astype(np.uint32)
            if table.has(name)
            else np.zeros(rows, np.uint32)
        )
        for name in ("layer", "cell", "object")
    }
    quality = np.zeros(rows, np.float32)
    if table.has("quality"):
        quality = table.column("quality", "<f4", rows).astype(np.float32)
    until = np.zeros(rows, np.uint32)
    if table.has("until"):
        until = table.column("until", "<u4", rows).astype(np.uint32)
    table.finish()
    if rows and not 1 <= int(splats.min()) <= int(splats.max()) <= MAX_CHUNK_SPLATS:
        raise table.error(
            "splats",
            f"{int(splats.min())} to {int(splats.max())} in a chunk, "
            f"expected 1 to {MAX_CHUNK_SPLATS}",
        )
    _check_boxes(table, box, contribution)
    if not ((quality >= 0) & (quality <= PSNR_CAP_DB)).all():
        raise table.error("quality", f"out of range, expected 0 to {PSNR_CAP_DB:g} dB")
    return ChunkTable(splats, box, contribution, **optional, quality=quality, until=until)


def _check_boxes(table: CheckedMap, box: F32, contribution: F64) -> None:
    """Refuse boxes and contributions of chunks or pages that are out of range (SPEC 5.4)."""
    if not (np.isfinite(box).all() and (box[:, :3] <= box[:, 3:]).all()):
        raise table.error("box", "corners not finite or not ordered, expected minimum, maximum")
    if not (np.isfinite(contribution).all() and (contribution >= 0).all()):
        raise table.error("contribution", "not finite or negative, expected 0 or more")


def parse_pages(index: CheckedMap, where: str, most: int) -> PageTable:
    """Parse and check the optional page table of an index; raises as `parse_segments`.

    Parameters
    ----------
    index : CheckedMap
        Map of the root or page.
    where : str
        Name of the root or page in messages.
    most : int
        Maximum number of rows.
    """
    if not index.has("pages"):
        return no_pages()
    table = CheckedMap(index.pop("pages", dict), f"{where}, pages", "5.6")
    length = table.column("length", "<u4", None).astype(np.uint32)
    rows = len(length)
    crc, segments, chunks = (
        table.column(name, "<u4", rows).astype(np.uint32) for name in ("crc", "segments", "chunks")
    )
    span = table.column("span", "<u8", rows).astype(np.uint64)
    splats = table.column("splats", "<u4", rows).astype(np.uint32)
    box = table.column("box", "<f4", rows, 6).astype(np.float32).reshape(rows, 6)
    contribution = table.column("contribution", "<f8", rows).astype(np.float64)
    cell = np.zeros(rows, np.uint32)
    if table.has("cell"):
        cell = table.column("cell", "<u4", rows).astype(np.uint32)
    table.finish()
    if rows > most:
        raise table.error("length", f"{rows} pages, expected at most {most}")
    for name, column, low, high in (
        ("length", length, 1, layout.MAX_PAGE_BYTES),
        ("segments", segments, 1, layout.MAX_SEGMENTS),
        ("span", span, 1, layout.MAX_FILE_BYTES),
        ("splats", splats, 0, layout.MAX_SPLATS),
    ):
        if rows and not low <= int(column.min()) <= int(column.max()) <= high:
            raise table.error(
                name,
                f"{int(column.min())} to {int(column.max())} of a page, expected {low} to {high}",
            )
        if name == "segments" and (chunks > segments).any():
            raise table.error("chunks", "more chunks than segments below a page")
    _check_boxes(table, box, contribution)
    return PageTable(
        length, crc, segments, chunks, span.astype(np.int64), splats, box, contribution, cell
    )


def parse_page(data: bytes, where: str, most_pages: int) -> IndexTables:
    """Parse a page and check its tables.

    Parameters
    ----------
    data : bytes
        Bytes of the page, whose CRC was checked.
    where : str
        Name of the page in messages.
    most_pages : int
        Maximum number of pages that the page may list.

    Raises
    ------
    FormatError
        ``msgpack-``…; the codes of `parse_segments`.
    UnsupportedError
        The codes of `parse_segments`.
    """
    page = CheckedMap(canonical_msgpack.unpack(data, where), where, "5.6")
    pages = parse_pages(page, where, most_pages)
    segments = parse_segments(page.pop("segments", dict), where)
    chunks = parse_chunks(page.pop("chunks", dict), where)
    page.finish()
    return IndexTables(segments, chunks, pages)
