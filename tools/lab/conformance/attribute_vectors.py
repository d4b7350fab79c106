"""Conformance vectors of extra attributes and cameras (SPEC 5.7, 5.8)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from .file_builder import ChunkRow, Draft, Group, build, pack_symbols, plane
from .invalid import Invalid, build_edited, key_setter, two_chunks, uniform_chunk, with_segments
from .valid import Valid

_TYPES: Final = {
    "u1": "B",
    "i1": "b",
    "u2": "H",
    "i2": "h",
    "u4": "I",
    "i4": "i",
    "f4": "f",
    "f8": "d",
}


def _entry(name: str, type_name: str, components: int = 0) -> dict[str, Value]:
    """Return an extra attribute's entry in the root; its type is one of `_TYPES`, or invalid."""
    entry: dict[str, Value] = {"name": name, "type": type_name}
    return entry | ({"components": components} if components else {})


def _columns(type_name: str, values: Sequence[Sequence[float]]) -> list[bytes]:
    """Return the byte planes of values of a type such as ``u1``, component by component.

    The lowest byte of a component comes first.
    """
    rows = [
        b"".join(struct.pack(f"<{_TYPES[type_name]}", value) for value in row) for row in values
    ]
    return [bytes(row[byte] for row in rows) for byte in range(len(rows[0]))]


def _payload(planes: Sequence[tuple[int, bytes]]) -> bytes:
    """Return an attribute payload of (word, stored bytes) pairs."""
    words = struct.pack(f"<{len(planes)}I", *(word for word, _ in planes))
    return words + b"".join(stored for _, stored in planes)


def store_planes(columns: Sequence[bytes]) -> bytes:
    """Return an attribute payload: each plane uncompressed, or a zstd frame if that is smaller."""
    return _payload([plane(column) for column in columns])


def labels(rows: int) -> list[bytes]:
    """Return the plane of an attribute of type u1 with the values 0, 1, 2, 0, 1 and so on."""
    return _columns("u1", [[row % 3] for row in range(rows)])


def with_attributes(draft: Draft, attributes: Sequence[Value], payloads: Sequence[bytes]) -> Draft:
    """Return the draft with attributes listed in its root and one segment per attribute payload."""
    added = [Segment(SegmentKind.ATTRIBUTES, i, data) for i, data in enumerate(payloads)]
    whole = with_segments(draft, [*draft.groups[0].segments, *added])
    return replace(whole, root=whole.root | {"attributes": list(attributes)})


def _all_types() -> Valid:
    """Return the vector of extra attributes: one of each type, one of several components."""
    ends: dict[str, list[float]] = {}
    for size in (1, 2, 4):
        ends[f"u{size}"] = [(1 << 8 * size) - 1, 0]
        ends[f"i{size}"] = [-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1]
    for size in (4, 8):
        ends[f"f{size}"] = [float("nan"), -0.0, float("-inf"), 1e-40]
    attributes: list[Value] = []
    parts: list[list[bytes]] = [[], []]
    for kind, values in ends.items():
        attributes.append(_entry(f"of {kind}", kind))
        for chunk, part in enumerate(parts):
            part += _columns(kind, [[values[(row + chunk) % len(values)]] for row in range(2)])
    attributes.append(_entry("Größe", "f4", 3))
    attributes.append(_entry("one", "i2", 1))
    for chunk, part in enumerate(parts):
        part += _columns("f4", [[row + 0.5, -row, chunk] for row in range(2)])
        part += _columns("i2", [[-row - 300 * chunk] for row in range(2)])
    draft = with_attributes(two_chunks(), attributes, [store_planes(part) for part in parts])
    note = "extra attributes of all types, of one value and of several"
    return Valid("attributes", build(draft), ("5.7",), note)


