"""Must-reject vectors of payloads: records, planes, kinds, heads and tails (SPEC 6, 7)."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import zstandard

from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    PAYLOAD_HEAD,
    Draft,
    Record,
    build,
    one_chunk,
    pack_streams,
    payload,
    poke,
    record,
)
from .invalid import Invalid, chunk_with_codebooks, with_segments

_ROWS: Final = 300
"""Rows of a plane that is long enough for zstd to shrink it."""


def _refused(name: str, data: bytes, code: str, clause: str, note: str) -> Invalid:
    """Return a must-reject vector that decoding refuses."""
    return Invalid(name, data, code, clause, note, "decode")


def _head(*changed: Stream, rows: int = 3) -> bytes:
    """Return a file of one chunk with a random head in which given streams are replaced."""
    return build(one_chunk(pack_streams(handmade.random_head(rows, 1, *changed)), rows))


def _raw(head: bytes, rows: int = 3) -> bytes:
    """Return a file of one chunk, given the payload of its head."""
    return build(one_chunk(head, rows))


def _tail(entries: Sequence[Stream], degree: int = 2) -> bytes:
    """Return a file of one chunk of three splats, given the streams of its tail."""
    head = pack_streams(handmade.uniform_head(3))
    return build(one_chunk(head, 3, tail=pack_streams(entries), sh_degree=degree))


def _records(attribute: Attribute | None = None, **changes: int) -> list[Record]:
    """Return the records of a chunk head, with fields of one attribute's record changed."""
    head = handmade.random_head(3, 1)
    return [record(s, **(changes if s.attribute == attribute else {})) for s in head]


def _opacities(body: Sequence[Stream]) -> int:
    """Return the index of the stream of opacities."""
    return handmade.stream_index(body, Attribute.OPACITIES)


def records() -> list[Invalid]:
    """Return the vectors of invalid payload heads and stream records (SPEC 6.1, 6.2)."""
    head = handmade.random_head(3, 1)
    good = pack_streams(head)

    def bad(name: str, data: bytes, code: str, note: str, clause: str = "6.2") -> Invalid:
        return _refused(name, _raw(data), code, clause, note)

    def field(name: str, attribute: Attribute, code: str, note: str, **changes: int) -> Invalid:
        return bad(name, payload(_records(attribute, **changes)), code, note)

    def renamed(name: str, offset: int, code: str, note: str) -> Invalid:
        return bad(name, poke(good, PAYLOAD_HEAD + offset, "B", 200), code, note)

    extra = _records()
    extra[0].params += b"\0"
    more = _records()
    more[_opacities(head)].planes.append((1, b"\0"))
    infinite = _records()
    floats = handmade.floats(Attribute.OPACITIES, [[0.0]] * 3)
    infinite[_opacities(head)] = record(floats, flags=INFINITIES)
    fewer = _records()
    del fewer[0].planes[-1]
    return [
        bad("payload-1-byte", b"\x05", "stream-record", "a payload of one byte", "6.1"),
        bad("payload-cut", good[: PAYLOAD_HEAD + 7], "stream-record", "ends in a record", "6.1"),
        bad("payload-plane-cut", good[:-1], "stream-record", "ends inside the last plane", "6.1"),
        bad("payload-trailing", good + b"\0", "stream-record", "a byte behind the planes", "6.1"),
        bad("params-beyond", poke(good, PAYLOAD_HEAD + 10, "H", 65535), "stream-record",
            "parameters that leave the payload", "6.1"),
        bad("planes-beyond", poke(good, PAYLOAD_HEAD + 8, "H", 65535), "stream-record",
            "planes that leave the payload", "6.1"),
        bad("streams-65", payload(_records(), count=65), "stream-count", "65 streams", "9.1"),
        renamed("attribute-200", 0, "stream-attribute-unknown", "attribute 200"),
        renamed("kind-200", 1, "stream-kind-unknown", "kind 200"),
        field("components-4", Attribute.MEANS, "stream-record", "four components", components=4),
        field("flag-unknown", Attribute.MEANS, "stream-record", "an unknown flag", flags=4),
        field("infinite-colours", Attribute.SH0, "stream-record", "infinities", flags=INFINITIES),
        bad(
            "infinite-floats",
            payload(infinite),
            "stream-record",
            "the flag infinities on a float stream",
        ),
        field("rows-more", Attribute.OPACITIES, "stream-rows", "4 rows in a chunk of 3", rows=4),
        field("rows-fewer", Attribute.OPACITIES, "stream-rows", "2 rows in a chunk of 3", rows=2),
        field("rows-4g", Attribute.OPACITIES, "stream-rows", "2^32 - 1 rows", rows=0xFFFFFFFF),
        bad("stream-twice", pack_streams([*head, head[-1]]), "stream-duplicate", "sh0 twice"),
        bad("params-longer", payload(extra), "stream-params", "37 bytes of parameters, not 36"),
        bad("plane-more", payload(more), "stream-planes", "a plane more than the grid implies"),
        bad("plane-fewer", payload(fewer), "stream-planes", "a plane less than the grid implies"),
    ]  # fmt: skip


