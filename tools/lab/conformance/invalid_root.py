"""Must-reject vectors of the preamble, of the msgpack subset and of the root (SPEC 3, 4)."""

from __future__ import annotations

import math
import struct

from cogsplat.formats.cogs.canonical_msgpack import Value
from cogsplat.formats.cogs.layout import MAGIC

from .file_builder import Index, build, claimed_pages, poke, preamble_field, split_root, with_root
from .invalid import Invalid, build_edited, key_setter, no_splats, paged_chunks, uniform_chunk


def preambles() -> list[Invalid]:
    """Return the vectors of invalid preambles (SPEC 3)."""
    good = build(no_splats())
    root_end = 64 + len(split_root(good)[0])
    longer = build(uniform_chunk())
    zeros = bytes(8)

    def field(name: str, offset: int, layout: str, value: int, code: str, note: str) -> Invalid:
        data = preamble_field(good, offset, layout, value)
        clauses = {"version-major": "3.2", "version-minor": "3.2", "preamble-reserved": "3.1"}
        clause = clauses.get(code, "3.3")
        return Invalid(name, data, code, clause, note)

    def magic(name: str, data: bytes, note: str) -> Invalid:
        return Invalid(name, data, "not-cogs", "3.1", note)

    return [
        Invalid("empty-file", b"", "preamble-truncated", "3.1", "no byte at all"),
        Invalid("preamble-short", good[:63], "preamble-truncated", "3.1", "63 bytes"),
        magic("magic-ply", b"ply\nformat binary_little_endian 1.0\n" + zeros * 8, "a PLY file"),
        magic("magic-gzip", b"\x1f\x8b\x08" + zeros * 8, "gzip"),
        magic("magic-reversed", MAGIC[::-1] + good[8:], "the magic in reverse byte order"),
        magic("magic-manifest", b"\x89COGM\r\n\x1a" + good[8:], "the manifest of a folder"),
        magic("magic-text", good.replace(b"\r\n", b"\n", 1), "sent as text: CR LF became LF"),
        Invalid(
            "preamble-flip",
            poke(good, 17, "B", good[17] ^ 4),
            "preamble-crc",
            "3.1",
            "a bit flipped",
        ),
        field("reserved-28", 28, "I", 1, "preamble-reserved", "a reserved byte set"),
        field("reserved-59", 59, "B", 128, "preamble-reserved", "the last reserved byte set"),
        field("version-1", 8, "H", 1, "version-major", "version 1.2"),
        field("version-65535", 8, "H", 65535, "version-major", "version 65535.2"),
        field("version-0-0", 10, "H", 0, "version-minor", "version 0.0"),
        field("version-0-1", 10, "H", 1, "version-minor", "version 0.1"),
        field("version-0-2", 10, "H", 2, "version-minor", "version 0.2"),
        field("version-0-4", 10, "H", 4, "version-minor", "version 0.4"),
        field("version-0-65535", 10, "H", 65535, "version-minor", "version 0.65535"),
        field("root-none", 12, "I", 0, "root-length", "a root of no bytes"),
        field("root-long", 12, "I", 16321, "root-length", "a root that ends at byte 16385"),
        field("root-huge", 12, "I", 0xFFFFFFFF, "root-length", "a root of 4 GiB"),
        field("file-short", 16, "Q", root_end - 1, "file-length", "a file that ends in its root"),
        field("file-none", 16, "Q", 0, "file-length", "a file of no bytes"),
        field("file-huge", 16, "Q", 1 << 53, "file-length", "a file of 2^53 bytes"),
        field("file-wraps", 16, "Q", (1 << 64) - 1, "file-length", "a file of 2^64 - 1 bytes"),
        Invalid("root-cut", longer[:200], "root-truncated", "3.3", "ends inside the root"),
        Invalid("root-flip", poke(good, 80, "B", good[80] ^ 1), "root-crc", "3.3", "a bit flipped"),
        Invalid(
            "file-cut", longer[:-1], "file-truncated", "3.3", "the last byte missing", partial=True
        ),
        Invalid("file-trailing", good + b"\0", "file-trailing", "3.3", "a byte behind the end"),
    ]


