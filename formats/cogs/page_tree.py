"""Places of the indices of a file: the root, and below it the tree of pages (SPEC 5.1, 5.6)."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cogsplat.codec.errors import FormatError

from . import layout
from .index_tables import Extent, IndexTables, parse_page


@dataclass(frozen=True)
class PagePlace:
    """Place of a page, and what the index above it states.

    Parameters
    ----------
    path : tuple of int
        Row of the page in the index above, behind the path of that index; the root has no path.
    start : int
        Byte offset of the page.
    length, crc : int
        Length of the page, bytes, and its CRC-32.
    extent : Extent
        Sums over all that is below the page.
    first_segment, first_chunk : int
        Numbers of the first segment and chunk below the page.
    is_last_of_root : bool
        Whether the page is the last one that the root lists, which lists the pictures.
    """

    path: tuple[int, ...]
    start: int
    length: int
    crc: int
    extent: Extent
    first_segment: int
    first_chunk: int
    is_last_of_root: bool

    @property
    def end(self) -> int:
        """Byte offset behind all that is below the page."""
        return self.start + self.length + self.extent.span

    def holds_chunk(self, chunk: int) -> bool:
        """Whether a chunk is below the page."""
        return self.first_chunk <= chunk < self.first_chunk + self.extent.chunks


@dataclass(frozen=True, eq=False)
class Index:
    """Index that was read, in its place.

    Parameters
    ----------
    path : tuple of int
        Rows of the pages on the way from the root; empty for the root.
    start, end : int
        Byte offsets of the index, 0 for the root, and of its end, where its segments begin.
    first_segment, first_chunk : int
        Numbers of its first segment and chunk.
    tables : IndexTables
        Segments, chunks and pages of the index.
    lists_pictures : bool
        Whether the index may list pictures.
    """

    path: tuple[int, ...]
    start: int
    end: int
    first_segment: int
    first_chunk: int
    tables: IndexTables
    lists_pictures: bool

    @property
    def segments_end(self) -> int:
        """Byte offset behind the segments of the index, where its first page begins."""
        return self.end + self.tables.segment_bytes

    def pages(self) -> list[PagePlace]:
        """Return the places of the pages that the index lists."""
        table = self.tables.pages
        start = self.segments_end
        segment = self.first_segment + len(self.tables.segments)
        chunk = self.first_chunk + len(self.tables.chunks)
        found = []
        for row in range(len(table)):
            extent = Extent(
                segments=int(table.segments[row]),
                chunks=int(table.chunks[row]),
                span=int(table.span[row]),
                splats=int(table.splats[row]),
            )
            place = PagePlace(
                (*self.path, row),
                start,
                int(table.length[row]),
                int(table.crc[row]),
                extent,
                segment,
                chunk,
                is_last_of_root=not self.path and row == len(table) - 1,
            )
            found.append(place)
            start, segment = place.end, segment + extent.segments
            chunk += extent.chunks
        return found


def root_index(tables: IndexTables, root_end: int) -> Index:
    """Return the root in its place.

    Parameters
    ----------
    tables : IndexTables
        Tables of the root.
    root_end : int
        Byte offset of the end of the root.
    """
    return Index((), 0, root_end, 0, 0, tables, lists_pictures=not len(tables.pages))


def page_name(place: PagePlace) -> str:
    """Return the name of a page in messages: the rows on the way to it, such as ``page 3.0``."""
    return "page " + ".".join(map(str, place.path))


def read_page(place: PagePlace, data: bytes, where: str) -> Index:
    """Check the bytes of a page against its row in the index above, and parse it.

    Parameters
    ----------
    place : PagePlace
        Place of the page.
    data : bytes
        Bytes of the page.
    where : str
        Name of the file in messages.

    Raises
    ------
    FormatError
        ``page-crc``, ``page-entry``; the codes of `parse_page`.
    UnsupportedError
        The codes of `parse_page`.
    """
    where = f"{where}: {page_name(place)}"
    if zlib.crc32(data) != place.crc:
        raise FormatError(
            "page-crc",
            f"{where}: its CRC does not match, expected {place.crc:#010x}",
            clause="5.6",
            offset=place.start,
        )
    depth = len(place.path)
    tables = parse_page(data, where, layout.MAX_PAGES if depth < layout.MAX_PAGE_DEPTH else 0)
    if tables.extent != place.extent:
        raise FormatError(
            "page-entry",
            f"{where}: {tables.extent}, expected {place.extent} as the index above states",
            clause="5.6",
            offset=place.start,
        )
    return Index(
        place.path,
        place.start,
        place.start + place.length,
        place.first_segment,
        place.first_chunk,
        tables,
        lists_pictures=place.is_last_of_root,
    )


def in_file_order(indices: Iterable[Index]) -> Sequence[Index]:
    """Return indices by their place in the file, which is depth first."""
    return sorted(indices, key=lambda index: index.start)
