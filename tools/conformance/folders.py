"""Conformance vectors of folders, taken apart from files by SPEC 3.4 alone, and put together again.

Nothing of `formats` that knows folders is used here, so that one can be held against the other.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import msgpack

from cogsplat.formats.cogs.layout import MAGIC

from .file_builder import PREAMBLE_BYTES, poke, seal

MANIFEST: Final = "manifest.cogsm"
MANIFEST_MAGIC: Final = b"\x89COGM\r\n\x1a"

Objects = dict[str, bytes]
"""Contents by name, relative to the folder."""


@dataclass(frozen=True)
class ValidFolder:
    """A folder to decode.

    Parameters
    ----------
    name : str
    stands_for : dict of str to str
        Valid vectors by the name of the manifest that stands for them.
    note : str
        What it is there for.
    objects : dict of str to bytes
    """

    name: str
    stands_for: dict[str, str]
    note: str
    objects: Objects


@dataclass(frozen=True)
class InvalidFolder:
    """A folder to refuse.

    Parameters
    ----------
    name : str
    objects : dict of str to bytes
    code, clause, note, stage, partial
        As those of `invalid.Invalid`.
    """

    name: str
    objects: Objects
    code: str
    clause: str
    note: str
    stage: str = "open"
    partial: bool = False


def valid(files: Mapping[str, bytes]) -> list[ValidFolder]:
    """Return the folders to decode, made of valid vectors by name."""

    def one(name: str, note: str) -> ValidFolder:
        return ValidFolder(name, {MANIFEST: name}, note, unpacked(files[name]))

    versions = {"first.cogsm": "attributes", "second.cogsm": "attributes-pages"}
    both: Objects = {}
    for manifest, name in versions.items():
        both |= unpacked(files[name], manifest)
    return [
        one("empty", "a manifest and no objects"),
        one("one-splat", "one object"),
        one("pages", "index pages without gaps in the manifest"),
        one("compensation-pages", "segments of equal bytes are one object"),
        ValidFolder("versions", versions, "two manifests that share objects", both),
    ]


def invalid(files: Mapping[str, bytes]) -> list[InvalidFolder]:
    """Return the folders to refuse, made of valid vectors by name; all have `MANIFEST`."""
    small, large = unpacked(files["one-splat"]), unpacked(files["pages"])
    manifest = small[MANIFEST]
    paged = large[MANIFEST]
    (segment,) = (name for name in small if name != MANIFEST)
    content = small[segment]
    flipped = content[:-1] + bytes([content[-1] ^ 1])

    def head(name: str, data: bytes, code: str, note: str, clause: str = "3.4") -> InvalidFolder:
        return InvalidFolder(name, small | {MANIFEST: data}, code, clause, note)

    def body(
        name: str, objects: Objects, code: str, note: str, stage: str, clause: str = "3.4"
    ) -> InvalidFolder:
        # A reader of parts leaves out what is missing.
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
        head("folder-root-cut", manifest[:-1], "root-truncated", "ends inside the root"),
        head(
            "folder-root-flip",
            poke(manifest, 70, "B", manifest[70] ^ 1),
            "root-crc",
            "a bit of the root flipped",
        ),
        head("folder-behind", manifest + b"\0", "file-trailing", "a byte behind the manifest"),
        InvalidFolder(
            "folder-pages-cut",
            large | {MANIFEST: paged[:-1]},
            "file-truncated",
            "3.4",
            "a manifest that ends inside the last page",
        ),
        InvalidFolder(
            "folder-page-flip",
            large | {MANIFEST: poke(paged, len(paged) - 2, "B", paged[-2] ^ 1)},
            "page-crc",
            "5.6",
            "a bit of the last page flipped",
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
    ]


def unpacked(data: bytes, manifest: str = MANIFEST) -> Objects:
    """Return the folder of a file."""
    root_end, root = _root(data)
    head, position, objects = data[:root_end], root_end, {}
    for page in [None, *root.get("pages", [])]:
        index = root
        if page is not None:
            body = data[position : position + page["length"]]
            head += body
            position += page["length"]
            index = msgpack.unpackb(body)
        for name, length in _segments(index):
            objects[name] = data[position : position + length]
            position += length
    return {manifest: _with_magic(head, MANIFEST_MAGIC), **objects}


def packed(objects: Mapping[str, bytes], manifest: str = MANIFEST) -> bytes:
    """Return the file that a folder stands for."""
    data = objects[manifest]
    position, root = _root(data)
    parts = [data[:position]]
    for page in [None, *root.get("pages", [])]:
        index = root
        if page is not None:
            parts.append(data[position : position + page["length"]])
            position += page["length"]
            index = msgpack.unpackb(parts[-1])
        parts += [objects[name] for name, _ in _segments(index)]
    return _with_magic(b"".join(parts), MAGIC)


def _root(data: bytes) -> tuple[int, dict[str, list[dict[str, int]]]]:
    (length,) = struct.unpack_from("<I", data, 12)
    return PREAMBLE_BYTES + length, msgpack.unpackb(data[PREAMBLE_BYTES : PREAMBLE_BYTES + length])


def _segments(index: Mapping[str, object]) -> Iterator[tuple[str, int]]:
    table = index["segments"]
    assert isinstance(table, dict)
    hashes, lengths = table["hash"], table["length"]
    for row, (length,) in enumerate(struct.iter_unpack("<I", lengths)):
        yield f"segments/{hashes[16 * row : 16 * row + 16].hex()}.bin", length


def _with_magic(data: bytes, magic: bytes) -> bytes:
    return seal(magic + data[len(magic) : PREAMBLE_BYTES]) + data[PREAMBLE_BYTES:]
