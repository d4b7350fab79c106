"""Conformance vectors of folders, and the conversion between files and folders (SPEC 3.4).

The conversion is written from SPEC alone and uses no folder code of `formats`, so that tests can
compare the two.
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

from .file_builder import PREAMBLE_BYTES, poke, seal

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


@dataclass(frozen=True)
class ValidFolder:
    """A valid conformance folder: manifests and segment objects.

    Parameters
    ----------
    name : str
    stands_for : dict of str to str
        Name of the valid vector that decodes to the same arrays, for each manifest by name.
    note : str
        Description of the case.
    objects : dict of str to bytes
        Contents of the manifests and the objects, by name.
    """

    name: str
    stands_for: dict[str, str]
    note: str
    objects: Objects


@dataclass(frozen=True)
class InvalidFolder:
    """A must-reject folder, which breaks one rule.

    Parameters
    ----------
    name : str
    objects : dict of str to bytes
        Contents of the manifest and the objects, by name.
    code, clause, note, stage, partial
        See `invalid.Invalid`.
    """

    name: str
    objects: Objects
    code: str
    clause: str
    note: str
    stage: str = "open"
    partial: bool = False


def valid(files: Mapping[str, bytes]) -> list[ValidFolder]:
    """Return the valid folders, given the bytes of each valid vector by name."""

    def one(name: str, note: str) -> ValidFolder:
        return ValidFolder(name, {MANIFEST: name}, note, folder_of_file(files[name]))

    versions = {"first.cogsm": "attributes", "second.cogsm": "attributes-pages"}
    both: Objects = {}
    for manifest, name in versions.items():
        both |= folder_of_file(files[name], manifest)
    return [
        one("empty", "a manifest and no objects"),
        one("one-splat", "one object"),
        one("pages", "pages, each with its places an object"),
        one("pages-tree", "pages of pages: the places of a page have those that it lists"),
        one("compensation-pages", "segments of equal bytes are one object"),
        one("pictures-pages", "a description in the manifest, its pictures objects"),
        ValidFolder(
            "description-object",
            {MANIFEST: "pictures-pages"},
            "a description that is an object",
            folder_of_file(files["pictures-pages"], inside=()),
        ),
        ValidFolder(
            "manifest-alone",
            {MANIFEST: "attributes"},
            "every segment in the manifest",
            folder_of_file(files["attributes"], inside=range(256)),
        ),
        ValidFolder("versions", versions, "two manifests that share objects", both),
        ValidFolder(
            "one-object",
            {MANIFEST: "attributes-pages"},
            "all segments backwards in one object and all pages in another, with other bytes "
            "around them",
            one_object_folder(files["attributes-pages"], b"between"),
        ),
    ]


def invalid(files: Mapping[str, bytes]) -> list[InvalidFolder]:
    """Return the must-reject folders, given the bytes of each valid vector by name."""
    return [
        *_invalid_manifests(files["one-splat"]),
        *_invalid_places(files["one-splat"]),
        *_invalid_pages(files["pages"]),
        *_invalid_objects(files["one-splat"]),
    ]


def _manifest_folder(
    folder: Objects, name: str, manifest: bytes, code: str, note: str, clause: str = "3.4"
) -> InvalidFolder:
    """Return a must-reject folder with another manifest."""
    return InvalidFolder(name, folder | {MANIFEST: manifest}, code, clause, note)


def _invalid_manifests(file: bytes) -> list[InvalidFolder]:
    """Return folders with an invalid preamble or root, or bytes behind the manifest."""
    small = folder_of_file(file)
    manifest = small[MANIFEST]
    root_end, _ = _read_root(manifest)
    own_crc = MAGIC + manifest[len(MAGIC) :]
    return [
        _manifest_folder(
            small, "folder-file", file, "not-cogs", "a file in the place of the manifest"
        ),
        _manifest_folder(
            small,
            "folder-text",
            b"<!doctype html>" + bytes(64),
            "not-cogs",
            "a page of a web server",
        ),
        _manifest_folder(small, "folder-none", b"", "preamble-truncated", "a manifest of no bytes"),
        _manifest_folder(
            small,
            "folder-crc",
            MANIFEST_MAGIC + file[len(MAGIC) : PREAMBLE_BYTES] + manifest[64:],
            "preamble-crc",
            "the preamble's CRC is the file's",
        ),
        _manifest_folder(
            small, "folder-magic", own_crc, "not-cogs", "the file's magic, the manifest's CRC"
        ),
        _manifest_folder(
            small,
            "folder-version",
            seal(poke(manifest[:64], 10, "H", 2)) + manifest[64:],
            "version-minor",
            "version 0.2",
            "3.2",
        ),
        _manifest_folder(
            small,
            "folder-root-cut",
            manifest[: root_end - 1],
            "root-truncated",
            "ends inside the root",
        ),
        _manifest_folder(
            small,
            "folder-root-flip",
            poke(manifest, 70, "B", manifest[70] ^ 1),
            "root-crc",
            "a bit of the root flipped",
        ),
        _manifest_folder(
            small, "folder-behind", manifest + b"\0", "file-trailing", "a byte behind the manifest"
        ),
    ]


def _invalid_places(file: bytes) -> list[InvalidFolder]:
    """Return folders with invalid places of the root's segments (SPEC 3.4)."""
    small = folder_of_file(file)
    manifest = small[MANIFEST]
    (content,) = (data for name, data in small.items() if name != MANIFEST)
    root_end, _ = _read_root(manifest)
    inside = folder_of_file(file, inside=range(256))[MANIFEST]
    return [
        _manifest_folder(
            small,
            "folder-places-cut",
            manifest[:-1],
            "file-truncated",
            "ends inside the places of the root",
        ),
        _manifest_folder(
            small,
            "folder-places-flip",
            poke(manifest, root_end, "B", manifest[root_end] ^ 1),
            "places-crc",
            "a bit of the root's places flipped",
        ),
        _manifest_folder(
            small,
            "folder-places-offset",
            manifest[:root_end] + _placement_table([(_object_key(content), len(content), 1)]),
            "places-range",
            "a segment that ends a byte behind its object",
        ),
        _manifest_folder(
            small,
            "folder-places-size",
            manifest[:root_end] + _placement_table([(_object_key(content), len(content) - 1, 0)]),
            "places-range",
            "an object that is stated a byte shorter than its segment",
        ),
        _manifest_folder(
            small,
            "folder-inside-cut",
            inside[:-1],
            "file-truncated",
            "ends inside its last segment",
        ),
        _manifest_folder(
            small,
            "folder-inside-offset",
            manifest[:root_end] + _placement_table([(bytes(16), 0, 1)]),
            "places-range",
            "a segment in the manifest that has an offset",
        ),
        _manifest_folder(
            small,
            "folder-inside-object",
            manifest[:root_end] + _placement_table([(_object_key(content), 0, 0)]),
            "places-range",
            "a segment in the manifest that has an object",
        ),
        _manifest_folder(
            small,
            "folder-inside-long",
            _replace_magic(_first_length(file, 65_536), MANIFEST_MAGIC)
            + _placement_table([_INSIDE]),
            "places-range",
            "segments in the manifest that end behind its 64 KiB",
        ),
        InvalidFolder(
            "folder-inside-flip",
            {MANIFEST: inside[:-1] + bytes([inside[-1] ^ 1])},
            "segment-crc",
            "5.3",
            "a bit of a segment in the manifest flipped",
            "decode",
        ),
    ]