def packings() -> list[Invalid]:
    """Return the vectors of roots outside the msgpack subset (SPEC 4.1)."""
    root, behind = split_root(build(no_splats()))
    keys = root[0]

    def added(raw: bytes) -> bytes:
        """Return the packed root with the bytes of one more entry appended."""
        return bytes([keys + 1]) + root[1:] + raw

    def entry(name: str, raw: bytes, code: str, note: str) -> Invalid:
        return refused(name, added(b"\xa1x" + raw), code, note)

    def refused(name: str, data: bytes, code: str, note: str) -> Invalid:
        return Invalid(name, with_root(data, behind), f"msgpack-{code}", "4.1", note)

    return [
        refused("msgpack-cut", root[:-1], "truncated", "the last byte of the last value missing"),
        entry("msgpack-array-4g", b"\xdd\xff\xff\xff\xff", "truncated", "an array of 2^32 - 1"),
        entry("msgpack-map-4g", b"\xdf\xff\xff\xff\xff", "truncated", "a map of 2^32 - 1"),
        entry("msgpack-bin-4g", b"\xc6\xff\xff\xff\xff", "truncated", "a bin of 2^32 - 1 bytes"),
        entry("msgpack-str-4g", b"\xdb\xff\xff\xff\xff", "truncated", "a str of 2^32 - 1 bytes"),
        refused("msgpack-trailing", root + b"\xc0", "trailing", "a nil behind the root"),
        entry("msgpack-c1", b"\xc1", "invalid", "the reserved byte"),
        entry("msgpack-deep-9", b"\x91" * 8 + b"\x90", "depth", "nine levels, the root one"),
        entry("msgpack-deep-2000", b"\x91" * 2000, "depth", "2,000 levels"),
        refused("msgpack-twice", added(b"\xa6writer\xa1y"), "duplicate-key", "a key twice"),
        entry(
            "msgpack-twice-inside", b"\x82\xa1a\x01\xa1a\x01", "duplicate-key", "in an inner map"
        ),
        refused("msgpack-key-int", added(b"\x01\x01"), "key", "an integer as a key"),
        refused("msgpack-key-array", added(b"\x91\x01\x01"), "key", "an array as a key"),
        refused("msgpack-key-bin", added(b"\xc4\x01a\x01"), "key", "bytes as a key"),
        refused("msgpack-key-utf8", added(b"\xa1\xff\x01"), "utf8", "a key that is not UTF-8"),
        entry("msgpack-surrogate", b"\xa3\xed\xa0\x80", "utf8", "half a surrogate pair"),
        entry("msgpack-overlong", b"\xa2\xc0\x80", "utf8", "a zero in two bytes"),
        entry("msgpack-ext", b"\xd4\x05\x00", "type", "an extension"),
        entry("msgpack-timestamp", b"\xd6\xff\x00\x00\x00\x00", "type", "a timestamp"),
        refused("msgpack-array", b"\x90", "type", "an array in place of the root's map"),
        entry("msgpack-uint-2-53", b"\xcf\x00\x20" + bytes(6), "integer", "2^53"),
        entry("msgpack-uint-max", b"\xcf" + b"\xff" * 8, "integer", "2^64 - 1"),
        entry("msgpack-int-min", b"\xd3\x80" + bytes(7), "integer", "-2^63"),
        entry("msgpack-float32", b"\xca" + bytes(4), "canonical", "a float32"),
        entry("msgpack-uint8", b"\xcc\x7f", "canonical", "127 in two bytes"),
        entry("msgpack-uint16", b"\xcd\x00\xff", "canonical", "255 in three bytes"),
        entry("msgpack-uint32", b"\xce\x00\x00\xff\xff", "canonical", "65535 in five bytes"),
        entry("msgpack-uint64", b"\xcf" + bytes(4) + b"\xff" * 4, "canonical", "2^32 - 1 in nine"),
        entry("msgpack-int8", b"\xd0\x05", "canonical", "5 as a signed integer"),
        entry("msgpack-int8-minus", b"\xd0\xe0", "canonical", "-32 in two bytes"),
        entry("msgpack-int16", b"\xd1\xff\x80", "canonical", "-128 in three bytes"),
        entry("msgpack-str8", b"\xd9\x01a", "canonical", "a str of 1 with a length byte"),
        entry("msgpack-str16", b"\xda\x00\x20" + b"a" * 32, "canonical", "a str of 32, two bytes"),
        entry("msgpack-bin16", b"\xc5\x00\x01a", "canonical", "a bin of 1 with two length bytes"),
        entry("msgpack-array16", b"\xdc\x00\x01\xc0", "canonical", "an array of 1, two bytes"),
        entry("msgpack-map16", b"\xde\x00\x00", "canonical", "an empty map, two length bytes"),
    ]