def planes() -> list[Invalid]:
    """Return the vectors of invalid byte planes and zstd frames (SPEC 6.3)."""
    pattern = np.array([row // 30 for row in range(_ROWS)], np.uint8)
    opacities = handmade.scalar(Attribute.OPACITIES, [(-2.0, 2.0, 10)], [pattern.tolist()])
    still = handmade.uniform_head(_ROWS, opacities)
    changed = _opacities(still)
    raw = pattern.tobytes()
    frame: bytes = zstandard.ZstdCompressor(level=19).compress(raw)

    def plane(name: str, word: int, stored: bytes, code: str, note: str) -> Invalid:
        entries = [record(stream) for stream in still]
        entries[changed].planes = [(word, stored)]
        return _refused(name, _raw(payload(entries), _ROWS), code, "6.3", note)

    def zstd(name: str, stored: bytes, code: str, note: str) -> Invalid:
        return plane(name, len(stored) | 1 << 31, stored, f"zstd-{code}", note)

    # RFC 8878, 3.1.1.1: descriptor, window, content size; then one RLE block, the last.
    block = (1 | 1 << 1 | _ROWS << 3).to_bytes(3, "little") + b"\1"
    magic = bytes.fromhex("28b52ffd")
    size_2 = (_ROWS - 256).to_bytes(2, "little")
    skippable = bytes.fromhex("502a4d1804000000") + bytes(4)
    return [
        plane("plane-short", _ROWS - 1, raw[:-1], "plane-length", "299 stored bytes for 300 rows"),
        plane("plane-long", _ROWS + 1, raw + b"\0", "plane-length", "301 stored bytes"),
        zstd("zstd-magic", b"\x29" + frame[1:], "frame", "another magic number"),
        zstd("zstd-legacy", bytes.fromhex("27b52ffd") + frame[4:], "frame", "a frame of zstd 0.7"),
        zstd("zstd-skippable", skippable, "frame", "a skippable frame"),
        zstd("zstd-empty", b"", "frame", "no bytes"),
        zstd("zstd-cut", frame[:-1], "frame", "the last byte missing"),
        zstd("zstd-trailing", frame + b"\0", "frame", "a byte behind the frame"),
        zstd("zstd-two", frame + frame, "frame", "two frames"),
        zstd("zstd-then-skippable", frame + skippable, "frame", "a skippable frame behind"),
        zstd("zstd-reserved-block", magic + b"\x40\0" + size_2 + b"\x07\0\0", "frame",
             "a block of the reserved type"),
        zstd("zstd-less", magic + b"\x40\0" + size_2 +
             (1 | 1 << 1 | (_ROWS - 1) << 3).to_bytes(3, "little") + b"\1", "frame",
             "states 300 bytes and holds 299"),
        zstd("zstd-more", magic + b"\x40\0" + size_2 +
             (1 | 1 << 1 | (_ROWS + 1) << 3).to_bytes(3, "little") + b"\1", "frame",
             "states 300 bytes and holds 301"),
        zstd("zstd-no-size", magic + b"\0\0" + block, "size", "no content size"),
        zstd("zstd-size", magic + b"\x40\0" + (_ROWS - 255).to_bytes(2, "little") + block, "size",
             "states 301 bytes for 300 rows"),
        zstd("zstd-size-2-40", magic + b"\xc0\0" + (1 << 40).to_bytes(8, "little") + block, "size",
             "states 2^40 bytes"),
        zstd("zstd-window", magic + b"\x40\x70" + size_2 + block, "window", "a window of 16 MiB"),
        zstd("zstd-dictionary", magic + b"\x41\0\x07" + size_2 + block, "dictionary",
             "needs dictionary 7"),
        zstd("zstd-checksum",
             zstandard.ZstdCompressor(level=19, write_checksum=True).compress(raw), "checksum",
             "a checksum of its own, and right"),
    ]  # fmt: skip


def grids() -> list[Invalid]:
    """Return the vectors of invalid grids, quaternions and floats (SPEC 6.4, 6.6, 6.8)."""
    means = [(-1.0, 1.0, 4)] * 3
    codes = [[0, 1, 2]] * 3

    def bad(name: str, stream: Stream, code: str, clause: str, note: str) -> Invalid:
        return _refused(name, _head(stream), code, clause, note)

    def grid(name: str, low: float, high: float, levels: int, code: str, note: str) -> Invalid:
        params = struct.pack("<ffI", low, high, levels)
        good = handmade.scalar(Attribute.MEANS, means, codes)
        return bad(name, replace(good, params=good.params[:24] + params), code, "6.4", note)

    quats = handmade.random_quats(3, 1)
    rows = handmade.random_quats(3, 1, largest=[0, 1, 2])
    past = handmade.scalar(Attribute.MEANS, means, [[0, 1, 4], [0] * 3, [0] * 3])
    opacities = handmade.scalar(Attribute.OPACITIES, [(0.0, 1.0, 4)], [[0, 5, 6]], flags=INFINITIES)
    infinite = replace(
        handmade.scalar(Attribute.OPACITIES, [(0.0, 1.0, 9)], [[0, 1, 2]], flags=INFINITIES),
        params=struct.pack("<ffI", 0.0, 1.0, (1 << 24) - 1),
        planes=[np.zeros(3, np.uint8)] * 3,
    )
    return [
        grid("grid-nan", math.nan, 1.0, 4, "grid-value", "a minimum of NaN"),
        grid("grid-infinite", -1.0, math.inf, 4, "grid-value", "an infinite maximum"),
        grid("grid-huge", -1.3e30, 1.0, 4, "grid-value", "a minimum below -2^100"),
        grid("grid-turned", 1.0, -1.0, 4, "grid-value", "minimum above maximum"),
        grid("grid-0-levels", -1.0, 1.0, 0, "grid-levels", "no level"),
        grid("grid-many-levels", -1.0, 1.0, (1 << 24) + 1, "grid-levels", "2^24 + 1 levels"),
        bad("infinities-levels", infinite, "grid-levels", "6.4",
            "2^24 - 1 levels and two codes more"),
        bad("code-past", past, "code-range", "6.4", "code 4 of 4 levels"),
        bad("code-past-infinity", opacities, "code-range", "6.4", "code 6 of 4 levels and two"),
        bad("quats-wide", handmade.random_quats(3, 1, ranges=[(-1.5, 1.0, 4)] * 3), "grid-value",
            "6.6",
            "components down to -1.5"),
        bad("quats-largest-4", replace(quats, params=b"\4" + quats.params[1:]), "quat-largest",
            "6.6", "component 4 left out"),
        bad("quats-padding", replace(quats, params=b"\0\1" + quats.params[2:]), "quat-largest",
            "6.6", "a padding byte set"),
        bad("quats-row-4", replace(rows, planes=[np.array([0, 4, 2], np.uint8), *rows.planes[1:]]),
            "quat-largest", "6.6", "component 4 left out in one row"),
        bad("quats-params", replace(quats, params=quats.params[:-1]), "stream-params", "6.2",
            "39 bytes of parameters, not 40"),
        bad("float-nan", handmade.floats(Attribute.SH0, [[0.0, math.nan, 0.0]] * 3), "float-value",
            "6.8", "NaN in sh0"),
        bad("float-infinite", handmade.floats(Attribute.MEANS, [[math.inf, 0.0, 0.0]] * 3),
            "float-value", "6.8", "an infinite mean"),
        bad("float-huge", handmade.floats(Attribute.SCALES, [[-1.3e30, 0.0, 0.0]] * 3),
            "float-value",
            "6.8", "a value below -2^100"),
        bad("float-opacity-nan", handmade.floats(Attribute.OPACITIES, [[math.nan]] * 3),
            "float-value", "6.8", "an opacity of NaN"),
        bad("float-params", replace(handmade.floats(Attribute.OPACITIES, [[0.0]] * 3),
            params=b"\0"),
            "stream-params", "6.2", "parameters where there are none"),
    ]  # fmt: skip


def sorted_means() -> list[Invalid]:
    """Return the vectors of invalid sorted means (SPEC 6.5)."""
    ranges = [(-1.0, 1.0, 8)] * 3
    wide = [(-1.0, 1.0, 1 << 17)] * 3
    good = handmade.sorted_means([[1, 2, 3], [4, 5, 6], [7, 7, 7]], ranges)

    def bad(
        name: str,
        code: str,
        note: str,
        classes: Sequence[int] = (),
        bits: bytes = b"",
        clause: str = "6.5",
    ) -> Invalid:
        planes = [np.array(classes, np.uint8), np.frombuffer(bits, np.uint8), good.planes[2]]
        stream = replace(good, params=handmade.grid(wide).pack() + good.params[36:], planes=planes)
        return _refused(name, _head(stream), code, clause, note)

    many = replace(
        good, params=handmade.grid([(-1.0, 1.0, (1 << 17) + 1)] * 3).pack() + good.params[36:]
    )
    past = handmade.sorted_means([[0, 0, 0], [0, 0, 1], [0, 0, 9]], ranges)
    no_model = replace(good, params=good.params[:36])
    return [
        bad("morton-class-52", "morton-class", "a difference of 52 bits", [0, 52, 0], bytes(7)),
        bad("morton-padding", "bits-padding", "a padding bit set", [2, 0, 0], b"\x80",
            clause="6.15"),
        bad("morton-range", "morton-range", "differences that sum to 2^51", [51, 51, 0],
            bytes(13)),
        bad("morton-bits-short", "plane-length", "differences one byte short", [9, 9, 0], b"\0",
            "6.3"),
        _refused("sorted-2-planes", _head(replace(good, planes=good.planes[:2])), "stream-planes",
                 "6.2", "two planes, not three"),
        _refused("sorted-levels", _head(many), "grid-levels", "6.4", "2^17 + 1 levels"),
        _refused("sorted-past", _head(past), "code-range", "6.5", "cell 9 of 8 levels"),
        _refused("sorted-grid-alone", _head(no_model), "stream-params", "6.2",
                 "36 bytes of parameters, not 60"),
    ]  # fmt: skip


def _books(
    head: Sequence[Stream], tail: Sequence[Stream], needs: tuple[int, ...] = (0, 1)
) -> bytes:
    """Return the file of `chunk_with_codebooks` with another head and tail."""
    draft: Draft = chunk_with_codebooks()
    segments = list(draft.groups[0].segments[:3])
    segments.append(Segment(SegmentKind.HEAD, 0, pack_streams(head), needs))
    segments.append(Segment(SegmentKind.TAIL, 0, pack_streams(tail), needs))
    return build(with_segments(draft, segments))


def codebooks() -> list[Invalid]:
    """Return the vectors of invalid codebook indices (SPEC 6.7) and exclusive streams (SPEC 7)."""
    shape = handmade.vq(Attribute.SHAPE, [0, 4, 2], 0, 5, 0)
    colour = handmade.vq(Attribute.SHN, [1, 0, 3], 1, 4, 0)
    head = handmade.vq_head(3, 1, shape, still=True)
    own = [
        handmade.random_scalar(Attribute.SCALES, 1, 3, escape=True),
        handmade.random_quats(1, 4, escape=True),
    ]
    with_own = handmade.vq(Attribute.SHAPE, [0, 5, 2], 0, 5, 1)

    def bad(
        name: str,
        code: str,
        clause: str,
        note: str,
        *,
        shape: Stream = shape,
        escape: Sequence[Stream] = (),
        tail: Sequence[Stream] = (colour,),
        needs: tuple[int, ...] = (0, 1),
    ) -> Invalid:
        data = _books(handmade.vq_head(3, 1, shape, *escape, still=True), tail, needs)
        return _refused(name, data, code, clause, note)

    def index(attribute: Attribute, codes: Sequence[int], book: int, escape: int = 0) -> Stream:
        return handmade.vq(attribute, codes, book, 5, escape)

    scalar_shape = handmade.random_scalar(Attribute.SHAPE, 3, 1)
    many_escape = index(Attribute.SHAPE, [0, 1, 2], 0, 4)
    short = replace(shape, params=shape.params[:7])
    mixed = [*head, handmade.random_scalar(Attribute.SCALES, 3, 1)]
    lone = [stream for stream in head if stream.attribute != Attribute.SCALE_FACTOR]
    return [
        bad("index-past", "index-range", "6.7", "row 5 of 5",
            shape=index(Attribute.SHAPE, [0, 5, 2], 0)),
        bad("index-past-escape", "index-range", "6.7", "index 6, where 5 stands for escape rows",
            shape=index(Attribute.SHAPE, [0, 6, 5], 0, 1), escape=own),
        bad("index-escape-more", "index-range", "6.7", "two indices of one escape row",
            shape=index(Attribute.SHAPE, [5, 5, 2], 0, 1), escape=own),
        bad("index-escape-fewer", "index-range", "6.7", "no index of an escape row",
            shape=index(Attribute.SHAPE, [0, 1, 2], 0, 1), escape=own),
        bad("book-not-needed", "codebook-missing", "6.7", "a codebook used but not in needs",
            needs=(1,)),
        bad("book-of-colours", "codebook-missing", "6.7", "shapes from a codebook of colours",
            shape=index(Attribute.SHAPE, [0, 1, 2], 1)),
        bad("book-of-shapes", "codebook-missing", "6.7", "colours from a codebook of shapes",
            tail=[index(Attribute.SHN, [0, 1, 2], 0)]),
        bad("book-99", "codebook-missing", "6.7", "codebook 99",
            shape=index(Attribute.SHAPE, [0, 1, 2], 99)),
        bad("escape-more-than-rows", "stream-rows", "6.7", "4 escape rows in a chunk of 3",
            shape=many_escape, escape=own),
        bad("escape-none", "stream-missing", "7.2", "an escape row stated, none there",
            shape=with_own),
        bad("escape-two", "stream-rows", "6.2", "one escape row stated, two there", shape=with_own,
            escape=[handmade.random_scalar(Attribute.SCALES, 2, 3, escape=True), own[1]]),
        bad("escape-unstated", "stream-unexpected", "7.2", "escape rows not stated", escape=own),
        bad("vq-params", "stream-params", "6.2", "7 bytes of parameters, not 8", shape=short),
        bad("shape-scalar", "stream-kind", "6.2", "shapes as a scalar stream", shape=scalar_shape),
        bad("tail-mixed", "stream-unexpected", "7.3", "a codebook's colours and a band beside them",
            tail=[colour, handmade.band(1, 3, 1)]),
        _refused("head-mixed", _books(mixed, [colour]), "stream-unexpected", "7.2",
                 "shapes from a codebook and scales beside them"),
        _refused("factor-missing", _books(lone, [colour]), "stream-missing", "7.2",
                 "shapes from a codebook without a scale factor"),
    ]  # fmt: skip


def heads_and_tails() -> list[Invalid]:
    """Return the vectors of streams missing, in the wrong payload or of the wrong kind (SPEC 7)."""
    head = handmade.random_head(3, 1)

    def lacks(attribute: Attribute) -> bytes:
        return _raw(pack_streams([stream for stream in head if stream.attribute != attribute]))

    def kind(name: str, stream: Stream, note: str) -> Invalid:
        return _refused(name, _head(stream), "stream-kind", "6.2", note)

    flagged = [replace(head[0], flags=head[0].flags | ESCAPE), *head[1:]]
    three = handmade.bands(2, 3, 5)
    still = handmade.random_scalar(Attribute.QUATS, 3, 1, span=0.2)
    codes = handmade.vq(Attribute.OPACITIES, [0, 1, 2], 0, 5, 0)
    cells = replace(
        handmade.sorted_means([[0, 1, 2]] * 3, [(-1.0, 1.0, 8)] * 3), attribute=Attribute.SH0
    )
    turned = replace(handmade.random_quats(3, 1), attribute=Attribute.SCALES)
    return [
        *(_refused(f"no-{a.name.lower()}", lacks(a), "stream-missing", "7.2", "one missing")
          for a in (Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0, Attribute.SCALES,
                    Attribute.QUATS)),
        _refused("no-streams", _raw(pack_streams([])), "stream-missing", "7.2", "an empty head"),
        _refused("head-band", _raw(pack_streams([*head, handmade.band(1, 3, 1)])),
                 "stream-unexpected", "7.2", "an SH band in a head"),
        _refused("head-escape", _raw(pack_streams(flagged)), "stream-missing", "7.2",
                 "scales that say they are escape rows"),
        _refused("tail-band-above", _tail([*three, handmade.band(3, 3, 5)]), "stream-unexpected",
                 "7.3", "a third band at SH degree 2"),
        _refused("tail-sh0", _tail([*three, head[-1]]), "stream-unexpected", "7.3",
                 "sh0 in a tail"),
        _refused("tail-escape", _tail([handmade.band(1, 3, 5, escape=True)]),
                 "stream-unexpected", "7.3", "escape rows without indices"),
        kind("quats-scalar", still, "quats as a scalar stream"),
        kind("opacities-vq", codes, "opacities as indices"),
        kind("sh0-sorted", cells, "sh0 as a sorted stream"),
        kind("scales-quat", turned, "scales as a quat stream"),
        _refused("shn-scalar", _tail([replace(handmade.band(1, 3, 1), attribute=Attribute.SHN,
                                              kind=Kind.SCALAR)]),
                 "stream-kind", "6.2", "shN as a scalar stream"),
        _book_streams("book-no-quats", handmade.shape_codebook(5, 1)[:1], "stream-missing",
                      "a shape codebook without quats"),
        _book_streams("book-opacities", [*handmade.shape_codebook(5, 1),
                                         handmade.random_scalar(Attribute.OPACITIES, 5, 1)],
                      "stream-unexpected", "opacities in a shape codebook"),
        _book_streams("book-rows", handmade.shape_codebook(4, 1), "stream-rows",
                      "4 rows in a codebook of 5", "6.2"),
        _book_streams("book-band-wrong", [handmade.band(1, 4, 2)], "stream-unexpected",
                      "the first band in the second band's segment", segment=2),
    ]  # fmt: skip


def _book_streams(
    name: str,
    body: Sequence[Stream],
    code: str,
    note: str,
    clause: str = "7.1",
    *,
    segment: int = 0,
) -> Invalid:
    """Return a vector in which one codebook segment's streams are replaced."""
    draft = chunk_with_codebooks()
    segments = list(draft.groups[0].segments)
    segments[segment] = replace(segments[segment], payload=pack_streams(body))
    return _refused(name, build(with_segments(draft, segments)), code, clause, note)