def _invalid_pages(file: bytes) -> list[InvalidFolder]:
    """Return folders with an invalid page, or invalid places of a page."""
    large = folder_of_file(file)
    paged = large[MANIFEST]
    pages_end, root = _read_root(paged)
    pages = _read_pages(root)
    rows = _read_places(paged[pages_end:], len(_read_segments(root, 0)) + len(pages))
    page = _path(rows[-1][0])
    places_start = pages[-1]
    cut = large[page][:-1]
    return [
        InvalidFolder(
            "folder-page-inside",
            large | {MANIFEST: paged[:pages_end] + _placement_table([*rows[:-1], _INSIDE])},
            "places-range",
            "3.4",
            "a page in the manifest",
        ),
        InvalidFolder(
            "folder-page-range",
            large
            | {
                MANIFEST: paged[:pages_end]
                + _placement_table([*rows[:-1], (_object_key(cut), len(cut), 0)]),
                _object_name(cut): cut,
            },
            "places-range",
            "3.4",
            "a page whose places end a byte behind their object",
        ),
        InvalidFolder(
            "folder-page-offset",
            large
            | {
                MANIFEST: paged[:pages_end]
                + _placement_table(
                    [*rows[:-1], (*rows[-1][:2], len(large[page]) - places_start + 1)]
                )
            },
            "places-range",
            "3.4",
            "a page that ends a byte behind its object",
        ),
        InvalidFolder(
            "folder-page-flip",
            large | {page: poke(large[page], places_start - 2, "B", large[page][-2] ^ 1)},
            "page-crc",
            "5.6",
            "a bit of the last page flipped",
        ),
        InvalidFolder(
            "folder-page-places-flip",
            large | {page: poke(large[page], places_start, "B", large[page][places_start] ^ 1)},
            "places-crc",
            "3.4",
            "a bit of the places of the last page flipped",
        ),
        _page_folder(large, paged[:pages_end], rows, places_start),
        InvalidFolder(
            "folder-page-short",
            large | {page: large[page][:-1]},
            "segment-object",
            "3.4",
            "an object of a page that lacks its last byte",
        ),
        InvalidFolder(
            "folder-page-missing",
            {name: data for name, data in large.items() if name != page},
            "segment-missing",
            "3.4",
            "no object of the last page",
            partial=True,
        ),
    ]


