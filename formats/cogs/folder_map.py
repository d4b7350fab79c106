"""Map from byte ranges of a file to its folder's manifest and objects (SPEC 3.4).

Nothing is read here: folders on disk, over HTTP and in object stores share this module.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.formats.storage.magic import MANIFEST_MAGIC, describe

from . import canonical_msgpack, layout
from . import root as cogs_root
from .folder_places import PlaceTable, object_name, places_bytes, unpack_places
from .root import Root, SegmentTable

MANIFEST_NAME: Final = "manifest.cogsm"
"""Default file name of a manifest."""

MANIFEST_SUFFIX: Final = ".cogsm"


@dataclass(frozen=True)
class ObjectRange:
    """Byte range of one object of a folder, or of its manifest.

    Parameters
    ----------
    name : str
        Path of the object relative to the manifest's folder; empty for the manifest.
    offset, length : int
        Range within the object, bytes.
    object_bytes : int
        Length of the object, bytes.
    """

    name: str
    offset: int
    length: int
    object_bytes: int


@dataclass(frozen=True)
class PageRange:
    """Byte range of an index page and its table of places within the manifest.

    Parameters
    ----------
    page : int
        Page number.
    offset, length : int
        Range within the manifest, bytes.
    """

    page: int
    offset: int
    length: int


@dataclass(frozen=True)
class IndexExtent:
    """Byte offsets, in the file, of one index (root or page) and of the segments that it lists.

    Parameters
    ----------
    start : int
        Byte offset of the index; 0 for the root, which includes the preamble.
    index_end : int
        Byte offset of the end of the index, where its first segment begins.
    end : int
        Byte offset behind its last segment.
    """

    start: int
    index_end: int
    end: int


def is_manifest(head: bytes) -> bool:
    """Whether a file with the first bytes `head` is a manifest."""
    return head.startswith(MANIFEST_MAGIC)


def index_extents(root_end: int, root: Root) -> list[IndexExtent]:
    """Return the extents of the root and of each page in the file (SPEC 5.1, 5.6)."""
    end = root_end + int(root.segments.length.sum(dtype=np.uint64))
    found = [IndexExtent(0, root_end, end)]
    for page in root.pages:
        start = end
        end = start + page.length + page.span
        found.append(IndexExtent(start, start + page.length, end))
    return found


def with_magic(preamble: bytes, magic: bytes) -> bytes:
    """Return a preamble with another magic and a matching CRC."""
    head = magic + preamble[len(magic) : layout.PREAMBLE_BYTES - 4]
    return head + struct.pack("<I", zlib.crc32(head))


def file_preamble(manifest_head: bytes, name: str) -> bytes:
    """Return the preamble of the file that a manifest stands for.

    Parameters
    ----------
    manifest_head : bytes
        First bytes of the manifest, at least 64.
    name : str
        Name of the manifest in messages.

    Raises
    ------
    FormatError
        ``not-cogs``: another magic; ``preamble-crc``, ``preamble-reserved``, ``root-length``,
        ``file-length``.
    TruncatedError
        ``preamble-truncated``.
    UnsupportedError
        ``version-major``, ``version-minor``.
    """
    head = manifest_head[: layout.PREAMBLE_BYTES]
    if head[: len(MANIFEST_MAGIC)] != MANIFEST_MAGIC[: len(head)]:
        raise FormatError(
            "not-cogs",
            f"{name}: is {describe(head)}, expected the manifest of a COGS folder",
            clause="3.4",
            offset=0,
        )
    if len(head) < layout.PREAMBLE_BYTES:
        raise TruncatedError(
            "preamble-truncated",
            f"{name}: ends after {len(head)} bytes, expected a preamble of {layout.PREAMBLE_BYTES}",
            clause="3.4",
            offset=0,
            needed=layout.PREAMBLE_BYTES,
        )
    (crc,) = struct.unpack_from("<I", head, layout.PREAMBLE_BYTES - 4)
    if zlib.crc32(head[:-4]) != crc:
        raise FormatError(
            "preamble-crc", f"{name}: the preamble's CRC does not match", clause="3.4", offset=60
        )
    preamble = with_magic(head, layout.MAGIC)
    # The other checks are those of a file's preamble.
    layout.unpack_preamble(preamble, name)
    return preamble


class FolderMap:
    """Map from byte ranges of a file to ranges of the objects of its folder.

    Parameters
    ----------
    manifest_head : bytes
        First bytes of the manifest, at least up to the end of the root's table of places; 64 KiB
        always suffice (SPEC 8.8).
    name : str
        Name of the manifest in messages.

    Attributes
    ----------
    preamble : bytes
        Preamble of the file, 64 bytes, which differs from the manifest's in magic and CRC.
    file_length : int
        Length of the file, bytes.
    manifest_bytes : int
        Length of the manifest, bytes.
    root_end : int
        End of the root in the file and in the manifest, byte offset.
    head_end : int
        End of the root's table of places in the manifest, byte offset.

    Raises
    ------
    FormatError, TruncatedError, UnsupportedError
        The errors of `file_preamble`; ``root-truncated``, ``root-crc``, ``file-truncated``,
        ``places-crc``, ``places-range``; the codes of SPEC 4 and 5 for the root.
    """

    def __init__(self, manifest_head: bytes, name: str) -> None:
        self.name = name
        self.preamble = file_preamble(manifest_head, name)
        stated = layout.unpack_preamble(self.preamble, name)
        self.file_length = stated.file_length
        self.root_end = layout.PREAMBLE_BYTES + stated.root_length
        if len(manifest_head) < self.root_end:
            raise TruncatedError(
                "root-truncated",
                f"{name}: {len(manifest_head)} bytes, expected a root up to byte {self.root_end}",
                clause="3.4",
                needed=self.root_end,
            )
        data = manifest_head[layout.PREAMBLE_BYTES : self.root_end]
        if zlib.crc32(data) != stated.root_crc:
            raise FormatError(
                "root-crc",
                f"{name}: the root's CRC does not match",
                clause="3.4",
                offset=layout.PREAMBLE_BYTES,
            )
        where = f"{name}: root"
        self._root = cogs_root.parse_root(canonical_msgpack.unpack(data, where), where)
        table = self._root.segments
        self.head_end = self.root_end + places_bytes(len(table))
        if len(manifest_head) < self.head_end:
            raise self._truncated_error(len(manifest_head), self.head_end)
        found = unpack_places(manifest_head[self.root_end : self.head_end], table.length, where)
        self._extents = index_extents(self.root_end, self._root)
        self._starts = [extent.start for extent in self._extents]
        pages = [page.length + places_bytes(page.segments) for page in self._root.pages]
        # Byte offset of each page in the manifest, then the end of the last page.
        self._page_offsets = list(accumulate(pages, initial=self.head_end))
        self._tables = {0: _Segments(table, found, self._extents[0].index_end)}

    @property
    def manifest_bytes(self) -> int:
        """Length of the manifest: preamble, root, pages and their tables of places; bytes."""
        return self._page_offsets[-1]

    def check_manifest_size(self, size: int) -> None:
        """Refuse a manifest whose length contradicts its root.

        Raises
        ------
        TruncatedError
            ``file-truncated``.
        FormatError
            ``file-trailing``.
        """
        if size < self.manifest_bytes:
            raise self._truncated_error(size, self.manifest_bytes)
        if size > self.manifest_bytes:
            raise FormatError(
                "file-trailing",
                f"{self.name}: {size} bytes, expected {self.manifest_bytes}",
                clause="3.4",
                offset=self.manifest_bytes,
            )

    def pages_for(self, offset: int, length: int) -> list[PageRange]:
        """Return the pages to add before `object_ranges` can map a range of the file."""
        return [
            self.page_range(number - 1)
            for number, extent in self._within(offset, length)
            if number not in self._tables and extent.index_end < offset + length
        ]

    def page_range(self, page: int) -> PageRange:
        """Return the range of a page and its table of places in the manifest."""
        start, end = self._page_offsets[page : page + 2]
        return PageRange(page, start, end - start)

    def page_at(self, offset: int) -> int | None:
        """Return the page at a byte offset of the manifest; None for the root and its places."""
        page = bisect_right(self._page_offsets, offset) - 1
        return None if page < 0 else page

    def has_page(self, page: int) -> bool:
        """Whether a page was added."""
        return page + 1 in self._tables

    def add_page(self, page: int, data: bytes) -> None:
        """Add an index page and its table of places, which gives each segment's object and offset.

        Parameters
        ----------
        page : int
            Page number.
        data : bytes
            Bytes of its range in the manifest; see `page_range`.

        Raises
        ------
        FormatError, UnsupportedError
            ``page-crc``, ``page-entry``, ``places-crc``, ``places-range``; the codes of SPEC 5 for
            a page.
        """
        where = f"{self.name}: index page {page}"
        entry = self._root.pages[page]
        index = data[: entry.length]
        if zlib.crc32(index) != entry.crc:
            raise FormatError(
                "page-crc",
                f"{where}: its CRC does not match",
                clause="5.6",
                offset=self._page_offsets[page],
            )
        table, _ = cogs_root.parse_page(canonical_msgpack.unpack(index, where), entry, where)
        found = unpack_places(data[entry.length :], table.length, where)
        self._tables[page + 1] = _Segments(table, found, self._extents[page + 1].index_end)

    def tables(self) -> list[tuple[SegmentTable, PlaceTable]]:
        """Return each index's segment table and table of places: the root, then all pages in order.

        All pages must have been added.
        """
        every = (self._tables[number] for number in range(len(self._extents)))
        return [(segments.table, segments.places) for segments in every]

    def objects(self) -> dict[str, int]:
        """Return the length of each object by name, bytes, after all pages were added."""
        return {
            object_name(key.tobytes()): int(size)
            for _, found in self.tables()
            for key, size in zip(found.objects, found.sizes, strict=True)
        }

    def object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return the ranges of manifest and objects that make up a range of the file, in order.

        The manifest's first 64 bytes stand for the file's: the caller replaces them by `preamble`.

        Parameters
        ----------
        offset, length : int
            Range of the file, bytes, after the pages of `pages_for` were added.

        Returns
        -------
        list of ObjectRange
            Ranges with a total length of `length`.

        Raises
        ------
        FormatError
            ``segments-length``: the segments end before the file does.
        """
        found: list[ObjectRange] = []
        end = offset + length
        if end > self._extents[-1].end:
            raise FormatError(
                "segments-length",
                f"{self.name}: index and segments end at byte {self._extents[-1].end}, expected "
                f"{self.file_length}",
                clause="5.1",
            )
        for number, extent in self._within(offset, length):
            first, last = max(offset, extent.start), min(end, extent.index_end)
            if first < last:
                at = first - extent.start + (self._page_offsets[number - 1] if number else 0)
                found.append(ObjectRange("", at, last - first, self.manifest_bytes))
            first, last = max(offset, extent.index_end), min(end, extent.end)
            if first < last:
                found += self._tables[number].object_ranges(first, last)
        return found

    def _truncated_error(self, size: int, expected: int) -> TruncatedError:
        """Return the error for a manifest that is too short."""
        return TruncatedError(
            "file-truncated",
            f"{self.name}: {size} bytes, expected {expected}",
            clause="3.4",
            offset=size,
            needed=expected,
        )

    def _within(self, offset: int, length: int) -> list[tuple[int, IndexExtent]]:
        """Return number and extent of each index that, with its segments, overlaps a range."""
        first = max(0, bisect_right(self._starts, offset) - 1)
        end = offset + length
        return [
            (number, extent)
            for number, extent in enumerate(self._extents[first:], start=first)
            if extent.start < end and extent.end > offset
        ]


class _Segments:
    """Segments of one index with their positions in the file and in objects."""

    def __init__(self, table: SegmentTable, found: PlaceTable, start: int) -> None:
        self.table, self.places = table, found
        self._lengths: NDArray[np.int64] = table.length.astype(np.int64)
        self._ends: NDArray[np.int64] = start + np.cumsum(self._lengths)

    def object_ranges(self, first: int, last: int) -> list[ObjectRange]:
        """Return the object ranges with the bytes of the file from `first` to before `last`."""
        found = []
        row = int(np.searchsorted(self._ends, first, side="right"))
        while first < last:
            start = int(self._ends[row] - self._lengths[row])
            stop = min(int(self._ends[row]), last)
            offset = int(self.places.offsets[row]) + first - start
            name = object_name(self.places.objects[row].tobytes())
            found.append(ObjectRange(name, offset, stop - first, int(self.places.sizes[row])))
            first, row = stop, row + 1
        return found
