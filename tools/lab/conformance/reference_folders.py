"""Conversion between files and folders in the reference decoder, written from SPEC 3.4 alone.

It uses no folder code of `formats`, so that tests can compare the two.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgpack

from cogsplat.formats.cogs.layout import MAGIC

from .file_builder import PREAMBLE_BYTES, seal

MANIFEST: Final = "manifest.cogsm"
MANIFEST_MAGIC: Final = b"\x89COGM\r\n\x1a"

# Segment kinds of codebooks, kinds whose owner is a chunk, and the description (SPEC 5.2).
_CODEBOOKS: Final = (3, 4, 5, 6)
_OF_CHUNKS: Final = (1, 2, 7, 8, 129)
_DESCRIPTION: Final = 132

# Longest segment that the manifest holds, bytes.
_MOST_INSIDE: Final = 16384

Objects = dict[str, bytes]
"""Contents of a folder's files by path relative to the folder."""

Placement = tuple[bytes, int, int]
"""Location of a segment or page: key of its object, size of the object, and offset in it, bytes."""

INSIDE: Final[Placement] = (bytes(16), 0, 0)
"""Placement of a segment in the manifest itself."""


def folder_of_file(
    data: bytes, manifest: str = MANIFEST, *, inside: Container[int] = (_DESCRIPTION,)
) -> Objects:
    """Convert a file into a folder, with the segments grouped as SPEC 3.4 recommends.

    Parameters
    ----------
    data : bytes
        The file.
    manifest : str
        Name of the manifest.
    inside : container of int
        Kinds of the root's segments that the manifest holds, where they are short.
    """
    indexes = _read_indexes(data)
    groups: dict[tuple[object, ...], list[_Segment]] = {}
    where = {
        x.position: INSIDE
        for x in indexes[0].segments
        if x.kind in inside and x.length <= _MOST_INSIDE
    }
    for segment in (segment for index in indexes for segment in index.segments):
        key: tuple[object, ...] = ("alone", segment.position)
        if segment.kind in _CODEBOOKS:
            key = ("codebooks",)
        elif segment.kind in _OF_CHUNKS:
            key = ("chunk", segment.owner)
        if segment.position not in where:
            groups.setdefault(key, []).append(segment)
    objects: Objects = {}
    for group in groups.values():
        content = b"".join(data[x.position : x.position + x.length] for x in group)
        offset = 0
        for segment in group:
            where[segment.position] = object_key(content), len(content), offset
            offset += segment.length
        objects[object_name(content)] = content
    rows: dict[int, Placement] = {}
    # Pages below an index come before it: its table has their places.
    for index in reversed(indexes[1:]):
        page = index.stored + _table_of(index, where, rows)
        objects[object_name(page)] = page
        rows[index.position] = object_key(page), len(page), 0
    return {manifest: _build_manifest(data, indexes[0], where, rows), **objects}


def one_object_folder(data: bytes, around: bytes) -> Objects:
    """Convert a file into a folder that keeps all segments in one object, all pages in another.

    Both are in reverse order; the bytes `around` precede, separate and follow them.
    """
    indexes = _read_indexes(data)
    stored = [data[x.position : x.position + x.length] for index in indexes for x in index.segments]
    positions = [x.position for index in indexes for x in index.segments]
    content, found = _backwards(stored, around)
    where = dict(zip(positions, found, strict=True))
    # The file has no pages of pages, which one object cannot hold: tables name it by its hash.
    pages = [index.stored + _table_of(index, where, {}) for index in indexes[1:]]
    book, placed = _backwards(pages, around)
    rows = dict(zip((index.position for index in indexes[1:]), placed, strict=True))
    return {
        MANIFEST: _build_manifest(data, indexes[0], where, rows),
        object_name(content): content,
        object_name(book): book,
    }


def _backwards(parts: Sequence[bytes], around: bytes) -> tuple[bytes, list[Placement]]:
    """Return an object of parts in reverse order, and the placement of each part."""
    content, offsets = around, []
    for part in reversed(parts):
        offsets.append(len(content))
        content += part + around
    return content, [(object_key(content), len(content), offset) for offset in reversed(offsets)]


def file_of_folder(objects: Mapping[str, bytes], manifest: str = MANIFEST) -> bytes:
    """Convert a folder into the equivalent file."""
    data = objects[manifest]
    root_end, root = read_root(data)
    pages = read_pages(root)
    segments = read_segments(root, 0)
    places_end = root_end + _placement_bytes(len(segments) + len(pages))
    rows = read_places(data[root_end:places_end], len(segments) + len(pages))
    parts, inside = [data[:root_end]], places_end
    for segment, row in zip(segments, rows, strict=False):
        if row == INSIDE:
            parts.append(data[inside : inside + segment.length])
            inside += segment.length
        else:
            parts.append(objects[object_path(row[0])][row[2] :][: segment.length])
    parts += _parts_of_pages(objects, pages, rows[len(segments) :])
    return replace_magic(b"".join(parts), MAGIC)


def _parts_of_pages(
    objects: Mapping[str, bytes], pages: Sequence[int], rows: Sequence[Placement]
) -> Iterator[bytes]:
    """Yield the bytes of pages, given their lengths and placements, each with all below it."""
    for length, (key, _, offset) in zip(pages, rows, strict=True):
        stored = objects[object_path(key)][offset:]
        yield stored[:length]
        index = msgpack.unpackb(stored[:length])
        segments, below = read_segments(index, 0), read_pages(index)
        places = read_places(stored[length:], len(segments) + len(below))
        for segment, (name, _, at) in zip(segments, places, strict=False):
            yield objects[object_path(name)][at : at + segment.length]
        yield from _parts_of_pages(objects, below, places[len(segments) :])