def _invalid_objects(file: bytes) -> list[InvalidFolder]:
    """Return folders with a missing, changed or misnamed object."""
    small = folder_of_file(file)
    manifest = small[MANIFEST]
    (segment,) = (name for name in small if name != MANIFEST)
    content = small[segment]
    flipped = content[:-1] + bytes([content[-1] ^ 1])
    root_end, _ = _read_root(manifest)
    other = f"segments/{bytes(16).hex()}.bin"

    def body(
        name: str, objects: Objects, code: str, note: str, stage: str, clause: str = "3.4"
    ) -> InvalidFolder:
        # A partial reader skips missing objects.
        return InvalidFolder(name, objects, code, clause, note, stage, code == "segment-missing")

    return [
        body("folder-missing", {MANIFEST: manifest}, "segment-missing", "no object", "open"),
        body(
            "folder-short",
            small | {segment: content[:-1]},
            "segment-object",
            "an object that lacks its last byte",
            "decode",
        ),
        body(
            "folder-long",
            small | {segment: content + b"\0"},
            "segment-object",
            "an object with a byte more",
            "decode",
        ),
        body(
            "folder-flip",
            small | {segment: flipped},
            "segment-crc",
            "a bit of an object flipped",
            "decode",
            "5.3",
        ),
        body(
            "folder-object-hash",
            {
                MANIFEST: manifest[:root_end] + _placement_table([(bytes(16), len(content), 0)]),
                other: content,
            },
            "object-hash",
            "an object with another name than its bytes have",
            "verify",
        ),
    ]


