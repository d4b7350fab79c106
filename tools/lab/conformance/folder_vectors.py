"""Conformance vectors of folders (SPEC 3.4)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgpack

from cogsplat.formats.cogs.layout import MAGIC

from .file_builder import PREAMBLE_BYTES, poke, seal
from .reference_folders import (
    INSIDE,
    MANIFEST,
    MANIFEST_MAGIC,
    Objects,
    Placement,
    folder_of_file,
    object_key,
    object_name,
    object_path,
    one_object_folder,
    placement_table,
    read_pages,
    read_places,
    read_root,
    read_segments,
    replace_magic,
)


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
    root_end, _ = read_root(manifest)
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
    root_end, _ = read_root(manifest)
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
            manifest[:root_end] + placement_table([(object_key(content), len(content), 1)]),
            "places-range",
            "a segment that ends a byte behind its object",
        ),
        _manifest_folder(
            small,
            "folder-places-size",
            manifest[:root_end] + placement_table([(object_key(content), len(content) - 1, 0)]),
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
            manifest[:root_end] + placement_table([(bytes(16), 0, 1)]),
            "places-range",
            "a segment in the manifest that has an offset",
        ),
        _manifest_folder(
            small,
            "folder-inside-object",
            manifest[:root_end] + placement_table([(object_key(content), 0, 0)]),
            "places-range",
            "a segment in the manifest that has an object",
        ),
        _manifest_folder(
            small,
            "folder-inside-long",
            replace_magic(_first_length(file, 65_536), MANIFEST_MAGIC) + placement_table([INSIDE]),
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
    pages_end, root = read_root(paged)
    pages = read_pages(root)
    rows = read_places(paged[pages_end:], len(read_segments(root, 0)) + len(pages))
    page = object_path(rows[-1][0])
    places_start = pages[-1]
    cut = large[page][:-1]
    return [
        InvalidFolder(
            "folder-page-inside",
            large | {MANIFEST: paged[:pages_end] + placement_table([*rows[:-1], INSIDE])},
            "places-range",
            "3.4",
            "a page in the manifest",
        ),
        InvalidFolder(
            "folder-page-range",
            large
            | {
                MANIFEST: paged[:pages_end]
                + placement_table([*rows[:-1], (object_key(cut), len(cut), 0)]),
                object_name(cut): cut,
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
                + placement_table(
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
    root_end, _ = read_root(manifest)
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
                MANIFEST: manifest[:root_end] + placement_table([(bytes(16), len(content), 0)]),
                other: content,
            },
            "object-hash",
            "an object with another name than its bytes have",
            "verify",
        ),
    ]


def _page_folder(
    folder: Objects, root: bytes, rows: Sequence[Placement], places_start: int
) -> InvalidFolder:
    """Return a folder whose last page has a segment in the manifest, which only the root may."""
    page = folder[object_path(rows[-1][0])]
    count = (len(page) - places_start - 4) // 24
    places = [INSIDE, *read_places(page[places_start:], count)[1:]]
    changed = page[:places_start] + placement_table(places)
    table = placement_table([*rows[:-1], (object_key(changed), len(changed), 0)])
    return InvalidFolder(
        "folder-page-segment-inside",
        folder | {MANIFEST: root + table, object_name(changed): changed},
        "places-range",
        "3.4",
        "a segment of a page in the manifest",
    )


def _first_length(data: bytes, length: int) -> bytes:
    """Return preamble and root of a file with another length of the first segment."""
    end, _ = read_root(data)
    root = msgpack.unpackb(data[PREAMBLE_BYTES:end])
    columns = root["segments"]
    columns["length"] = struct.pack("<I", length) + columns["length"][4:]
    stored: bytes = msgpack.packb(root)
    head = poke(data[:PREAMBLE_BYTES], 12, "I", len(stored))
    return seal(poke(head, 24, "I", zlib.crc32(stored))) + stored