@dataclass(frozen=True)
class _Segment:
    """Row of a segment table; `position` is the offset of the segment in the file, bytes."""

    kind: int
    owner: int
    length: int
    position: int


@dataclass(frozen=True)
class _Index:
    """Bytes of a page, or of preamble and root, its offset, and what it lists.

    Segments, and offsets of pages in the file, bytes.
    """

    stored: bytes
    position: int
    segments: list[_Segment]
    pages: list[int]


def _read_indexes(data: bytes) -> list[_Index]:
    """Return root and pages of a file with the segments that each lists."""
    root_end, root = read_root(data)
    return _add_indexes(data, root, 0, root_end)


def _add_indexes(data: bytes, index: Mapping[str, object], start: int, end: int) -> list[_Index]:
    """Return an index, given where it begins and ends, and all indices below it in file order."""
    segments = read_segments(index, end)
    position = end + sum(segment.length for segment in segments)
    starts: list[int] = []
    below: list[_Index] = []
    for length in read_pages(index):
        starts.append(position)
        page = msgpack.unpackb(data[position : position + length])
        found = _add_indexes(data, page, position, position + length)
        below += found
        last = found[-1]
        position = last.position + len(last.stored) + sum(x.length for x in last.segments)
    return [_Index(data[start:end], start, segments, starts), *below]


def read_pages(index: Mapping[str, object]) -> list[int]:
    """Return the lengths of the pages that an index lists, bytes."""
    pages = index.get("pages")
    lengths = pages["length"] if isinstance(pages, dict) else b""
    return [length for (length,) in struct.iter_unpack("<I", lengths)]


def _table_of(
    index: _Index, where: Mapping[int, Placement], pages: Mapping[int, Placement]
) -> bytes:
    """Return the packed placement table of an index.

    Parameters
    ----------
    index : _Index
    where, pages : mapping of int to Placement
        Placement of each segment, and of each page, by its offset in the file.
    """
    return placement_table(
        [
            *(where[segment.position] for segment in index.segments),
            *(pages[at] for at in index.pages),
        ]
    )


def _build_manifest(
    data: bytes, root: _Index, where: Mapping[int, Placement], pages: Mapping[int, Placement]
) -> bytes:
    """Return a folder's manifest: preamble, root, placement table, and the segments inside.

    Parameters
    ----------
    data : bytes
        The file.
    root : _Index
        Root of the file.
    where : mapping of int to Placement
        Placement of each segment by its offset in the file.
    pages : mapping of int to Placement
        Placement of each page by its offset in the file.
    """
    rows = [where[segment.position] for segment in root.segments]
    inside = (x.position for x, row in zip(root.segments, rows, strict=True) if row == INSIDE)
    lengths = {segment.position: segment.length for segment in root.segments}
    stored = root.stored + _table_of(root, where, pages)
    stored += b"".join(data[at : at + lengths[at]] for at in inside)
    return replace_magic(stored, MANIFEST_MAGIC)


def placement_table(rows: Sequence[Placement]) -> bytes:
    """Return the packed placement table of segments, with its CRC (SPEC 3.4)."""
    columns = b"".join(key for key, _, _ in rows)
    columns += struct.pack(f"<{len(rows)}I", *(size for _, size, _ in rows))
    columns += struct.pack(f"<{len(rows)}I", *(offset for _, _, offset in rows))
    return columns + struct.pack("<I", zlib.crc32(columns))


def _placement_bytes(rows: int) -> int:
    """Return the size of a placement table, bytes."""
    return 24 * rows + 4


def read_places(data: bytes, count: int) -> list[Placement]:
    """Return the rows of a placement table."""
    keys = [data[16 * row :][:16] for row in range(count)]
    sizes = struct.unpack_from(f"<{count}I", data, 16 * count)
    offsets = struct.unpack_from(f"<{count}I", data, 20 * count)
    return list(zip(keys, sizes, offsets, strict=True))


def read_root(data: bytes) -> tuple[int, dict[str, dict[str, bytes]]]:
    """Return the end of a file's root, bytes, and the root unpacked from msgpack."""
    (length,) = struct.unpack_from("<I", data, 12)
    return PREAMBLE_BYTES + length, msgpack.unpackb(data[PREAMBLE_BYTES : PREAMBLE_BYTES + length])


def read_segments(index: Mapping[str, object], position: int) -> list[_Segment]:
    """Return the segments of an index whose first payload is at `position`."""
    table = index["segments"]
    assert isinstance(table, dict)
    found = []
    columns = (table["kind"], struct.iter_unpack("<I", table["owner"]))
    for kind, (owner,), (length,) in zip(
        *columns, struct.iter_unpack("<I", table["length"]), strict=True
    ):
        found.append(_Segment(kind, owner, length, position))
        position += length
    return found


def object_key(content: bytes) -> bytes:
    """Return the key of an object, the first 16 bytes of its SHA-256."""
    return hashlib.sha256(content).digest()[:16]


def object_name(content: bytes) -> str:
    """Return the path of an object in the folder."""
    return object_path(object_key(content))


def object_path(key: bytes) -> str:
    """Return the path of an object in the folder, given its key."""
    return f"segments/{key.hex()}.bin"


def replace_magic(data: bytes, magic: bytes) -> bytes:
    """Return the data with another magic number and a new checksum."""
    return seal(magic + data[len(magic) : PREAMBLE_BYTES]) + data[PREAMBLE_BYTES:]