def _page_folder(
    folder: Objects, root: bytes, rows: Sequence[_Placement], places_start: int
) -> InvalidFolder:
    """Return a folder whose last page has a segment in the manifest, which only the root may."""
    page = folder[_path(rows[-1][0])]
    count = (len(page) - places_start - 4) // 24
    places = [_INSIDE, *_read_places(page[places_start:], count)[1:]]
    changed = page[:places_start] + _placement_table(places)
    table = _placement_table([*rows[:-1], (_object_key(changed), len(changed), 0)])
    return InvalidFolder(
        "folder-page-segment-inside",
        folder | {MANIFEST: root + table, _object_name(changed): changed},
        "places-range",
        "3.4",
        "a segment of a page in the manifest",
    )


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
        x.position: _INSIDE
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
            where[segment.position] = _object_key(content), len(content), offset
            offset += segment.length
        objects[_object_name(content)] = content
    rows: dict[int, _Placement] = {}
    # Pages below an index come before it: its table has their places.
    for index in reversed(indexes[1:]):
        page = index.stored + _table_of(index, where, rows)
        objects[_object_name(page)] = page
        rows[index.position] = _object_key(page), len(page), 0
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
        _object_name(content): content,
        _object_name(book): book,
    }


def _backwards(parts: Sequence[bytes], around: bytes) -> tuple[bytes, list[_Placement]]:
    """Return an object of parts in reverse order, and the placement of each part."""
    content, offsets = around, []
    for part in reversed(parts):
        offsets.append(len(content))
        content += part + around
    return content, [(_object_key(content), len(content), offset) for offset in reversed(offsets)]


def file_of_folder(objects: Mapping[str, bytes], manifest: str = MANIFEST) -> bytes:
    """Convert a folder into the equivalent file."""
    data = objects[manifest]
    root_end, root = _read_root(data)
    pages = _read_pages(root)
    segments = _read_segments(root, 0)
    places_end = root_end + _placement_bytes(len(segments) + len(pages))
    rows = _read_places(data[root_end:places_end], len(segments) + len(pages))
    parts, inside = [data[:root_end]], places_end
    for segment, row in zip(segments, rows, strict=False):
        if row == _INSIDE:
            parts.append(data[inside : inside + segment.length])
            inside += segment.length
        else:
            parts.append(objects[_path(row[0])][row[2] :][: segment.length])
    parts += _parts_of_pages(objects, pages, rows[len(segments) :])
    return _replace_magic(b"".join(parts), MAGIC)


def _parts_of_pages(
    objects: Mapping[str, bytes], pages: Sequence[int], rows: Sequence[_Placement]
) -> Iterator[bytes]:
    """Yield the bytes of pages, given their lengths and placements, each with all below it."""
    for length, (key, _, offset) in zip(pages, rows, strict=True):
        stored = objects[_path(key)][offset:]
        yield stored[:length]
        index = msgpack.unpackb(stored[:length])
        segments, below = _read_segments(index, 0), _read_pages(index)
        places = _read_places(stored[length:], len(segments) + len(below))
        for segment, (name, _, at) in zip(segments, places, strict=False):
            yield objects[_path(name)][at : at + segment.length]
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


# Location of a segment or page: key of its object, size of the object, and offset in it, bytes.
_Placement = tuple[bytes, int, int]

# Placement of a segment in the manifest itself.
_INSIDE: Final[_Placement] = (bytes(16), 0, 0)


def _read_indexes(data: bytes) -> list[_Index]:
    """Return root and pages of a file with the segments that each lists."""
    root_end, root = _read_root(data)
    return _add_indexes(data, root, 0, root_end)


def _add_indexes(data: bytes, index: Mapping[str, object], start: int, end: int) -> list[_Index]:
    """Return an index, given where it begins and ends, and all indices below it in file order."""
    segments = _read_segments(index, end)
    position = end + sum(segment.length for segment in segments)
    starts: list[int] = []
    below: list[_Index] = []
    for length in _read_pages(index):
        starts.append(position)
        page = msgpack.unpackb(data[position : position + length])
        found = _add_indexes(data, page, position, position + length)
        below += found
        last = found[-1]
        position = last.position + len(last.stored) + sum(x.length for x in last.segments)
    return [_Index(data[start:end], start, segments, starts), *below]


def _read_pages(index: Mapping[str, object]) -> list[int]:
    """Return the lengths of the pages that an index lists, bytes."""
    pages = index.get("pages")
    lengths = pages["length"] if isinstance(pages, dict) else b""
    return [length for (length,) in struct.iter_unpack("<I", lengths)]