def _without(index: Index, key: str) -> None:
    """Delete a key of an index."""
    del index[key]


def roots() -> list[Invalid]:
    """Return the vectors of root keys with invalid values (SPEC 4.2 to 4.4, 5.5)."""

    def value(name: str, key: str, content: Value, note: str, code: str = "root-value") -> Invalid:
        return Invalid(name, build_edited(no_splats(), key_setter(key, content)), code, "4.2", note)

    def wrong(name: str, key: str, content: Value, note: str) -> Invalid:
        return value(name, key, content, note, "root-type")

    numbers: list[Value] = [0.0] * 6
    book: Value = {"attribute": "shape", "rows": 1}
    return [
        Invalid(
            "root-no-splats",
            build_edited(no_splats(), lambda index: _without(index, "splats")),
            "root-missing",
            "4.2",
            "no key splats",
        ),
        Invalid(
            "root-no-chunks",
            build_edited(no_splats(), lambda index: _without(index, "chunks")),
            "root-missing",
            "4.2",
            "no key chunks",
        ),
        wrong("splats-text", "splats", "3", "a str for a count"),
        wrong("splats-float", "splats", 3.0, "a float for a count"),
        wrong("splats-true", "splats", True, "a bool for a count"),
        wrong("writer-bin", "writer", b"cogsplat", "bytes for a text"),
        wrong("antialiased-1", "antialiased", 1, "an integer for a bool"),
        wrong("kernel-integer", "kernel_px", 0, "an integer for a float"),
        wrong("codebooks-map", "codebooks", {}, "a map for an array"),
        wrong("segments-array", "segments", [], "an array for a map"),
        wrong("first-view-nil", "first_view", None, "nil for a map"),
        value("splats-negative", "splats", -1, "a negative count"),
        value("splats-2-31", "splats", 1 << 31, "2^31 splats"),
        value("sh-degree-4", "sh_degree", 4, "SH degree 4"),
        value("origin-two", "origin", [0.0, 0.0], "two numbers"),
        value("origin-integers", "origin", [0, 0, 0], "integers for floats"),
        value("origin-nan", "origin", [0.0, math.nan, 0.0], "NaN"),
        value("kernel-negative", "kernel_px", -0.3, "a negative variance"),
        value("kernel-infinite", "kernel_px", math.inf, "an infinite variance"),
        value("axes-twice", "axes", "RLF", "right and left, neither up nor down"),
        value("axes-lower", "axes", "rdf", "lower case"),
        value("box-turned", "box", [1.0, *numbers[:5]], "minimum above maximum"),
        value("box-infinite", "box", [-math.inf, *numbers[:5]], "an infinite corner"),
        value("writer-256", "writer", "x" * 256, "a text of 256 bytes"),
        value("codebooks-33", "codebooks", [book] * 33, "33 codebooks"),
        Invalid(
            "pages-129",
            build_edited(no_splats(), key_setter("pages", claimed_pages(129, 1))),
            "root-value",
            "5.6",
            "129 pages",
        ),
        value(
            "colour-cmyk", "colour_space", "cmyk", "an unknown colour space", "colour-space-unknown"
        ),
        *_must_understand(),
        *_first_views(),
        value("up-two", "up", [0.0, 1.0], "two numbers"),
        value("up-integers", "up", [0, 1, 0], "integers for floats"),
        value("up-zero", "up", numbers[:3], "no direction"),
        value("up-long", "up", [0.0, 1.001, 0.0], "a vector longer than 1"),
        value("up-nan", "up", [0.0, math.nan, 1.0], "NaN"),
        wrong("up-text", "up", "y", "a str for an array"),
        value("core-box-five", "core_box", numbers[:5], "five numbers"),
        value("core-box-turned", "core_box", [1.0, *numbers[:5]], "minimum above maximum"),
        value("core-box-outside", "core_box", [*numbers[:5], 8.5], "a corner outside the box"),
        value("capture-none", "capture", b"", "no viewpoint"),
        value("capture-65", "capture", _viewpoint() * 65, "65 viewpoints"),
        value("capture-nan", "capture", _viewpoint(y=math.nan), "NaN"),
        value("capture-infinite", "capture", _viewpoint(y=math.inf), "an infinite position"),
        value("capture-focal", "capture", _viewpoint(focal=0.0), "a focal length of 0"),
        value(
            "capture-short", "capture", _viewpoint()[:15], "15 bytes of a viewpoint", "root-columns"
        ),
        wrong("capture-array", "capture", [0.0, 0.0, 0.0, 1.0], "an array for a bin"),
        *_codebooks(),
    ]


