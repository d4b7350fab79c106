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
    claimed_pages,
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
    """Return the vectors of invalid pages (SPEC 5.6) and of tables above a limit."""

    def entry(
        name: str, key: str, layout: str, content: float, code: str, note: str, clause: str = "5.6"
    ) -> Invalid:
        data = _poked(paged_chunks(), "pages", key, 0, layout, content)
        return Invalid(name, data, code, clause, note)

    def column_of(name: str, key: str, content: Value, code: str, note: str) -> Invalid:
        data = build_edited(paged_chunks(), key_setter(key, content, within="pages"))
        return Invalid(name, data, code, "5.6", note)

    whole = paged_chunks()
    first, second = whole.groups
    late = replace(
        whole,
        groups=[Group(first.segments[:1], [*first.chunks, *second.chunks]),
                Group([first.segments[1], *second.segments], [])],
    )  # fmt: skip
    listed = len(build(two_chunks()))
    deep = Group(second.segments, second.chunks)
    for _ in range(3):
        deep = Group([Segment(200, 0, b"page")], [], [deep])
    return [
        entry("page-crc", "crc", "I", 1, "page-crc", "another CRC in the root"),
        entry(
            "page-segments", "segments", "I", 3, "page-entry", "three segments stated, two there"
        ),
        entry("page-chunks", "chunks", "I", 2, "page-entry", "two chunks stated, one there"),
        *_shifted(),
        entry("page-span", "span", "Q", listed, "segments-length", "another span stated", "5.1"),
        entry("page-splats", "splats", "I", 3, "splat-count", "another number of splats", "5.4"),
        entry("page-empty", "length", "I", 0, "root-value", "a page of no bytes"),
        entry("page-large", "length", "I", (1 << 20) + 1, "root-value", "a page over 1 MiB"),
        entry("page-no-segments", "segments", "I", 0, "root-value", "a page of no segments"),
        entry("page-chunks-3", "chunks", "I", 3, "root-value", "three chunks in two segments"),
        entry("page-span-0", "span", "Q", 0, "root-value", "nothing behind a page"),
        entry("page-span-2-53", "span", "Q", 1 << 53, "root-value", "a span of 2^53"),
        entry("page-splats-2-31", "splats", "I", 1 << 31, "root-value", "2^31 splats"),
        entry("page-box-nan", "box", "f", math.nan, "root-value", "NaN in the box of a page"),
        entry("page-box-turned", "box", "f", 9.0, "root-value", "minimum above maximum"),
        entry(
            "page-contribution", "contribution", "d", -1.0, "root-value", "a negative contribution"
        ),
        column_of("pages-no-whole", "length", bytes(3), "root-columns", "lengths of 3 bytes"),
        column_of("pages-cells", "cell", bytes(8), "root-columns", "two cells of one page"),
        column_of("pages-text", "span", "1", "root-type", "a text for a column"),
        Invalid("pages-no-splats", _without(paged_chunks(), "pages", "splats"), "root-missing",
                "5.6", "no splats"),
        entry("page-beyond", "length", "I", 1 << 20, "segments-length", "ends behind the file",
              "5.1"),
        Invalid("pages-deep", build(replace(whole, groups=[first, deep])), "root-value", "5.6",
                "pages four deep"),
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
            "segments-2-21",
            build_edited(uniform_chunk(), key_setter("pages", claimed_pages(2, 1 << 20))),
            "segment-count",
            "9.1",
            "2^21 + 1 segments",
        ),
        Invalid(
            "decoded-size",
            _two_largest_chunks(),
            "decoded-size",
            "9.2",
            "half a million splats in a kilobyte",
            "decode",
        ),
        *_elsewhere(),
    ]  # fmt: skip