def _table_of(
    index: _Index, where: Mapping[int, _Placement], pages: Mapping[int, _Placement]
) -> bytes:
    """Return the packed placement table of an index.

    Parameters
    ----------
    index : _Index
    where, pages : mapping of int to _Placement
        Placement of each segment, and of each page, by its offset in the file.
    """
    return _placement_table(
        [
            *(where[segment.position] for segment in index.segments),
            *(pages[at] for at in index.pages),
        ]
    )


def _build_manifest(
    data: bytes, root: _Index, where: Mapping[int, _Placement], pages: Mapping[int, _Placement]
) -> bytes:
    """Return a folder's manifest: preamble, root, placement table, and the segments inside.

    Parameters
    ----------
    data : bytes
        The file.
    root : _Index
        Root of the file.
    where : mapping of int to _Placement
        Placement of each segment by its offset in the file.
    pages : mapping of int to _Placement
        Placement of each page by its offset in the file.
    """
    rows = [where[segment.position] for segment in root.segments]
    inside = (x.position for x, row in zip(root.segments, rows, strict=True) if row == _INSIDE)
    lengths = {segment.position: segment.length for segment in root.segments}
    stored = root.stored + _table_of(root, where, pages)
    stored += b"".join(data[at : at + lengths[at]] for at in inside)
    return _replace_magic(stored, MANIFEST_MAGIC)


def _placement_table(rows: Sequence[_Placement]) -> bytes:
    """Return the packed placement table of segments, with its CRC (SPEC 3.4)."""
    columns = b"".join(key for key, _, _ in rows)
    columns += struct.pack(f"<{len(rows)}I", *(size for _, size, _ in rows))
    columns += struct.pack(f"<{len(rows)}I", *(offset for _, _, offset in rows))
    return columns + struct.pack("<I", zlib.crc32(columns))


def _placement_bytes(rows: int) -> int:
    """Return the size of a placement table, bytes."""
    return 24 * rows + 4


def _read_places(data: bytes, count: int) -> list[_Placement]:
    """Return the rows of a placement table."""
    keys = [data[16 * row :][:16] for row in range(count)]
    sizes = struct.unpack_from(f"<{count}I", data, 16 * count)
    offsets = struct.unpack_from(f"<{count}I", data, 20 * count)
    return list(zip(keys, sizes, offsets, strict=True))


def _first_length(data: bytes, length: int) -> bytes:
    """Return preamble and root of a file with another length of the first segment."""
    end, _ = _read_root(data)
    root = msgpack.unpackb(data[PREAMBLE_BYTES:end])
    columns = root["segments"]
    columns["length"] = struct.pack("<I", length) + columns["length"][4:]
    stored: bytes = msgpack.packb(root)
    head = poke(data[:PREAMBLE_BYTES], 12, "I", len(stored))
    return seal(poke(head, 24, "I", zlib.crc32(stored))) + stored


def _read_root(data: bytes) -> tuple[int, dict[str, dict[str, bytes]]]:
    """Return the end of a file's root, bytes, and the root unpacked from msgpack."""
    (length,) = struct.unpack_from("<I", data, 12)
    return PREAMBLE_BYTES + length, msgpack.unpackb(data[PREAMBLE_BYTES : PREAMBLE_BYTES + length])


def _read_segments(index: Mapping[str, object], position: int) -> list[_Segment]:
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


def _object_key(content: bytes) -> bytes:
    """Return the key of an object, the first 16 bytes of its SHA-256."""
    return hashlib.sha256(content).digest()[:16]


def _object_name(content: bytes) -> str:
    """Return the path of an object in the folder."""
    return _path(_object_key(content))


def _path(key: bytes) -> str:
    """Return the path of an object in the folder, given its key."""
    return f"segments/{key.hex()}.bin"


def _replace_magic(data: bytes, magic: bytes) -> bytes:
    """Return the data with another magic number and a new checksum."""
    return seal(magic + data[len(magic) : PREAMBLE_BYTES]) + data[PREAMBLE_BYTES:]
