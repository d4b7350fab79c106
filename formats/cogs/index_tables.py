"""Tables of an index, the root or a page: segments, chunks and further pages (SPEC 5.3 to 5.6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import UnsupportedError
from cogsplat.codec.metrics import PSNR_CAP_DB
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS

from . import canonical_msgpack, layout
from .canonical_msgpack import Value
from .msgpack_map import CheckedMap

HASH_BYTES: Final = 16
"""Bytes of a segment's SHA-256 that are stored (SPEC 5.3)."""


Rows = slice | Sequence[int] | NDArray[np.integer]
"""Rows of a table: a slice or numbers."""


@dataclass(frozen=True)
class Column:
    """How a file stores a column of a table.

    Parameters
    ----------
    dtype : str
        numpy type of the stored values; in memory, they have it in native byte order.
    width : int
        Values per row.
    is_optional : bool
        Whether a column of zeros is left out.
    """

    dtype: str
    width: int = 1
    is_optional: bool = False


U32 = Annotated[NDArray[np.uint32], Column("<u4")]
OptionalU32 = Annotated[NDArray[np.uint32], Column("<u4", is_optional=True)]
Boxes = Annotated[NDArray[np.float32], Column("<f4", width=6)]
F64 = Annotated[NDArray[np.float64], Column("<f8")]


@dataclass(frozen=True, eq=False)
class Table:
    """Arrays of equal length, one for each column of a table of an index.

    The fields of a derived dataclass are the columns, each annotated with its `Column`, in the
    order of SPEC, in which files have them.
    """

    COLUMNS: ClassVar[Mapping[str, Column]]

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True).items()
        cls.COLUMNS = {name: hint.__metadata__[0] for name, hint in hints if name != "COLUMNS"}

    def __len__(self) -> int:
        return len(getattr(self, next(iter(self.COLUMNS))))

    @classmethod
    def zeros(cls, rows: int) -> Self:
        """Return a table of zeros."""
        values = {}
        for name, column in cls.COLUMNS.items():
            shape = (rows, column.width) if column.width > 1 else rows
            values[name] = np.zeros(shape, np.dtype(column.dtype).newbyteorder("="))
        return cls(**values)

    @classmethod
    def parse(cls, fields: CheckedMap) -> Self:
        """Remove the columns from a map and return them; the first sets the number of rows.

        Raises
        ------
        FormatError
            ``root-missing``, ``root-type``, ``root-columns``.
        UnsupportedError
            ``root-must-understand``.
        """
        values: dict[str, NDArray[np.generic]] = {}
        rows = None
        for name, column in cls.COLUMNS.items():
            if column.is_optional and not fields.has(name):
                continue
            found = fields.column(name, column.dtype, rows, column.width)
            values[name] = found.astype(found.dtype.newbyteorder("="))
            rows = len(found)
        fields.finish()
        return replace(cls.zeros(rows or 0), **values)

    def columns(self) -> dict[str, Value]:
        """Return the table as msgpack columns; optional columns of zeros are left out."""
        return {
            name: column_bytes(getattr(self, name), column.dtype)
            for name, column in self.COLUMNS.items()
            if not column.is_optional or getattr(self, name).any()
        }

    def take(self, rows: Rows) -> Self:
        """Return some of the rows."""
        return type(self)(**{name: getattr(self, name)[rows] for name in self.COLUMNS})

    def put(self, rows: slice, table: Self) -> None:
        """Replace rows by those of another table."""
        for name in self.COLUMNS:
            getattr(self, name)[rows] = getattr(table, name)

    @classmethod
    def concatenate(cls, tables: Sequence[Self]) -> Self:
        """Return the rows of one or more tables behind each other."""
        return cls(
            **{name: np.concatenate([getattr(t, name) for t in tables]) for name in cls.COLUMNS}
        )


@dataclass(frozen=True, eq=False)
class SegmentTable(Table):
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

    kind: Annotated[NDArray[np.uint8], Column("u1")]
    owner: U32
    length: U32
    crc: U32
    hash: Annotated[NDArray[np.uint8], Column("u1", width=HASH_BYTES)]
    needs: U32


