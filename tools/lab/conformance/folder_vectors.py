"""Conformance vectors of folders, and the conversion between files and folders (SPEC 3.4).

The conversion is written from SPEC alone and uses no folder code of `formats`, so that tests can
compare the two.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgpack

from cogsplat.formats.cogs.layout import MAGIC

from .file_builder import PREAMBLE_BYTES, poke, seal

MANIFEST: Final = "manifest.cogsm"
MANIFEST_MAGIC: Final = b"\x89COGM\r\n\x1a"

# Segment kinds of codebooks, and kinds whose owner is a chunk (SPEC 5.2).
_CODEBOOKS: Final = (3, 4, 5, 6)
_OF_CHUNKS: Final = (1, 2, 7, 8, 129)

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
        one("pages", "index pages, each with its places behind it"),
        one("compensation-pages", "segments of equal bytes are one object"),
        one("pictures-pages", "a description and its pictures, each an object of its own"),
        ValidFolder("versions", versions, "two manifests that share objects", both),
        ValidFolder(
            "one-object",
            {MANIFEST: "attributes-pages"},
            "all segments backwards in one object, with bytes of no segment around them",
            one_object_folder(files["attributes-pages"], b"between"),
        ),
    ]


def invalid(files: Mapping[str, bytes]) -> list[InvalidFolder]:
    """Return the must-reject folders, given the bytes of each valid vector by name."""
    small, large = folder_of_file(files["one-splat"]), folder_of_file(files["pages"])
    manifest = small[MANIFEST]
    paged = large[MANIFEST]
    (segment,) = (name for name in small if name != MANIFEST)
    content = small[segment]
    flipped = content[:-1] + bytes([content[-1] ^ 1])
    root_end, _ = _read_root(manifest)
    other = f"segments/{bytes(16).hex()}.bin"
    last_page = len(paged) - _placement_bytes(_read_root(paged)[1]["pages"][-1]["segments"])

    def head(name: str, data: bytes, code: str, note: str, clause: str = "3.4") -> InvalidFolder:
        return InvalidFolder(name, small | {MANIFEST: data}, code, clause, note)

    def body(
        name: str, objects: Objects, code: str, note: str, stage: str, clause: str = "3.4"
    ) -> InvalidFolder:
        # A partial reader skips missing objects.
        return InvalidFolder(name, objects, code, clause, note, stage, code == "segment-missing")

    own_crc = MAGIC + manifest[len(MAGIC) :]
    return [
        head("folder-file", files["one-splat"], "not-cogs", "a file in the place of the manifest"),
        head("folder-text", b"<!doctype html>" + bytes(64), "not-cogs", "a page of a web server"),
        head("folder-none", b"", "preamble-truncated", "a manifest of no bytes"),
        head(
            "folder-crc",
            MANIFEST_MAGIC + files["one-splat"][len(MAGIC) : PREAMBLE_BYTES] + manifest[64:],
            "preamble-crc",
            "the preamble's CRC is the file's",
        ),
        head("folder-magic", own_crc, "not-cogs", "the file's magic, the manifest's CRC"),
        head(
            "folder-version",
            seal(poke(manifest[:64], 10, "H", 2)) + manifest[64:],
            "version-minor",
            "version 0.2",
            "3.2",
        ),
        head("folder-root-cut", manifest[: root_end - 1], "root-truncated", "ends inside the root"),
        head(
            "folder-root-flip",
            poke(manifest, 70, "B", manifest[70] ^ 1),
            "root-crc",
            "a bit of the root flipped",
        ),
        head("folder-behind", manifest + b"\0", "file-trailing", "a byte behind the manifest"),
        head(
            "folder-places-cut",
            manifest[:-1],
            "file-truncated",
            "ends inside the places of the root",
        ),
        head(
            "folder-places-flip",
            poke(manifest, root_end, "B", manifest[root_end] ^ 1),
            "places-crc",
            "a bit of the root's places flipped",
        ),
        head(
            "folder-places-offset",
            manifest[:root_end] + _placement_table([(_object_key(content), len(content), 1)]),
            "places-range",
            "a segment that ends a byte behind its object",
        ),
        head(
            "folder-places-size",
            manifest[:root_end] + _placement_table([(_object_key(content), len(content) - 1, 0)]),
            "places-range",
            "an object that is stated a byte shorter than its segment",
        ),
        InvalidFolder(
            "folder-pages-cut",
            large | {MANIFEST: paged[:-1]},
            "file-truncated",
            "3.4",
            "a manifest that ends inside the places of the last page",
        ),
        InvalidFolder(
            "folder-page-flip",
            large | {MANIFEST: poke(paged, last_page - 2, "B", paged[last_page - 2] ^ 1)},
            "page-crc",
            "5.6",
            "a bit of the last page flipped",
        ),
        InvalidFolder(
            "folder-page-places-flip",
            large | {MANIFEST: poke(paged, last_page, "B", paged[last_page] ^ 1)},
            "places-crc",
            "3.4",
            "a bit of the places of the last page flipped",
        ),
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


def folder_of_file(data: bytes, manifest: str = MANIFEST) -> Objects:
    """Convert a file into a folder, with the segments grouped as SPEC 3.4 recommends."""
    indexes = _read_indexes(data)
    groups: dict[tuple[object, ...], list[_Segment]] = {}
    for segment in (segment for index in indexes for segment in index.segments):
        key: tuple[object, ...] = ("alone", segment.position)
        if segment.kind in _CODEBOOKS:
            key = ("codebooks",)
        elif segment.kind in _OF_CHUNKS:
            key = ("chunk", segment.owner)
        groups.setdefault(key, []).append(segment)
    objects: Objects = {}
    where: dict[int, _Placement] = {}
    for group in groups.values():
        content = b"".join(data[x.position : x.position + x.length] for x in group)
        offset = 0
        for segment in group:
            where[segment.position] = _object_key(content), len(content), offset
            offset += segment.length
        objects[_object_name(content)] = content
    return {manifest: _build_manifest(data, indexes, where), **objects}


def one_object_folder(data: bytes, around: bytes) -> Objects:
    """Convert a file into a folder that keeps all segments in one object.

    The segments are in reverse order; the bytes `around` precede, separate and follow them.
    """
    indexes = _read_indexes(data)
    content, offsets = around, {}
    for segment in reversed([x for index in indexes for x in index.segments]):
        offsets[segment.position] = len(content)
        content += data[segment.position : segment.position + segment.length] + around
    where = {at: (_object_key(content), len(content), offset) for at, offset in offsets.items()}
    return {MANIFEST: _build_manifest(data, indexes, where), _object_name(content): content}


def file_of_folder(objects: Mapping[str, bytes], manifest: str = MANIFEST) -> bytes:
    """Convert a folder into the equivalent file."""
    data = objects[manifest]
    position, root = _read_root(data)
    parts = [data[:position]]
    for page in [None, *root.get("pages", [])]:
        index = root
        if page is not None:
            parts.append(data[position : position + page["length"]])
            position += page["length"]
            index = msgpack.unpackb(parts[-1])
        segments = _read_segments(index, 0)
        count = len(segments)
        names = [data[position + 16 * row :][:16].hex() for row in range(count)]
        offsets = struct.unpack_from(f"<{count}I", data, position + 20 * count)
        position += _placement_bytes(count)
        for name, offset, segment in zip(names, offsets, segments, strict=True):
            parts.append(objects[f"segments/{name}.bin"][offset : offset + segment.length])
    return _replace_magic(b"".join(parts), MAGIC)


@dataclass(frozen=True)
class _Segment:
    """Row of a segment table; `position` is the offset of the segment in the file, bytes."""

    kind: int
    owner: int
    length: int
    position: int


@dataclass(frozen=True)
class _Index:
    """Bytes of a page, or of preamble and root, and the segments that it lists."""

    stored: bytes
    segments: list[_Segment]


# Location of a segment: key of its object, size of the object, and offset in it, bytes.
_Placement = tuple[bytes, int, int]


def _read_indexes(data: bytes) -> list[_Index]:
    """Return root and pages of a file with the segments that each lists."""
    root_end, root = _read_root(data)
    found = [_Index(data[:root_end], _read_segments(root, root_end))]
    position = root_end + sum(segment.length for segment in found[0].segments)
    for page in root.get("pages", []):
        body = data[position : position + page["length"]]
        position += page["length"]
        found.append(_Index(body, _read_segments(msgpack.unpackb(body), position)))
        position += page["span"]
    return found


def _build_manifest(data: bytes, indexes: list[_Index], where: Mapping[int, _Placement]) -> bytes:
    """Return a folder's manifest: preamble, root and pages, each followed by its placement table.

    Parameters
    ----------
    data : bytes
        The file.
    indexes : list of _Index
        Root and pages of the file.
    where : mapping of int to _Placement
        Placement of each segment by its offset in the file.
    """
    stored = b""
    for index in indexes:
        rows = [where[segment.position] for segment in index.segments]
        stored += index.stored + _placement_table(rows)
    return _replace_magic(stored, MANIFEST_MAGIC)


def _placement_table(rows: Sequence[_Placement]) -> bytes:
    """Return the packed placement table of segments, with its CRC (SPEC 3.4)."""
    columns = b"".join(key for key, _, _ in rows)
    columns += struct.pack(f"<{len(rows)}I", *(size for _, size, _ in rows))
    columns += struct.pack(f"<{len(rows)}I", *(offset for _, _, offset in rows))
    return columns + struct.pack("<I", zlib.crc32(columns))


def _placement_bytes(segments: int) -> int:
    """Return the size of a placement table, bytes."""
    return 24 * segments + 4


def _read_root(data: bytes) -> tuple[int, dict[str, list[dict[str, int]]]]:
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
    return f"segments/{_object_key(content).hex()}.bin"


def _replace_magic(data: bytes, magic: bytes) -> bytes:
    """Return the data with another magic number and a new checksum."""
    return seal(magic + data[len(magic) : PREAMBLE_BYTES]) + data[PREAMBLE_BYTES:]