def _viewpoint(*, y: float = 2.0, focal: float = 500.0) -> bytes:
    """Return a capture viewpoint."""
    return struct.pack("<4f", 1.0, y, -3.0, focal)


def _must_understand() -> list[Invalid]:
    """Return the vectors of an unknown key that ends in ``!``, in each map of the index."""
    book: Value = {"attribute": "shape", "rows": 1, "new!": 1}
    places = {
        "root": build_edited(no_splats(), key_setter("new!", None)),
        "segments": build_edited(no_splats(), key_setter("new!", 1, within="segments")),
        "chunks": build_edited(no_splats(), key_setter("new!", 1, within="chunks")),
        "codebook": build_edited(no_splats(), key_setter("codebooks", [book])),
        "first-view": build_edited(no_splats(), key_setter("first_view", _view() | {"new!": 1})),
        "page": build_edited(paged_chunks(), key_setter("new!", 1), 1),
        "pages": build_edited(paged_chunks(), key_setter("new!", 1, within="pages")),
    }
    return [
        Invalid(
            f"must-understand-{place}",
            data,
            "root-must-understand",
            "4.3",
            f"a key new! in {place}",
        )
        for place, data in places.items()
    ]


def _view() -> Index:
    """Return a valid value of the key ``first_view``."""
    return {
        "width": 640,
        "height": 480,
        "fx": 500.0,
        "fy": 500.0,
        "cx": 320.0,
        "cy": 240.0,
        "rotation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "translation": [0.0, 0.0, 4.0],
    }


def _first_views() -> list[Invalid]:
    """Return the vectors of invalid values of the key ``first_view``."""

    def view(name: str, change: Index, note: str, code: str = "root-value") -> Invalid:
        data = build_edited(no_splats(), key_setter("first_view", _view() | change))
        return Invalid(f"view-{name}", data, code, "4.4", note)

    mirrored: list[Value] = [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    sheared: list[Value] = [1.0, 0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return [
        view("width-0", {"width": 0}, "no pixels"),
        view("height-65536", {"height": 65536}, "65536 pixels high"),
        view("focal-negative", {"fx": -500.0}, "a negative focal length"),
        view("mirrored", {"rotation": mirrored}, "a mirror image for a rotation"),
        view("sheared", {"rotation": sheared}, "a shear for a rotation"),
        view("target-two", {"target": [0.0, 0.0]}, "a target of two numbers"),
        view("target-behind", {"target": [0.0, 0.0, -5.0]}, "a target behind the camera"),
        view("target-at-camera", {"target": [0.0, 0.0, -4.0]}, "a target at the camera's depth"),
        view("target-infinite", {"target": [0.0, 0.0, math.inf]}, "an infinite target"),
        view("target-nil", {"target": None}, "nil for an array", "root-type"),
        view("translation-nan", {"translation": [0.0, 0.0, math.nan]}, "NaN"),
        view("focal-integer", {"fy": 500}, "an integer for a float", "root-type"),
    ]


def _codebooks() -> list[Invalid]:
    """Return the vectors of invalid entries of the key ``codebooks``."""

    def book(name: str, attribute: str, rows: int, code: str, note: str) -> Invalid:
        entry: list[Value] = [{"attribute": attribute, "rows": rows}]
        data = build_edited(no_splats(), key_setter("codebooks", entry))
        return Invalid(name, data, code, "5.5", note)

    return [
        book("codebook-0-rows", "shape", 0, "root-value", "a codebook of no rows"),
        book("codebook-65537-rows", "shape", 65537, "root-value", "65537 rows"),
        book("codebook-of-means", "means", 8, "codebook-unknown", "a codebook of means"),
    ]
