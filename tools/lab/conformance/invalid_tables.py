"""Must-reject vectors of tables, pages and the order of segments (SPEC 5, 9.1)."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

from cogsplat.formats.cogs.canonical_msgpack import Value
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    Index,
    build,
    column,
    pack_streams,
    poke,
    root_keys,
    table,
)
from .invalid import (
    Invalid,
    build_edited,
    chunk_with_codebooks,
    chunk_with_tail,
    key_setter,
    no_splats,
    paged_chunks,
    two_chunks,
    uniform_chunk,
    with_segments,
)


def _poked(
    draft: Draft, name: str, key: str, offset: int, layout: str, value: float, number: int = 0
) -> bytes:
    """Return the file of a draft with one number overwritten in a column of a table."""

    def change(index: Index) -> None:
        table(index, name)[key] = poke(column(index, name, key), offset, layout, value)

    return build_edited(draft, change, number)


def _without(draft: Draft, name: str, key: str) -> bytes:
    """Return the file of a draft with one column deleted from a table of its root."""
    return build_edited(draft, lambda index: table(index, name).pop(key))


def segment_tables() -> list[Invalid]:
    """Return the vectors of invalid segment tables (SPEC 5.1 to 5.3)."""

    def bad(name: str, data: bytes, code: str, note: str, clause: str = "5.3") -> Invalid:
        return Invalid(name, data, code, clause, note)

    def cut(key: str, count: int) -> bytes:
        return build_edited(
            uniform_chunk(),
            lambda i: table(i, "segments").update({key: column(i, "segments", key)[:-count]}),
        )

    whole = build(uniform_chunk())
    short = _poked(uniform_chunk(), "segments", "length", 0, "I", 100)
    zero = with_segments(
        uniform_chunk(), [*uniform_chunk().groups[0].segments, Segment(200, 0, b"")]
    )
    return [
        bad("segments-no-crc", _without(uniform_chunk(), "segments", "crc"), "root-missing",
            "no CRCs"),
        bad(
            "segments-text",
            build_edited(uniform_chunk(), key_setter("kind", "\x01", within="segments")),
            "root-type",
            "kinds as str",
        ),
        bad("segments-column-short", cut("owner", 4), "root-columns", "one owner less than kinds"),
        bad("segments-column-odd", cut("length", 1), "root-columns", "lengths of 3 bytes"),
        bad("segments-hash-short", cut("hash", 1), "root-columns", "a hash of 15 bytes"),
        bad("segment-empty", build(zero), "root-value", "a segment of 0 bytes"),
        bad("segment-longer", _poked(uniform_chunk(), "segments", "length", 0, "I", 0xFFFFFFFF),
            "segments-length", "a segment of 4 GiB", "5.1"),
        bad("segment-shorter", short, "segments-length", "bytes that no segment holds", "5.1"),
        bad(
            "segment-kind-0",
            _poked(uniform_chunk(), "segments", "kind", 0, "B", 0),
            "segment-kind-unknown",
            "kind 0",
            "5.2",
        ),
        bad(
            "segment-kind-127",
            _poked(uniform_chunk(), "segments", "kind", 0, "B", 127),
            "segment-kind-unknown",
            "kind 127",
            "5.2",
        ),
        bad("needs-none", _poked(uniform_chunk(), "segments", "needs", 0, "I", 1), "needs-range",
            "a codebook needed where there are none"),
        bad("needs-third", _poked(chunk_with_codebooks(), "segments", "needs", 12, "I", 1 << 31),
            "needs-range",
            "codebook 31 needed where there are two"),
        Invalid("segment-flip", whole[:-1] + bytes([whole[-1] ^ 1]), "segment-crc", "5.3",
                "a bit of a head flipped", "decode"),
        Invalid("segment-crc-wrong", _poked(uniform_chunk(), "segments", "crc", 0, "I", 7),
                "segment-crc",
                "5.3", "another CRC in the table", "decode"),
        Invalid("segment-hash-wrong", _poked(uniform_chunk(), "segments", "hash", 3, "B", 0),
                "segment-hash", "5.3", "another hash in the table", "verify"),
    ]  # fmt: skip


def chunk_tables() -> list[Invalid]:
    """Return the vectors of invalid chunk tables (SPEC 5.4)."""

    def value(name: str, key: str, offset: int, layout: str, number: float, note: str) -> Invalid:
        data = _poked(uniform_chunk(), "chunks", key, offset, layout, number)
        return Invalid(name, data, "root-value", "5.4", note)

    def order(name: str, segments: list[Segment], code: str, note: str) -> Invalid:
        return Invalid(name, build(with_segments(two_chunks(), segments)), code, "5.4", note)

    def total(name: str, draft: Draft, splats: int, note: str) -> Invalid:
        data = build_edited(draft, key_setter("splats", splats))
        return Invalid(name, data, "splat-count", "5.4", note)

    head, tail, second, second_tail = two_chunks().groups[0].segments
    flat = replace(chunk_with_tail(1), root=root_keys(3, 0))
    box = build_edited(
        uniform_chunk(), lambda i: table(i, "chunks").update(box=column(i, "chunks", "box")[:-4])
    )
    layers = build_edited(uniform_chunk(), key_setter("layer", bytes(8), within="chunks"))

    def quality(name: str, number: float, note: str) -> Invalid:
        column_ = struct.pack("<f", number)
        data = build_edited(uniform_chunk(), key_setter("quality", column_, within="chunks"))
        return Invalid(name, data, "root-value", "5.4", note)

    return [
        Invalid("chunks-no-box", _without(uniform_chunk(), "chunks", "box"), "root-missing", "5.4",
                "no box"),
        Invalid("chunks-box-short", box, "root-columns", "5.4", "a box of five numbers"),
        Invalid("chunks-layers", layers, "root-columns", "5.4", "two layers for one chunk"),
        value("chunk-empty", "splats", 0, "I", 0, "a chunk of no splats"),
        value("chunk-large", "splats", 0, "I", (1 << 18) + 1, "a chunk of 2^18 + 1 splats"),
        value("chunk-box-nan", "box", 8, "f", math.nan, "NaN in a box"),
        value("chunk-box-infinite", "box", 12, "f", math.inf, "an infinite box"),
        value("chunk-box-turned", "box", 0, "f", 9.0, "minimum above maximum"),
        Invalid("chunk-box-small", _poked(uniform_chunk(), "chunks", "box", 12, "f", 0.25),
                "chunk-box",
                "5.4", "means outside the box", "verify"),
        value("contribution-negative", "contribution", 0, "d", -1.0, "a negative contribution"),
        value("contribution-nan", "contribution", 0, "d", math.nan, "NaN"),
        quality("quality-101", 101.0, "a quality of 101 dB"),
        quality("quality-nan", math.nan, "a quality of NaN"),
        order("head-missing", [head, tail, second_tail], "chunk-heads", "a chunk without a head"),
        order("head-twice", [head, tail, replace(second, owner=0), second_tail], "chunk-heads",
              "two heads of chunk 0"),
        order("heads-order", [second, second_tail, head, tail], "chunk-heads",
              "the head of chunk 1 first"),
        order("heads-three", [head, second, replace(second, owner=2)], "chunk-heads",
              "three heads of two chunks"),
        order("tail-twice", [head, tail, second, replace(second_tail, owner=0)], "chunk-tails",
              "two tails of chunk 0"),
        order("tail-beyond", [head, tail, second, replace(second_tail, owner=2)], "chunk-tails",
              "a tail of chunk 2 of two"),
        order("tail-first", [tail, head, second, second_tail], "chunk-tails",
              "a tail before its head"),
        Invalid("tail-degree-0", build(flat), "chunk-tails", "5.4", "a tail at SH degree 0"),
        total("splats-more", uniform_chunk(), 4, "chunks of 3 splats, 4 stated"),
        total("splats-fewer", uniform_chunk(), 2, "chunks of 3 splats, 2 stated"),
        total("splats-no-chunks", no_splats(), 5, "5 in no chunk"),
    ]  # fmt: skip


def codebook_tables() -> list[Invalid]:
    """Return the vectors of invalid codebook segments (SPEC 5.5)."""
    shape, first, second, head, tail = chunk_with_codebooks().groups[0].segments

    def bad(name: str, segments: list[Segment], note: str) -> Invalid:
        data = build(with_segments(chunk_with_codebooks(), segments))
        return Invalid(name, data, "codebook-segments", "5.5", note)

    third = Segment(SegmentKind.COLOUR_BAND3, 1, pack_streams([handmade.band(3, 4, 2)]))
    return [
        bad("book-shape-missing", [first, second, head, tail], "no segment of the shape codebook"),
        bad("book-band-missing", [shape, first, head, tail], "no second band"),
        bad("book-band-above", [shape, first, second, third, head, tail], "a third band, degree 2"),
        bad("book-twice", [shape, shape, first, second, head, tail], "a codebook's segment twice"),
        bad("book-beyond", [shape, first, second, replace(shape, owner=2), head, tail],
            "a segment of codebook 2 of two"),
        bad("book-kind", [replace(shape, owner=1), first, second, head, tail],
            "shapes for a codebook of colours"),
    ]  # fmt: skip


def index_pages() -> list[Invalid]:
    """Return the vectors of invalid index pages (SPEC 5.6) and of tables above a limit."""

    def entry(name: str, key: str, content: int, code: str, note: str, clause: str) -> Invalid:
        def change(index: Index) -> None:
            found = index["pages"]
            if isinstance(found, list) and isinstance(found[0], dict):
                found[0][key] = content

        return Invalid(name, build_edited(paged_chunks(), change), code, clause, note)

    whole = paged_chunks()
    first, second = whole.groups
    late = replace(
        whole,
        groups=[Group(first.segments[:1], [*first.chunks, *second.chunks]),
                Group([first.segments[1], *second.segments], [])],
    )  # fmt: skip
    listed = len(build(two_chunks()))
    claim: Value = {
        "length": 100,
        "crc": 0,
        "segments": 1 << 19,
        "chunks": 0,
        "span": 1,
    }
    return [
        entry("page-crc", "crc", 1, "page-crc", "another CRC in the root", "5.6"),
        entry(
            "page-segments", "segments", 3, "page-entry", "three segments stated, two there", "5.6"
        ),
        entry("page-chunks", "chunks", 2, "page-entry", "two chunks stated, one there", "5.6"),
        entry("page-span", "span", listed, "page-entry", "another span stated", "5.6"),
        entry("page-empty", "length", 0, "root-value", "a page of no bytes", "5.6"),
        entry("page-large", "length", (1 << 20) + 1, "root-value", "a page over 1 MiB", "5.6"),
        entry("page-no-segments", "segments", 0, "root-value", "a page of no segments", "5.6"),
        entry("page-span-2-53", "span", (1 << 53) - 1, "page-entry", "a span of 2^53 - 1", "5.6"),
        entry("page-beyond", "length", 1 << 20, "segments-length", "ends behind the file", "5.1"),
        Invalid(
            "page-heads-late", build(late), "chunk-heads", "5.4", "chunks listed before their heads"
        ),
        Invalid(
            "page-trailing",
            build(whole, behind_page=b"\xc0"),
            "msgpack-trailing",
            "4.1",
            "a byte behind a page's map",
        ),
        Invalid(
            "segments-2-20",
            build_edited(uniform_chunk(), key_setter("pages", [claim, claim])),
            "segment-count",
            "9.1",
            "2^20 + 1 segments",
        ),
        Invalid(
            "decoded-size",
            _two_largest_chunks(),
            "decoded-size",
            "9.2",
            "half a million splats in a kilobyte",
            "decode",
        ),
    ]


def _two_largest_chunks() -> bytes:
    """Return a small file that decodes to two chunks of 2^18 equal splats at SH degree 3."""
    rows, count = 1 << 18, 2
    head = pack_streams(handmade.uniform_head(rows))
    segments = [Segment(SegmentKind.HEAD, chunk, head) for chunk in range(count)]
    return build(Draft(root_keys(rows * count, 3), [Group(segments, [ChunkRow(rows)] * count)]))
