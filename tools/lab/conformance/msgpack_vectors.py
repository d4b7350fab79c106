"""Conformance vectors of msgpack: byte order marks in strings, value counts, two faults at once."""

from __future__ import annotations

from cogsplat.formats.cogs.canonical_msgpack import MAX_DEPTH, MAX_VALUES, Value, pack, unpack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from .attribute_vectors import camera_columns, labels, store_planes, with_attributes
from .file_builder import build, split_root, with_root
from .invalid import (
    Invalid,
    build_edited,
    key_setter,
    no_splats,
    paged_chunks,
    uniform_chunk,
    with_segments,
)
from .valid import Valid

_BYTE_ORDER_MARK = "\ufeff"


def valid() -> list[Valid]:
    """Return the vectors of strings with a byte order mark, and of a root of 4,096 values."""
    attributes: list[Value] = [
        {"name": "label", "type": "u1"},
        {"name": _BYTE_ORDER_MARK + "label", "type": "u1"},
    ]
    marked = with_attributes(uniform_chunk(), attributes, [store_planes(labels(3) + labels(3))])
    keys = key_setter(_BYTE_ORDER_MARK + "writer", None)
    values = _count_values(build(no_splats()))
    full = build_edited(no_splats(), key_setter("spare", [None] * (MAX_VALUES - values - 2)))
    return [
        Valid(
            "byte-order-mark",
            build_edited(marked, keys),
            ("4.1", "5.7"),
            "a key and a name that begin with U+FEFF, beside the same without it",
        ),
        Valid("values-4096", full, ("4.1", "9.1"), "a root of as many values as there may be"),
    ]


def _count_values(data: bytes) -> int:
    """Return the number of values in a file's root, counted by SPEC 4.1."""

    def count(value: object) -> int:
        if isinstance(value, dict):
            return 1 + sum(1 + count(inner) for inner in value.values())
        return 1 + (sum(map(count, value)) if isinstance(value, list) else 0)

    return count(unpack(split_root(data)[0], "root"))


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of too many values, and of two faults at one place."""
    root, behind = split_root(build(no_splats()))

    def added(name: str, raw: bytes, code: str, note: str) -> Invalid:
        data = with_root(bytes([root[0] + 1]) + root[1:] + raw, behind)
        return Invalid(name, data, f"msgpack-{code}", "4.1", note)

    def inside(depth: int, raw: bytes) -> bytes:
        """Return a map entry whose value is `raw`, nested in `depth` arrays of one element."""
        return b"\xa1x" + b"\x91" * depth + raw

    values = _count_values(build(no_splats()))
    full: list[Value] = [None] * MAX_VALUES
    more: list[Value] = [None] * (MAX_VALUES - values - 1)
    nils: list[Value] = [None] * (1 << 17)
    cameras = pack(camera_columns(1) | {"spare": nils})
    segments = [*uniform_chunk().groups[0].segments, Segment(SegmentKind.CAMERAS, 0, cameras)]
    return [
        Invalid("values-4097", build_edited(no_splats(), key_setter("spare", more)),
                "msgpack-count", "4.1",
                "a root of a value more than there may be"),
        Invalid("page-values", build_edited(paged_chunks(), key_setter("spare", full), 1),
                "msgpack-count", "4.1",
                "a page of too many values"),
        Invalid("cameras-values", build(with_segments(uniform_chunk(), segments)),
                "msgpack-count", "4.1",
                "cameras of more than 2^17 values", "verify"),
        added("msgpack-key-ext", b"\xd4\x05\x00\x01", "type", "an extension as a key"),
        added("msgpack-key-float32", b"\xca" + bytes(4) + b"\x01", "canonical",
              "a float32 as a key"),
        added("msgpack-key-array-cut", b"\x92\x01", "truncated",
              "an array as a key, and it is cut"),
        added("msgpack-str8-cut", b"\xa1x\xd9\x05", "canonical",
              "a str of 5 with a length byte, and no byte of it"),
        added("msgpack-uint16-cut", b"\xa1x\xcd\x00", "truncated",
              "half an integer that would be too long"),
        added("msgpack-array16-cut", b"\xa1x\xdc\x00\x0f", "canonical",
              "an array of 15 in three bytes, and no element"),
        added("msgpack-deep-cut", inside(MAX_DEPTH - 1, b"\xdc\xff\xff"), "depth",
              "an array too deep that states more elements than there are bytes"),
        added("msgpack-count-cut", b"\xa1x\xdc\xff\xff", "truncated",
              "an array of more elements than bytes, and than there may be"),
        added("msgpack-str-cut-utf8", b"\xa1x\xa2\xff", "truncated",
              "a str that is cut and not UTF-8"),
    ]  # fmt: skip
