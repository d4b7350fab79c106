"""Conformance vectors of compensation (SPEC 5.9, 8.5)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace

from cogsplat.codec.streams.records import Attribute
from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import ChunkRow, Draft, Group, build, in_pages, pack_streams, root_keys
from .invalid import Invalid
from .valid import Valid

_CHUNKS = 5
_ROWS = 3
# Splats per chunk of the file whose blended shifts round in float32.
_SIZES = (5, 1, 2, 3, 1, 4, 2)


def _layer(
    scales: Sequence[int],
    opacities: Sequence[int],
    strengths: Sequence[int],
    book: Sequence[int] = (),
    codes: bytes = b"",
) -> dict[str, Value]:
    """Return the map of one compensation layer (SPEC 5.9)."""
    return {
        "scales": struct.pack(f"{len(scales)}b", *scales),
        "opacities": struct.pack(f"{len(opacities)}b", *opacities),
        "strengths": bytes(strengths),
        "book": struct.pack(f"{len(book)}b", *book),
        "codes": codes,
    }


def _pack_codes(codes: Sequence[int], bits: int) -> bytes:
    """Return codes of `bits` bits each without gaps, lowest bit first."""
    number = sum(code << bits * place for place, code in enumerate(codes))
    return number.to_bytes((len(codes) * bits + 7) // 8, "little")


def _draft(layers: Sequence[tuple[int, bytes]]) -> Draft:
    """Return the draft of a file of five chunks with compensation segments.

    Parameters
    ----------
    layers : sequence of (int, bytes)
        Chunk whose head the segment precedes, and the segment's payload.
    """
    segments = []
    owner = 0
    for chunk in range(_CHUNKS):
        for before, data in layers:
            if before == chunk:
                segments.append(Segment(SegmentKind.COMPENSATION, owner, data))
                owner += 1
        head = pack_streams(handmade.uniform_head(_ROWS))
        segments.append(Segment(SegmentKind.HEAD, chunk, head))
    rows = [ChunkRow(_ROWS)] * _CHUNKS
    return Draft(root_keys(_CHUNKS * _ROWS, 0), [Group(segments, rows)])


_FIRST = _layer([51], [33], [64, 64], [-7, 120, 127, -128, 1, 2], _pack_codes([2, 0, 1], 2))
_SECOND = _layer(
    [40, -128, 127], [-5, 17, 127], [37, 11, 64, 64, 255, 255], [127, -128],
)  # fmt: skip
_THIRD = _layer(
    [3, 2, 1, 0], [1, 1, 2, 3], [9, 8, 7, 6, 5, 4, 64, 64],
    [k for row in range(5) for k in (row - 3, 3 - 2 * row)], _pack_codes([4, 0, 3], 3),
)  # fmt: skip


def valid() -> list[Valid]:
    """Return the valid vectors of compensation (SPEC 5.9, 8.5)."""
    several = [(0, pack(_FIRST)), (1, pack(_SECOND)), (3, pack(_THIRD))]
    plain = _layer([64, 32], [32, -16], [0, 0, 255, 255])
    ordinary, late = _draft(several), _draft([(0, pack(plain | {"later": 1}))])
    paged = in_pages(ordinary, [1, 2, _CHUNKS - 3])
    clauses = ("5.9", "8.5")
    return [
        Valid("compensation", build(ordinary), clauses, "three layers, two of them with codes"),
        Valid(
            "compensation-plain",
            build(late),
            ("4.3", *clauses),
            "one layer of two chunks without codes, with a key of a later version",
        ),
        Valid(
            "compensation-pages",
            build(paged),
            ("5.6", *clauses),
            "layers in the root, of chunks of pages",
        ),
        _blend(),
        _zeros(),
        _cells(),
        _cells_in_pages(),
    ]


def _blend() -> Valid:
    """Return the vector of two compensation layers whose blended shifts round in float32."""
    data = build(_two_layers([0] * len(_SIZES)))
    note = "prefixes between two layers and behind the last, where every operation rounds"
    return Valid("compensation-blend", data, ("5.9", "8.5"), note)


def _cells() -> Valid:
    """Return the vector of `_blend` with a tree of cells, whose sets of chunks are checked too."""
    data = build(_two_layers([1, 3, 1, 3, 2, 7, 2]))
    note = "the same chunks cut into cells: sets of chunks that hold with each chunk its parent"
    return Valid("compensation-cells", data, ("5.4", "5.9", "8.5"), note)


def _cells_in_pages() -> Valid:
    """Return the vector of `_cells` with pages of the two halves, behind all layers."""
    draft = _two_layers([1, 3, 1, 2, 4, 3, 7])
    root, *halves = in_pages(draft, [3, 2, 2]).groups
    groups = [root, *(replace(half, cell=cell) for half, cell in zip(halves, (2, 3), strict=True))]
    note = "the same in pages of two halves: descendants fade behind the last layer"
    clauses = ("5.4", "5.6", "5.9", "8.5")
    return Valid("compensation-cells-pages", build(replace(draft, groups=groups)), clauses, note)


def _two_layers(cells: Sequence[int]) -> Draft:
    """Return the draft of a file with two compensation layers.

    Parameters
    ----------
    cells : sequence of int
        Cell of each chunk; `_SIZES` are the splat counts of the chunks.
    """
    entries = [k for row in range(16) for k in (7 * row - 50, 113 - 15 * row)]
    first = _layer([85], [-77], [63, 61], entries, _pack_codes([3, 15, 8, 11, 6], 4))
    second = _layer(
        [-53, 91, -128, 127, 33], [119, -37, 71, -5, 18], [55, 249, 3, 127, 77, 201, 64, 31, 9, 5],
        entries, _pack_codes([1, 14, 5, 2, 9, 12, 7], 4),
    )  # fmt: skip
    segments = []
    for chunk, rows in enumerate(_SIZES):
        if chunk in (0, 1):
            data = pack((first, second)[chunk])
            segments.append(Segment(SegmentKind.COMPENSATION, chunk, data))
        # Near 0, so that no addition swallows the last bit of a shift.
        near = [
            handmade.constant(Attribute.SCALES, rows, 0.0, 2.0**-9, -0.25),
            handmade.constant(Attribute.OPACITIES, rows, 0.0),
        ]
        head = pack_streams(handmade.uniform_head(rows, *near))
        segments.append(Segment(SegmentKind.HEAD, chunk, head))
    rows_of = [ChunkRow(rows, cell=cell) for rows, cell in zip(_SIZES, cells, strict=True)]
    return Draft(root_keys(sum(_SIZES), 0), [Group(segments, rows_of)])


def _zeros() -> Valid:
    """Return the vector of scales and opacities of -0 with one layer of zero shifts."""
    minus = [
        handmade.floats(Attribute.SCALES, [[-0.0, -1.0, -0.0]] * _ROWS),
        handmade.floats(Attribute.OPACITIES, [[-0.0]] * _ROWS),
    ]
    layer = Segment(SegmentKind.COMPENSATION, 0, pack(_layer([0], [0], [0, 0])))
    heads = [
        Segment(SegmentKind.HEAD, chunk, pack_streams(handmade.uniform_head(_ROWS, *minus)))
        for chunk in range(3)
    ]
    draft = Draft(root_keys(3 * _ROWS, 0), [Group([layer, *heads], [ChunkRow(_ROWS)] * 3)])
    note = "a shift of 0 makes -0 into +0; where nothing is added, -0 stays"
    return Valid("compensation-zeros", build(draft), ("5.9", "8.5"), note)


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of compensation (SPEC 5.9)."""

    def order(name: str, owners: Sequence[int], note: str) -> Invalid:
        draft = _draft([(0, pack(_FIRST)), (1, pack(_SECOND))])
        segments = list(draft.groups[0].segments)
        places = [k for k, s in enumerate(segments) if s.kind == SegmentKind.COMPENSATION]
        for place, owner in zip(places, owners, strict=True):
            segments[place] = replace(segments[place], owner=owner)
        data = build(replace(draft, groups=[Group(segments, draft.groups[0].chunks)]))
        return Invalid(name, data, "compensation-segments", "5.9", note)

    def body(name: str, data: bytes, code: str, note: str, clause: str = "5.9") -> Invalid:
        return Invalid(name, build(_draft([(0, data)])), code, clause, note, "verify")

    def changed(vector: str, code: str, note: str, **changes: Value) -> Invalid:
        return body(vector, pack(_FIRST | changes), code, note)

    bookless = {key: value for key, value in _FIRST.items() if key != "book"}
    short = _draft([(0, pack(_FIRST)), (1, pack(_FIRST))])
    six = _layer([0] * 6, [0] * 6, [0] * 12)
    return [
        order("compensation-twice", [0, 0], "two segments of layer 0"),
        order("compensation-backward", [1, 0], "layer 1 before layer 0"),
        order("compensation-gap", [0, 2], "layer 2 without layer 1"),
        Invalid("compensation-no-growth", build(short), "root-value", "5.9",
                "two layers of one chunk", "verify"),
        body("compensation-cut", pack(_FIRST)[:-1], "msgpack-truncated", "the last byte missing",
             "4.1"),
        body("compensation-none", pack(_layer([], [], [])), "root-value", "a layer of no chunk"),
        body("compensation-beyond", pack(six), "root-value", "a layer of six chunks of five"),
        body("compensation-no-book", pack(bookless), "root-missing", "no book"),
        body("compensation-must-understand", pack(_FIRST | {"colour!": 1}),
             "root-must-understand", "a key with !", "4.3"),
        changed("compensation-text", "root-type", "scales in a text", scales="3"),
        changed("compensation-opacities", "root-columns", "two opacities of one chunk",
                opacities=bytes(2)),
        changed("compensation-strengths", "root-columns", "one strength of a chunk",
                strengths=bytes(1)),
        changed("compensation-book-odd", "root-columns", "a book of 5 bytes", book=bytes(5)),
        changed("compensation-book-257", "root-value", "257 rows", book=bytes(2 * 257)),
        changed("compensation-codes-short", "root-columns", "no codes", codes=b""),
        changed("compensation-codes-long", "root-columns", "a byte more", codes=bytes(2)),
        changed("compensation-code-3", "root-value", "code 3 of a book of three",
                codes=_pack_codes([0, 3, 0], 2)),
        changed("compensation-spare", "root-value", "a bit behind the last code",
                codes=_pack_codes([0, 0, 0, 1], 2)),
    ]  # fmt: skip
