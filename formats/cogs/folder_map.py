"""Map from byte ranges of a file to its folder's manifest and objects (SPEC 3.4).

Nothing is read here: folders on disk, over HTTP and in object stores share this module.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from dataclasses import dataclass, replace
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


MAX_MANIFEST_BYTES: Final = layout.FIRST_READ
"""Maximum length of a manifest, bytes: one request reads it whole (SPEC 3.4)."""


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
    data : bytes, optional
        Bytes of the range where the map has them: of the manifest, and of the pages added.
    """

    name: str
    offset: int
    length: int
    object_bytes: int
    data: bytes | None = None

    def part(self, first: int, end: int) -> ObjectRange:
        """Return the part of the range from `first` to before `end`, counted from its start."""
        data = None if self.data is None else self.data[first:end]
        return ObjectRange(self.name, self.offset + first, end - first, self.object_bytes, data)


@dataclass(frozen=True, eq=False)
class PlacedSegments:
    """Segments of one index that objects hold.

    Parameters
    ----------
    offsets : (s,) int64
        Offset of each segment in the file, bytes.
    hashes : (s, 16) uint8
        First 16 bytes of each segment's SHA-256.
    places : PlaceTable
        Object and offset of each segment.
    """

    offsets: NDArray[np.int64]
    hashes: NDArray[np.uint8]
    places: PlaceTable


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
    manifest : bytes
        Whole manifest; further bytes are ignored.
    name : str
        Name of the manifest in messages.

    Attributes
    ----------
    file_length : int
        Length of the file, bytes.
    manifest_bytes : int
        Length of the manifest, bytes.
    root_end : int
        End of the root in the file and in the manifest, byte offset.

    Raises
    ------
    FormatError, TruncatedError, UnsupportedError
        The errors of `file_preamble`; ``root-truncated``, ``root-crc``, ``file-truncated``,
        ``places-crc``, ``places-range``; the codes of SPEC 4 and 5 for the root.
    """

    def __init__(self, manifest: bytes, name: str) -> None:
        self.name = name
        preamble = file_preamble(manifest, name)
        stated = layout.unpack_preamble(preamble, name)
        self.file_length = stated.file_length
        self.root_end = layout.PREAMBLE_BYTES + stated.root_length
        if len(manifest) < self.root_end:
            raise TruncatedError(
                "root-truncated",
                f"{name}: {len(manifest)} bytes, expected a root up to byte {self.root_end}",
                clause="3.4",
                needed=self.root_end,
            )
        data = manifest[layout.PREAMBLE_BYTES : self.root_end]
        if zlib.crc32(data) != stated.root_crc:
            raise FormatError(
                "root-crc",
                f"{name}: the root's CRC does not match",
                clause="3.4",
                offset=layout.PREAMBLE_BYTES,
            )
        where = f"{name}: root"
        self._root = cogs_root.parse_root(canonical_msgpack.unpack(data, where), where)
        table, pages = self._root.segments, self._root.pages
        places_end = self.root_end + places_bytes(len(table) + len(pages))
        if len(manifest) < places_end:
            raise self._truncated_error(len(manifest), places_end)
        # The table of the root also has the places of the pages, each with its own table behind it.
        page_lengths = [page.length + places_bytes(page.segments) for page in pages]
        lengths = np.concatenate([table.length.astype(np.int64), np.array(page_lengths, np.int64)])
        places = unpack_places(manifest[self.root_end : places_end], lengths, where, len(table))
        inside = places.sizes[: len(table)] == 0
        self.manifest_bytes = places_end + int(lengths[: len(table)][inside].sum())
        if self.manifest_bytes > MAX_MANIFEST_BYTES:
            raise FormatError(
                "places-range",
                f"{name}: a manifest of {self.manifest_bytes} bytes, expected at most "
                f"{MAX_MANIFEST_BYTES}",
                clause="3.4",
                offset=places_end,
            )
        if len(manifest) < self.manifest_bytes:
            raise self._truncated_error(len(manifest), self.manifest_bytes)
        self._extents = index_extents(self.root_end, self._root)
        self._starts = [extent.start for extent in self._extents]
        whole = preamble + manifest[layout.PREAMBLE_BYTES : self.manifest_bytes]
        self._manifest = ObjectRange("", 0, len(whole), len(whole), whole)
        self._page_places = places.rows(slice(len(table), None))
        self._page_lengths = page_lengths
        # Each index that is known, with its segments: the root has number 0, page i number i + 1.
        first = _Segments(
            table,
            places.rows(slice(len(table))),
            self._extents[0].index_end,
            self._manifest.part(places_end, len(whole)),
        )
        self._indexes = {0: (self._manifest.part(0, self.root_end), first)}

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

    def pages_for(self, offset: int, length: int) -> list[int]:
        """Return the pages to add before `object_ranges` can map a range of the file."""
        return [
            number - 1 for number, _ in self._within(offset, length) if number not in self._indexes
        ]

    def page_range(self, page: int) -> ObjectRange:
        """Return the range of a page and its table of places."""
        return _placed_range(self._page_places, page, 0, self._page_lengths[page])

    def add_page(self, page: int, data: bytes) -> None:
        """Add an index page and its table of places, which gives each segment's object and offset.

        Parameters
        ----------
        page : int
            Page number.
        data : bytes
            Bytes of `page_range`.

        Raises
        ------
        FormatError, UnsupportedError
            ``page-crc``, ``page-entry``, ``places-crc``, ``places-range``; the codes of SPEC 5 for
            a page.
        """
        where = f"{self.name}: index page {page}"
        entry = self._root.pages[page]
        index = data[: entry.length]
        extent = self._extents[page + 1]
        if zlib.crc32(index) != entry.crc:
            raise FormatError(
                "page-crc", f"{where}: its CRC does not match", clause="5.6", offset=extent.start
            )
        table, _ = cogs_root.parse_page(canonical_msgpack.unpack(index, where), entry, where)
        places = unpack_places(data[entry.length :], table.length.astype(np.int64), where)
        stored = replace(self.page_range(page), data=data).part(0, entry.length)
        self._indexes[page + 1] = stored, _Segments(table, places, extent.index_end)

    def placed_segments(self) -> list[PlacedSegments]:
        """Return the segments of the root, then of each page, that objects hold.

        All pages must have been added.
        """
        return [self._indexes[number][1].placed() for number in range(len(self._extents))]

    def page_objects(self) -> dict[str, int]:
        """Return the offset in the file of the first page in each object of pages, by name."""
        found: dict[str, int] = {}
        for page, extent in enumerate(self._extents[1:]):
            found.setdefault(self.page_range(page).name, extent.start)
        return found

    def objects(self) -> dict[str, int]:
        """Return the length of each object by name, bytes, after all pages were added."""
        tables = [self._page_places, *(segments.places for segments in self.placed_segments())]
        return {
            object_name(key.tobytes()): int(size)
            for table in tables
            for key, size in zip(table.objects, table.sizes, strict=True)
        }

    def object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return the ranges of manifest and objects that make up a range of the file, in order.

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
            index, segments = self._indexes[number]
            first, last = max(offset, extent.start), min(end, extent.index_end)
            if first < last:
                found.append(index.part(first - extent.start, last - extent.start))
            first, last = max(offset, extent.index_end), min(end, extent.end)
            if first < last:
                found += segments.object_ranges(first, last)
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
    """Segments of one index with their positions in the file, in objects and in the manifest.

    Parameters
    ----------
    table : SegmentTable
        Segments of the index.
    places : PlaceTable
        Their places; a segment with an object of size 0 is in the manifest.
    start : int
        Offset of the first segment in the file, bytes.
    inside : ObjectRange, optional
        Range of the manifest with its segments, one behind the other.
    """

    def __init__(
        self,
        table: SegmentTable,
        places: PlaceTable,
        start: int,
        inside: ObjectRange | None = None,
    ) -> None:
        self._table, self._places, self._inside = table, places, inside
        self._lengths: NDArray[np.int64] = table.length.astype(np.int64)
        self._ends: NDArray[np.int64] = start + np.cumsum(self._lengths)
        in_manifest = np.where(places.sizes == 0, self._lengths, 0)
        # Offset of each segment within `inside`, bytes; unused for segments in objects.
        self._inside_offsets = np.cumsum(in_manifest) - in_manifest

    def placed(self) -> PlacedSegments:
        """Return the segments that objects hold."""
        rows = np.flatnonzero(self._places.sizes)
        starts = self._ends[rows] - self._lengths[rows]
        return PlacedSegments(starts, self._table.hash[rows], self._places.rows(rows))

    def object_ranges(self, first: int, last: int) -> list[ObjectRange]:
        """Return the object ranges with the bytes of the file from `first` to before `last`."""
        found = []
        row = int(np.searchsorted(self._ends, first, side="right"))
        while first < last:
            start = int(self._ends[row] - self._lengths[row])
            stop = min(int(self._ends[row]), last)
            if self._inside is not None and not self._places.sizes[row]:
                at = int(self._inside_offsets[row]) - start
                found.append(self._inside.part(at + first, at + stop))
            else:
                found.append(_placed_range(self._places, row, first - start, stop - start))
            first, row = stop, row + 1
        return found


def _placed_range(places: PlaceTable, row: int, first: int, end: int) -> ObjectRange:
    """Return the bytes from `first` to before `end` of a segment or page in its object."""
    name = object_name(places.objects[row].tobytes())
    offset = int(places.offsets[row]) + first
    return ObjectRange(name, offset, end - first, int(places.sizes[row]))