def _packed() -> Valid:
    """Return the vector of an extra attribute whose plane holds several symbols per byte."""
    rows = 3
    frame_of = [[row // 2 * 1000] for row in range(rows)]
    packed = bytes([3]) + pack_symbols(labels(rows)[0], 3)
    planes = [(len(packed) | 1 << 30, packed), *map(plane, _columns("u4", frame_of))]
    attributes = [_entry("label", "u1"), _entry("frame", "u4")]
    note = "attributes whose planes are packed"
    return Valid(
        "attributes-packed",
        build(with_attributes(uniform_chunk(), attributes, [_payload(planes)])),
        ("5.7", "6.9"),
        note,
    )


def _some_chunks() -> Valid:
    """Return the vector of two chunks, one with and one without extra attributes."""
    whole = two_chunks()
    segments = [
        *whole.groups[0].segments,
        Segment(SegmentKind.ATTRIBUTES, 1, store_planes(labels(2))),
    ]
    draft = replace(
        with_segments(whole, segments), root=whole.root | {"attributes": [_entry("label", "u1")]}
    )
    return Valid("attributes-part", build(draft), ("5.7",), "one chunk of two has its attributes")


def _pages() -> Valid:
    """Return the vector of attributes that pages list, and of cameras in the root."""
    whole = two_chunks()
    segments = whole.groups[0].segments
    added = [Segment(SegmentKind.ATTRIBUTES, i, store_planes(labels(2))) for i in range(2)]
    draft = Draft(
        whole.root | {"attributes": [_entry("label", "u1")]},
        [
            Group([*segments[:2], added[0], _camera_segment(1)], [ChunkRow(2)]),
            Group([*segments[2:], added[1]], [ChunkRow(2)]),
        ],
    )
    note = "attributes in the root and in a page, each with its chunk; cameras in the root"
    return Valid("attributes-pages", build(draft), ("5.6", "5.7", "5.8"), note)


def camera_columns(count: int) -> dict[str, Value]:
    """Return the msgpack map of `count` cameras, at most three (SPEC 5.8)."""
    turned = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]

    def column(kind: str, values: Sequence[float]) -> bytes:
        return struct.pack(f"<{len(values)}{kind}", *values)

    return {
        "name": [f"Bild {i}.jpg" if i else "" for i in range(count)],
        "width": column("H", [640, 1, 65535][:count]),
        "height": column("H", [480, 65535, 1][:count]),
        "fx": column("d", [500.5, 1e-3, 1e300][:count]),
        "fy": column("d", [501.25, 2.0, 3.0][:count]),
        "cx": column("d", [320.0, -7.5, 0.0][:count]),
        "cy": column("d", [240.0, 1e9, -0.0][:count]),
        "rotation": column("d", [*turned, *upright, *turned][: 9 * count]),
        "translation": column("d", [0.1, -0.2, 3e5, 0.0, 1e-9, 7.0, 1.0, 2.0, 3.0][: 3 * count]),
    }


def _camera_segment(count: int, **changes: Value) -> Segment:
    """Return a segment of `count` cameras; `changes` replace keys of its map."""
    return Segment(SegmentKind.CAMERAS, 0, pack(camera_columns(count) | changes))


def _with_cameras(*segments: Segment) -> bytes:
    """Return the file of one chunk with camera segments after its head."""
    draft = uniform_chunk()
    return build(with_segments(draft, [*draft.groups[0].segments, *segments]))


def valid() -> list[Valid]:
    """Return the valid vectors of extra attributes and cameras (SPEC 5.7, 5.8)."""
    return [
        _all_types(),
        _packed(),
        _some_chunks(),
        _pages(),
        Valid("cameras", _with_cameras(_camera_segment(3)), ("5.8",), "three cameras"),
        Valid(
            "cameras-more",
            _with_cameras(_camera_segment(1, exposure=b"any")),
            ("4.3", "5.8"),
            "a camera with a key of a later version",
        ),
    ]


def invalid_attributes() -> list[Invalid]:
    """Return the must-reject vectors of extra attributes (SPEC 5.7)."""
    two = store_planes(labels(2))
    good = with_attributes(two_chunks(), [_entry("label", "u1")], [two, two])
    *drawn, first, second = good.groups[0].segments

    def root(name: str, value: Value, code: str, note: str, clause: str = "5.7") -> Invalid:
        return Invalid(
            name, build_edited(uniform_chunk(), key_setter("attributes", value)), code, clause, note
        )

    def order(name: str, segments: Sequence[Segment], note: str) -> Invalid:
        data = build(with_segments(good, segments))
        return Invalid(name, data, "attribute-segments", "5.7", note)

    def body(name: str, data: bytes, code: str, note: str, clause: str = "5.7") -> Invalid:
        draft = with_attributes(uniform_chunk(), [_entry("label", "u1")], [data])
        return Invalid(name, build(draft), code, clause, note, "decode")

    label = _entry("label", "u1")
    unlisted = with_segments(two_chunks(), [*drawn, first])
    three = labels(3)
    many: list[Value] = [_entry(f"{i}", "u1") for i in range(257)]
    huge = plane(bytes(100))
    return [
        root("attributes-text", "label", "root-type", "no array", "4.2"),
        root("attributes-257", many, "root-value", "257 attributes", "4.2"),
        root("attribute-twice", [label, _entry("label", "f4")], "root-value", "a name twice"),
        root("attribute-text", ["label"], "root-type", "an attribute that is no map"),
        root("attribute-no-name", [{"type": "u1"}], "root-missing", "no name"),
        root("attribute-no-type", [{"name": "label"}], "root-missing", "no type"),
        root("attribute-name-empty", [_entry("", "u1")], "root-value", "a name of no bytes"),
        root("attribute-name-256", [_entry("é" * 128, "u1")], "root-value", "256 bytes"),
        root("attribute-f2", [_entry("label", "f2")], "attribute-type-unknown", "a type f2"),
        root("attribute-components-0", [label | {"components": 0}], "root-value",
             "no components"),
        root("attribute-components-17", [_entry("label", "u1", 17)], "root-value",
             "17 components"),
        root("attribute-name-type", [_entry("", "f2")], "root-value", "no name, of a type f2"),
        root("attribute-twice-type", [label, _entry("label", "f2")], "root-value",
             "a name twice, of a type f2"),
        root("attribute-type-components", [_entry("label", "f2", 17) | {"unit!": "m"}],
             "attribute-type-unknown", "a type f2, 17 components and an unknown key with !"),
        root("attribute-key-next", [label | {"unit!": "m"}, label], "root-must-understand",
             "an unknown key with !, then the name again", "4.3"),
        root("must-understand-attribute", [label | {"unit!": "m"}], "root-must-understand",
             "a key with ! in an attribute", "4.3"),
        order("attributes-twice", [*drawn, first, replace(second, owner=0)],
              "two segments of chunk 0"),
        order("attributes-beyond", [*drawn, first, replace(second, owner=2)],
              "attributes of chunk 2 of two"),
        order("attributes-first", [first, *drawn, second], "attributes before the head"),
        Invalid("attributes-unlisted", build(unlisted), "attribute-segments", "5.7",
                "attributes that the root does not list"),
        body("attributes-words", b"\1\0\0", "attribute-record", "less than a word"),
        body("attributes-cut", store_planes(three)[:-1], "attribute-record", "a byte missing"),
        body("attributes-trailing", store_planes(three) + b"\0", "attribute-record", "a byte more"),
        body("attributes-4g", _payload([(0xBFFFFFFF, b"")]), "attribute-record",
             "a plane of 2^30 - 1 bytes stated"),
        body("attributes-plane-short", store_planes(labels(2)), "plane-length",
             "two rows of a chunk of three", "6.3"),
        body("attributes-frame-size", _payload([huge]), "zstd-size",
             "a frame of 100 bytes for three rows", "6.3"),
        body("attributes-radix", _payload([(2 | 1 << 30, b"\x11\0")]), "plane-radix",
             "a radix of 17", "6.9"),
    ]  # fmt: skip


def invalid_cameras() -> list[Invalid]:
    """Return the must-reject vectors of cameras (SPEC 5.8)."""

    def order(name: str, segments: Sequence[Segment], note: str) -> Invalid:
        return Invalid(name, _with_cameras(*segments), "camera-segments", "5.8", note)

    def body(name: str, data: bytes, code: str, note: str, clause: str = "5.8") -> Invalid:
        segment = Segment(SegmentKind.CAMERAS, 0, data)
        return Invalid(name, _with_cameras(segment), code, clause, note, "verify")

    def changed(vector: str, code: str, note: str, **changes: Value) -> Invalid:
        return body(vector, pack(camera_columns(2) | changes), code, note)

    one = _camera_segment(1)
    good = camera_columns(2)
    nameless = {key: value for key, value in good.items() if key != "name"}
    mirrored = struct.pack("<18d", *([-1.0, 0, 0, 0, 1, 0, 0, 0, 1] * 2))
    return [
        order("cameras-twice", [one, one], "two segments of cameras"),
        order("cameras-owner", [replace(one, owner=1)], "cameras of owner 1"),
        body("cameras-cut", pack(good)[:-1], "msgpack-truncated", "the last byte missing", "4.1"),
        body("cameras-none", pack(camera_columns(0)), "root-value", "no camera"),
        body("cameras-no-names", pack(nameless), "root-missing", "no names"),
        body("cameras-must-understand", pack(good | {"lens!": 1}), "root-must-understand",
             "a key with !", "4.3"),
        changed("cameras-names-text", "root-type", "names in one text", name="ab"),
        changed("cameras-names-three", "root-columns", "three names", name=["a", "b", "c"]),
        changed("cameras-names-numbers", "root-columns", "a number as a name", name=["a", 1]),
        changed("cameras-name-256", "root-value", "a name of 256 bytes", name=["a", "x" * 256]),
        changed("cameras-column", "root-columns", "three heights", height=bytes(6)),
        changed("cameras-column-odd", "root-columns", "widths of 3 bytes", width=bytes(3)),
        changed("cameras-width-0", "root-value", "a width of 0", width=bytes(4)),
        changed("cameras-focal", "root-value", "focal lengths of 0", fx=bytes(16)),
        changed("cameras-nan", "root-value", "NaN", cx=struct.pack("<2d", 1.0, float("nan"))),
        changed("cameras-mirrored", "root-value", "mirrored", rotation=mirrored),
        changed("cameras-sheared", "root-value", "rotations of zeros", rotation=bytes(144)),
    ]  # fmt: skip
