"""Map from byte ranges of a file to its folder's manifest and objects (SPEC 3.4).

Nothing is read here: folders on disk, over HTTP and in object stores share this module.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.formats.storage.magic import MANIFEST_MAGIC, describe

from . import canonical_msgpack, layout
from . import root as cogs_root
from .folder_places import PlaceTable, object_name, places_bytes, unpack_places
from .index_tables import SegmentTable
from .page_tree import Index, PagePlace, page_name, read_page, root_index

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


def is_manifest(head: bytes) -> bool:
    """Whether a file with the first bytes `head` is a manifest."""
    return head.startswith(MANIFEST_MAGIC)


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
        root = cogs_root.parse_root(canonical_msgpack.unpack(data, where), where)
        index = root_index(root.tables, self.root_end)
        own = len(root.segments)
        places_end = self.root_end + places_bytes(own + len(root.pages))
        if len(manifest) < places_end:
            raise self._truncated_error(len(manifest), places_end)
        lengths = _lengths(index)
        places = unpack_places(manifest[self.root_end : places_end], lengths, where, own)
        inside = places.sizes[:own] == 0
        self.manifest_bytes = places_end + int(lengths[:own][inside].sum())
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
        whole = preamble + manifest[layout.PREAMBLE_BYTES : self.manifest_bytes]
        self._manifest = ObjectRange("", 0, len(whole), len(whole), whole)
        # Parts of the file, in its order: indices that are known, and pages that are not.
        self._parts: list[_KnownIndex | _UnknownPage] = []
        self._page_objects: dict[str, int] = {}
        self._sizes: dict[str, int] = {}
        self._add_index(
            0,
            index,
            self._manifest.part(0, self.root_end),
            places,
            self._manifest.part(places_end, len(whole)),
        )
        if self._parts[-1].end != self.file_length:
            raise FormatError(
                "segments-length",
                f"{name}: index and segments end at byte {self._parts[-1].end}, expected "
                f"{self.file_length}",
                clause="5.1",
            )

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

    def pages_for(self, offset: int, length: int) -> list[PagePlace]:
        """Return the pages to add before `object_ranges` can map a range of the file.

        Pages below them are not known yet: the list is empty when all were added.
        """
        parts = self._within(offset, length)
        return [part.page for part in parts if isinstance(part, _UnknownPage)]

    def page_range(self, page: PagePlace) -> ObjectRange:
        """Return a range of the object of an unknown page with the page and its table of places.

        Only the page states the length of its table, so the range has room for the longest one, up
        to the end of the object.
        """
        at = self._number_of(page)
        part = self._parts[at]
        assert isinstance(part, _UnknownPage)
        most = page.length + places_bytes(page.extent.segments + layout.MAX_PAGES)
        return part.stored.part(0, min(most, part.stored.object_bytes - part.stored.offset))

    def add_page(self, page: PagePlace, data: bytes) -> None:
        """Add a page and its table of places, which gives each segment's object and offset.

        Parameters
        ----------
        page : PagePlace
            Page of `pages_for`.
        data : bytes
            Bytes of `page_range`.

        Raises
        ------
        FormatError, UnsupportedError
            ``page-crc``, ``page-entry``, ``places-crc``, ``places-range``; the codes of SPEC 5 for
            a page.
        """
        where = f"{self.name}: {page_name(page)}"
        index = read_page(page, data[: page.length], self.name)
        at = self._number_of(page)
        lengths = _lengths(index)
        end = page.length + places_bytes(len(lengths))
        if len(data) < end:
            raise FormatError(
                "places-range",
                f"{where}: its table of places ends {end - len(data)} bytes behind its object",
                clause="3.4",
            )
        places = unpack_places(data[page.length : end], lengths, where)
        part = self._parts[at]
        assert isinstance(part, _UnknownPage)
        stored = replace(part.stored, length=len(data), data=data).part(0, page.length)
        self._add_index(at, index, stored, places)

    def _add_index(
        self,
        at: int,
        index: Index,
        stored: ObjectRange,
        places: PlaceTable,
        inside: ObjectRange | None = None,
    ) -> None:
        """Put an index, and the pages that it lists, in the place of its part."""
        own = len(index.tables.segments)
        segments = _Segments(index.tables.segments, places.rows(slice(own)), index.end, inside)
        pages = [
            _UnknownPage(page, _placed_range(places, own + row, 0, page.length))
            for row, page in enumerate(index.pages())
        ]
        self._parts[at : at + 1] = [_KnownIndex(index, stored, segments), *pages]
        self._starts = [part.start for part in self._parts]
        for page in pages:
            first = self._page_objects.setdefault(page.stored.name, page.start)
            self._page_objects[page.stored.name] = min(first, page.start)
            self._sizes[page.stored.name] = page.stored.object_bytes

    def _number_of(self, page: PagePlace) -> int:
        """Return the number of a page's part."""
        return bisect_right(self._starts, page.start) - 1

    def placed_segments(self) -> list[PlacedSegments]:
        """Return the segments of the root, then of each page, that objects hold.

        All pages must have been added.
        """
        return [part.segments.placed() for part in self._parts if isinstance(part, _KnownIndex)]

    def page_objects(self) -> dict[str, int]:
        """Return the offset in the file of the first page in each object of pages, by name."""
        return self._page_objects

    def objects(self) -> dict[str, int]:
        """Return the length of each object by name, bytes, after all pages were added."""
        found = dict(self._sizes)
        for segments in self.placed_segments():
            for key, size in zip(segments.places.objects, segments.places.sizes, strict=True):
                found[object_name(key.tobytes())] = int(size)
        return found

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
        """
        found: list[ObjectRange] = []
        end = offset + length
        for part in self._within(offset, length):
            assert isinstance(part, _KnownIndex)
            index = part.index
            first, last = max(offset, index.start), min(end, index.end)
            if first < last:
                found.append(part.stored.part(first - index.start, last - index.start))
            first, last = max(offset, index.end), min(end, part.end)
            if first < last:
                found += part.segments.object_ranges(first, last)
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

    def _within(self, offset: int, length: int) -> list[_KnownIndex | _UnknownPage]:
        """Return the parts that overlap a range of the file, in order."""
        first = max(0, bisect_right(self._starts, offset) - 1)
        last = bisect_left(self._starts, offset + length)
        return [part for part in self._parts[first:last] if part.end > offset]


@dataclass(frozen=True, eq=False)
class _UnknownPage:
    """Part of a file: a page that was not added, with all that is below it.

    Parameters
    ----------
    page : PagePlace
        Place of the page in the file.
    stored : ObjectRange
        Range of the page in its object.
    """

    page: PagePlace
    stored: ObjectRange

    @property
    def start(self) -> int:
        """Byte offset of the page in the file."""
        return self.page.start

    @property
    def end(self) -> int:
        """Byte offset behind all that is below the page."""
        return self.page.end


@dataclass(frozen=True, eq=False)
class _KnownIndex:
    """Part of a file: an index and the segments that it lists.

    Parameters
    ----------
    index : Index
        Index in its place in the file.
    stored : ObjectRange
        Range of the index in the manifest or its object, with its bytes.
    segments : _Segments
        Places of its segments.
    """

    index: Index
    stored: ObjectRange
    segments: _Segments

    @property
    def start(self) -> int:
        """Byte offset of the index in the file."""
        return self.index.start

    @property
    def end(self) -> int:
        """Byte offset behind the segments of the index."""
        return self.index.segments_end


def _lengths(index: Index) -> NDArray[np.int64]:
    """Return the lengths of the segments and then of the pages of an index, bytes."""
    tables = index.tables
    return np.concatenate([tables.segments.length, tables.pages.length]).astype(np.int64)


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