@dataclass(frozen=True, eq=False)
class ChunkTable(Table):
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
    box: Boxes
    contribution: F64
    layer: OptionalU32
    cell: OptionalU32
    object: OptionalU32
    quality: Annotated[NDArray[np.float32], Column("<f4", is_optional=True)]
    until: OptionalU32


@dataclass(frozen=True, eq=False)
class PageTable(Table):
    """Pages that an index lists, one row each; a row counts all that is below its page (SPEC 5.6).

    Parameters
    ----------
    length : (p,) uint32
        Length of the page, bytes.
    crc : (p,) uint32
        CRC-32 of the page.
    segments, chunks : (p,) uint32
        Numbers of segments and chunks below the page.
    span : (p,) uint64
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
    span: Annotated[NDArray[np.uint64], Column("<u8")]
    splats: U32
    box: Boxes
    contribution: F64
    cell: OptionalU32


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


def pack_page(tables: IndexTables) -> bytes:
    """Encode a page."""
    value: dict[str, Value] = {
        "segments": tables.segments.columns(),
        "chunks": tables.chunks.columns(),
    }
    if len(tables.pages):
        value["pages"] = tables.pages.columns()
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
    fields = CheckedMap(value, f"{where}, segments", "5.3")
    table = SegmentTable.parse(fields)
    kind = table.kind
    known = [int(k) for k in layout.SegmentKind]
    unknown = np.flatnonzero((kind < layout.SKIPPABLE_KIND) & ~np.isin(kind, known))
    if len(unknown):
        raise UnsupportedError(
            "segment-kind-unknown",
            f"{where}, segment {unknown[0]}: kind {kind[unknown[0]]}, expected {known} or "
            f"{layout.SKIPPABLE_KIND} and above (SPEC 5.2)",
        )
    if not table.length.all():
        raise fields.error("length", "a segment of 0 bytes, expected at least 1")
    return table


def parse_chunks(value: Value, where: str) -> ChunkTable:
    """Parse and check a chunk table; raises as `parse_segments`."""
    fields = CheckedMap(value, f"{where}, chunks", "5.4")
    table = ChunkTable.parse(fields)
    _check_range(fields, "splats", table.splats, 1, MAX_CHUNK_SPLATS)
    _check_boxes(fields, table)
    if not ((table.quality >= 0) & (table.quality <= PSNR_CAP_DB)).all():
        raise fields.error("quality", f"out of range, expected 0 to {PSNR_CAP_DB:g} dB")
    return table


def _check_range(
    fields: CheckedMap, name: str, column: NDArray[np.unsignedinteger], low: int, high: int
) -> None:
    """Refuse a column with a number out of range."""
    if len(column) and not low <= int(column.min()) <= int(column.max()) <= high:
        raise fields.error(
            name, f"{int(column.min())} to {int(column.max())} in a row, expected {low} to {high}"
        )


def _check_boxes(fields: CheckedMap, table: ChunkTable | PageTable) -> None:
    """Refuse boxes and contributions of chunks or pages that are out of range (SPEC 5.4)."""
    box, contribution = table.box, table.contribution
    if not (np.isfinite(box).all() and (box[:, :3] <= box[:, 3:]).all()):
        raise fields.error("box", "corners not finite or not ordered, expected minimum, maximum")
    if not (np.isfinite(contribution).all() and (contribution >= 0).all()):
        raise fields.error("contribution", "not finite or negative, expected 0 or more")


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
        return PageTable.zeros(0)
    fields = CheckedMap(index.pop("pages", dict), f"{where}, pages", "5.6")
    table = PageTable.parse(fields)
    if len(table) > most:
        raise fields.error("length", f"{len(table)} pages, expected at most {most}")
    _check_range(fields, "length", table.length, 1, layout.MAX_PAGE_BYTES)
    _check_range(fields, "segments", table.segments, 1, layout.MAX_SEGMENTS)
    if (table.chunks > table.segments).any():
        raise fields.error("chunks", "more chunks than segments below a page")
    _check_range(fields, "span", table.span, 1, layout.MAX_FILE_BYTES)
    _check_range(fields, "splats", table.splats, 0, layout.MAX_SPLATS)
    _check_boxes(fields, table)
    return table


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
