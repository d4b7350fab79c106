"""Conformance vectors of the view table (SPEC 5.12)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cogsplat.codec.streams.byte_planes import pack_plane
from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import ChunkRow, Draft, Group, build, pack_streams, root_keys
from .invalid import Invalid
from .valid import Valid

_CHUNKS = 4
_ROWS = 3


def _stored_plane(differences: bytes) -> bytes:
    """Return an uncompressed plane after its length word."""
    return struct.pack("<I", len(differences)) + differences


def _table(views: int, codes: bytes) -> dict[str, Value]:
    """Return the msgpack map of a view table (SPEC 5.12)."""
    positions = [k / 4 - 1.0 for k in range(3 * views)]
    return {
        "position": struct.pack(f"<{3 * views}f", *positions),
        "codes": codes,
    }


# Includes codes 0, 1, 254 and 255, and differences that wrap around.
_THREE = _table(3, _stored_plane(bytes([0, 1, 254, 255, 1, 255, 1, 1, 239, 250, 2, 0])))


def _draft(payloads: Sequence[bytes]) -> Draft:
    """Return the draft of four chunks with a view table for each payload before chunk 1's head."""
    segments = []
    for chunk in range(_CHUNKS):
        if chunk == 1:
            segments += [Segment(SegmentKind.VIEW_TABLE, 0, data) for data in payloads]
        head = pack_streams(handmade.uniform_head(_ROWS))
        segments.append(Segment(SegmentKind.HEAD, chunk, head))
    return Draft(root_keys(_CHUNKS * _ROWS, 0), [Group(segments, [ChunkRow(_ROWS)] * _CHUNKS)])


def _in_pages(draft: Draft) -> Draft:
    """Return the draft with its chunks listed in the root and two pages, each with a table."""
    group = draft.groups[0]
    first, *heads = (x for x in group.segments if x.kind == SegmentKind.HEAD)
    tables = [
        Segment(SegmentKind.VIEW_TABLE, 0, pack(_table(views, _stored_plane(codes))))
        for views, codes in ((2, bytes([9, 250, 3, 1, 255, 0])), (1, bytes([255, 128])))
    ]
    return replace(
        draft,
        groups=[
            Group([first, tables[0]], group.chunks[:1]),
            Group(heads[:1], group.chunks[1:2]),
            Group([heads[1], tables[1], heads[2]], group.chunks[2:]),
        ],
    )


def _compressed_table() -> dict[str, Value]:
    """Return a table of 64 viewpoints with equal codes, its differences in a zstd frame."""
    differences = np.frombuffer(bytes([200, 201, 0, 240]) + bytes(63 * _CHUNKS), np.uint8)
    word, stored = pack_plane(differences)
    return _table(64, struct.pack("<I", word) + stored)


def valid() -> list[Valid]:
    """Return the valid vectors of the view table (SPEC 5.12)."""
    return [
        Valid("view-table", build(_draft([pack(_THREE)])), ("5.12",),
              "three viewpoints, codes that wrap around"),
        Valid("view-table-64", build(_draft([pack(_compressed_table() | {"later": 1})])),
              ("4.3", "5.12"), "64 viewpoints in a zstd frame, with a key of a later version"),
        Valid("view-table-pages", build(_in_pages(_draft([pack(_THREE)]))), ("5.6", "5.12"),
              "a table of the root, of a chunk and two pages, and one of a page"),
    ]  # fmt: skip


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of the view table (SPEC 5.12)."""
    good = pack(_THREE)

    def segments(name: str, owners: Sequence[int], note: str) -> Invalid:
        draft = _draft([good] * len(owners))
        group = draft.groups[0]
        made = list(group.segments)
        for place, owner in enumerate(owners, start=1):
            made[place] = replace(made[place], owner=owner)
        data = build(replace(draft, groups=[Group(made, group.chunks)]))
        return Invalid(name, data, "view-table-segments", "5.12", note)

    def body(name: str, data: bytes, code: str, note: str, clause: str = "5.12") -> Invalid:
        return Invalid(name, build(_draft([data])), code, clause, note, "verify")

    def changed(vector: str, code: str, note: str, clause: str = "5.12", **to: Value) -> Invalid:
        return body(vector, pack(_THREE | to), code, note, clause)

    plane = bytes(3 * _CHUNKS)
    codeless = {key: value for key, value in _THREE.items() if key != "codes"}
    broken = struct.pack("<I", 4 | 1 << 31) + b"none"
    infinite = struct.pack("<9f", *([0.0] * 8), float("inf"))
    return [
        segments("view-table-twice", [0, 0], "two view tables"),
        segments("view-table-owner", [1], "a view table of owner 1"),
        body("view-table-cut", good[:-1], "msgpack-truncated", "the last byte missing", "4.1"),
        body("view-table-none", pack(_table(0, _stored_plane(b""))), "root-value", "no viewpoint"),
        body("view-table-65", pack(_table(65, _stored_plane(bytes(65 * _CHUNKS)))), "root-value",
             "65 viewpoints"),
        body("view-table-no-codes", pack(codeless), "root-missing", "no codes"),
        body("view-table-must-understand", pack(_THREE | {"walls!": 1}), "root-must-understand",
             "a key with !", "4.3"),
        changed("view-table-text", "root-type", "positions in a text", position="here"),
        changed("view-table-position-odd", "root-columns", "positions of 13 bytes",
                position=bytes(13)),
        changed("view-table-word", "root-columns", "codes of three bytes", codes=bytes(3)),
        changed("view-table-behind", "root-columns", "a byte behind the plane",
                codes=_stored_plane(plane) + b"\0"),
        changed("view-table-position-infinite", "root-value", "a position that is not finite",
                position=infinite),
        changed("view-table-short", "plane-length", "a code missing", "6.3",
                codes=_stored_plane(plane[:-1])),
        changed("view-table-frame", "zstd-frame", "a plane that is no frame", "6.3", codes=broken),
    ]  # fmt: skip