def _shifted() -> list[Invalid]:
    """Return the vectors in which the rows of two pages state wrong numbers with right sums."""
    whole = paged_chunks()
    first, second = whole.groups
    third = Group([Segment(200, 0, b"page"), Segment(201, 0, b"page")], [])
    draft = replace(whole, groups=[first, second, third])

    def shifted(key: str, layout: str, wide: int, note: str) -> Invalid:
        def change(index: Index) -> None:
            data = column(index, "pages", key)
            one, other = struct.unpack(f"<2{layout}", data)
            data = poke(data, 0, layout, one - 1)
            table(index, "pages")[key] = poke(data, wide, layout, other + 1)

        name = f"page-{key}-shifted"
        return Invalid(name, build_edited(draft, change), "page-entry", "5.6", note)

    return [
        shifted("segments", "I", 4, "a segment stated of the next page"),
        shifted("span", "Q", 8, "a byte stated of the next page"),
        shifted("splats", "I", 4, "a splat stated of the next page"),
    ]


def _elsewhere() -> list[Invalid]:
    """Return the vectors of segments that another index has to list (SPEC 5.2)."""

    def bad(name: str, draft: Draft, code: str, clause: str, note: str) -> Invalid:
        return Invalid(f"page-{name}", build(draft), code, clause, note)

    def in_page(draft: Draft, *segments: Segment) -> Draft:
        first, second = draft.groups
        return replace(
            draft, groups=[first, replace(second, segments=[*second.segments, *segments])]
        )

    whole = paged_chunks()
    first, second = whole.groups
    swapped = replace(
        whole,
        groups=[
            Group([first.segments[0]], first.chunks),
            Group([*second.segments, first.segments[1]], second.chunks),
        ],
    )
    listed = replace(whole, root=whole.root | {"attributes": [{"name": "label", "type": "u1"}]})
    books = chunk_with_codebooks()
    shape, *others = books.groups[0].segments
    book = replace(books, groups=[Group(others, books.groups[0].chunks), Group([shape], [])])
    head = replace(whole, groups=[first, replace(second, segments=first.segments)])
    camera = Segment(SegmentKind.CAMERAS, 0, b"\x80")
    layer = Segment(SegmentKind.COMPENSATION, 0, b"\x80")
    tables = [Segment(SegmentKind.VIEW_TABLE, 0, b"\x80")] * 2
    return [
        bad("head", head, "chunk-heads", "5.4", "a page with the head of a chunk of the root"),
        bad("tail", swapped, "chunk-tails", "5.4", "a page with the tail of a chunk of the root"),
        bad("refinement", in_page(whole, Segment(SegmentKind.REFINEMENT, 0, b"\0\0")),
            "chunk-refinements", "5.4", "a page with the refinement of a chunk of the root"),
        bad("opacities", in_page(whole, Segment(SegmentKind.OPACITIES, 0, b"\0\0")),
            "chunk-opacities", "5.11", "a page with opacities of a chunk of the root"),
        bad("attributes", in_page(listed, Segment(SegmentKind.ATTRIBUTES, 0, b"\0\0")),
            "attribute-segments", "5.7", "a page with attributes of a chunk of the root"),
        bad("codebook", book, "codebook-segments", "5.5", "a codebook that a page lists"),
        bad("cameras", in_page(whole, camera), "camera-segments", "5.8", "cameras in a page"),
        bad("compensation", in_page(whole, layer), "compensation-segments", "5.9",
            "a layer in a page"),
        bad("view-tables", in_page(whole, *tables), "view-table-segments", "5.12",
            "two view tables in a page"),
    ]  # fmt: skip


def _two_largest_chunks() -> bytes:
    """Return a small file that decodes to two chunks of 2^18 equal splats at SH degree 3."""
    rows, count = 1 << 18, 2
    head = pack_streams(handmade.uniform_head(rows))
    segments = [Segment(SegmentKind.HEAD, chunk, head) for chunk in range(count)]
    return build(Draft(root_keys(rows * count, 3), [Group(segments, [ChunkRow(rows)] * count)]))
