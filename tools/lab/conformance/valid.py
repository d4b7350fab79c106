"""Valid conformance vectors, which every reader must decode to the same bits."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute
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
    one_chunk,
    pack_streams,
    payload,
    record,
    root_keys,
    table,
)


@dataclass(frozen=True)
class Valid:
    """A valid conformance file.

    Parameters
    ----------
    name : str
    data : bytes
    covers : tuple of str
        SPEC clauses that the file covers.
    note : str
        Description of the case.
    """

    name: str
    data: bytes
    covers: tuple[str, ...]
    note: str


SMALLEST: Final = "one-splat"
"""Name of the file in SPEC's annotated dump."""


def _chunk(rows: int, seed: int, number: int, degree: int = 0) -> list[Segment]:
    """Return the head of a pseudo-random chunk, and its tail if `degree` is above 0."""
    out = [Segment(SegmentKind.HEAD, number, pack_streams(handmade.random_head(rows, seed)))]
    if degree:
        tail = pack_streams(handmade.bands(degree, rows, seed + 50))
        out.append(Segment(SegmentKind.TAIL, number, tail))
    return out


def _plain(sizes: Sequence[int], degree: int, seed: int = 1) -> list[list[Segment]]:
    """Return head and tail of each chunk, in scalar streams; `sizes` are splat counts."""
    return [_chunk(rows, seed + 1000 * i, i, degree) for i, rows in enumerate(sizes)]


def _empty() -> Valid:
    """Return the vector of a file without splats."""
    draft = Draft(root_keys(0, 3), [Group([], [])])
    return Valid("empty", build(draft), ("3.1", "4.2", "5.4"), "no splats, no chunks, no segments")


def _one_splat() -> Valid:
    """Return the vector of one splat, the smallest file."""
    head = [
        handmade.constant(Attribute.MEANS, 1, 1.0, -2.0, 0.5),
        handmade.constant(Attribute.OPACITIES, 1, 2.0),
        handmade.constant(Attribute.SH0, 1, 0.25, 0.5, -0.25),
        handmade.constant(Attribute.SCALES, 1, -3.0, -2.5, -4.0),
        handmade.random_quats(1, 1, ranges=[(0.5, 0.5, 1), (0.0, 0.0, 1), (-0.5, -0.5, 1)]),
    ]
    data = build(one_chunk(pack_streams(head), 1))
    return Valid(SMALLEST, data, ("3.1", "6.2", "6.4", "6.6"), "one splat, every grid of one level")


def _sh(degree: int) -> Valid:
    """Return the vector of scalar streams at an SH degree."""
    head = pack_streams(handmade.random_head(24, degree))
    tail = pack_streams(handmade.bands(degree, 24, 20 + degree)) if degree else None
    data = build(one_chunk(head, 24, tail=tail, sh_degree=degree))
    return Valid(
        f"sh{degree}", data, ("6.4", "7.2", "7.3"), f"scalar streams at SH degree {degree}"
    )


def _plane_counts() -> Valid:
    """Return the vector of scalar streams whose codes have 0, 1, 2 and 3 byte planes."""
    levels = [1, 2, 256, 257, 65536, 65537, 1 << 24]
    attribute = Attribute.SH1
    ranges = [(-1.1, 1.3, levels[i % len(levels)]) for i in range(9)]
    codes = [[0, n - 1, *handmade.pseudo_random(6, n, i)] for i, (_, _, n) in enumerate(ranges)]
    tail = pack_streams([handmade.scalar(attribute, ranges, codes)])
    data = build(one_chunk(pack_streams(handmade.random_head(8, 3)), 8, tail=tail, sh_degree=1))
    return Valid(
        "plane-counts", data, ("6.4",), "codes of 0, 1, 2 and 3 byte planes, first and last"
    )


def _grid_ends() -> Valid:
    """Return the vector of extreme grids: largest range, no range, denormals."""
    largest = 2.0**100
    ranges = [(-largest, largest, 1 << 24), (0.1, 0.1, 5), (1e-45, 3e-45, 3)]
    codes = [[0, 1, (1 << 24) - 1, 1 << 23], [0, 4, 2, 1], [0, 1, 2, 1]]
    means = handmade.scalar(Attribute.MEANS, ranges, codes)
    note = "grids of the largest range, of no range with five levels, and of denormals"
    data = build(one_chunk(pack_streams(handmade.random_head(4, 3, means)), 4, reach=largest))
    return Valid("grid-ends", data, ("6.4",), note)


def _negative_zero() -> Valid:
    """Return the vector of grids of means and rotations with a minimum of -0, decoded as +0."""
    means = handmade.scalar(
        Attribute.MEANS, [(-0.0, -0.0, 1), (-0.0, 1.0, 2), (-1.0, 1.0, 3)], [[0, 0]] * 2 + [[1, 2]]
    )
    head = handmade.random_head(
        2, 5, means, handmade.random_quats(2, 1, ranges=[(-0.0, -0.0, 1)] * 3)
    )
    data = build(one_chunk(pack_streams(head), 2))
    return Valid("negative-zero", data, ("6.4", "6.6"), "a minimum of -0 decodes as +0 everywhere")


def _quats() -> Valid:
    """Return the vector of quaternions with each component omitted in turn."""
    left_out: list[int | list[int]] = [0, 1, 2, 3, [row % 4 for row in range(12)]]
    segments = []
    for chunk, largest in enumerate(left_out):
        head = handmade.random_head(12, chunk, handmade.random_quats(12, chunk, largest=largest))
        segments.append(Segment(SegmentKind.HEAD, chunk, pack_streams(head)))
    data = build(Draft(root_keys(60, 0), [Group(segments, [ChunkRow(12)] * 5)]))
    return Valid("quats", data, ("6.6",), "each component left out in turn, and row by row")


def _quats_over_one() -> Valid:
    """Return the vector of quaternions whose stored squares sum to more than one."""
    ranges = [(-1.0, 1.0, 256)] * 3
    head = handmade.random_head(
        64, 8, handmade.random_quats(64, 3, ranges=ranges, largest=[i % 4 for i in range(64)])
    )
    data = build(one_chunk(pack_streams(head), 64))
    return Valid("quats-over-one", data, ("6.6",), "squares that sum to more than one")


def _infinities() -> Valid:
    """Return the vector of opacities that are plus and minus infinity."""
    chunks = []
    for number, levels in enumerate([1, 7, 254, 255, 256]):
        codes = [levels, levels + 1, 0, levels - 1, *handmade.pseudo_random(4, levels + 2, number)]
        ranges = [(-4.5, 4.5 if levels > 1 else -4.5, levels)]
        stream = handmade.scalar(Attribute.OPACITIES, ranges, [codes], flags=INFINITIES)
        data = pack_streams(handmade.random_head(8, number, stream))
        chunks.append(Segment(SegmentKind.HEAD, number, data))
    data = build(Draft(root_keys(40, 0), [Group(chunks, [ChunkRow(8)] * 5)]))
    return Valid(
        "infinities", data, ("6.4",), "opacities of both infinities, codes of 1 and 2 bytes"
    )


def _floats() -> Valid:
    """Return the vector of float streams, with -0, denormals and both infinities."""
    means = [[0.1, -0.0, 1e-45], [2.0**100, -(2.0**100), 3.14159], [1.0, 2.0, 3.0]]
    head = [
        handmade.floats(Attribute.MEANS, means),
        handmade.floats(Attribute.OPACITIES, [[math.inf], [-math.inf], [-0.0]]),
        handmade.floats(Attribute.SH0, means),
        handmade.floats(Attribute.SCALES, [[-3.5, -90.0, 12.0]] * 3),
        handmade.random_quats(3, 4),
    ]
    tail = [handmade.floats(Attribute.SH1, [[row + 0.1 * i for i in range(9)] for row in range(3)])]
    data = build(
        one_chunk(pack_streams(head), 3, tail=pack_streams(tail), sh_degree=1, reach=2.0**100)
    )
    return Valid("floats", data, ("6.8",), "float streams, with -0, denormals, both infinities")


def _vq() -> Valid:
    """Return the vector of shape and colour codebooks."""
    rows = 300
    shape = handmade.vq(Attribute.SHAPE, handmade.pseudo_random(20, rows, 5), 0, rows, 0)
    colour = handmade.vq(Attribute.SHN, handmade.pseudo_random(20, 20, 6), 1, 20, 0)
    books = {
        "shape": (rows, [pack_streams(handmade.shape_codebook(rows, 1))]),
        "colour": (20, [pack_streams([handmade.band(i, 20, 2)]) for i in (1, 2, 3)]),
    }
    head = pack_streams(handmade.vq_head(20, 4, shape))
    draft = one_chunk(head, 20, tail=pack_streams([colour]), sh_degree=3, books=books, needs=(0, 1))
    note = "shape and colour codebooks; a head that states a codebook it does not use"
    return Valid("vq", build(draft), ("5.5", "6.7", "7.1"), note)


def _vq_escape() -> Valid:
    # 256 rows: only because of the escape rows do indices need a second plane.
    """Return the vector of escape rows between rows of a codebook."""
    index = [handmade.pseudo_random(1, 256, i)[0] for i in range(30)]
    index[::3] = [256] * 10
    shape = handmade.vq(Attribute.SHAPE, index, 0, 256, 10)
    own = [
        handmade.random_scalar(Attribute.SCALES, 10, 70, levels=40, escape=True),
        handmade.random_quats(10, 71, largest=2, escape=True),
    ]
    colour = handmade.vq(Attribute.SHN, [4, *handmade.pseudo_random(27, 4, 3), 4, 4], 1, 4, 3)
    own_bands = [handmade.band(2, 3, 80, escape=True)]
    books = {
        "shape": (256, [pack_streams(handmade.shape_codebook(256, 1))]),
        "colour": (4, [pack_streams([handmade.band(i, 4, 2)]) for i in (1, 2)]),
    }
    head = pack_streams(handmade.vq_head(30, 4, shape, *own))
    tail = pack_streams([colour, *own_bands])
    draft = one_chunk(head, 30, tail=tail, sh_degree=2, books=books, needs=(0, 1))
    note = "escape rows between those of the codebook, one of their bands absent"
    return Valid("vq-escape", build(draft), ("6.7", "7.2", "7.3"), note)


def _vq_all_escape() -> Valid:
    """Return the vector of a chunk with escape rows only; its codebook is unused."""
    shape = handmade.vq(Attribute.SHAPE, [1, 1, 1], 0, 1, 3)
    scales = [[-1.0, -2.0, -3.0], [0.1, 0.2, 0.3], [0.0, -0.0, 1.0]]
    own = [
        replace(handmade.floats(Attribute.SCALES, scales), flags=ESCAPE),
        handmade.random_quats(3, 71, escape=True),
    ]
    books = {"shape": (1, [pack_streams(handmade.shape_codebook(1, 1))])}
    head = pack_streams(handmade.vq_head(3, 4, shape, *own))
    note = "a codebook of one row that no splat uses; escape rows stored as floats"
    return Valid(
        "vq-all-escape", build(one_chunk(head, 3, books=books, needs=(0,))), ("6.7", "6.8"), note
    )


def _two_books() -> Valid:
    """Return the vector of two shape codebooks, each needed by one chunk."""
    books: list[Value] = [{"attribute": "shape", "rows": n} for n in (5, 9)]
    segments = [
        Segment(SegmentKind.SHAPE_CODEBOOK, i, pack_streams(handmade.shape_codebook(n, i)))
        for i, n in enumerate((5, 9))
    ]
    for chunk, (book, size) in enumerate([(1, 9), (0, 5)]):
        shape = handmade.vq(Attribute.SHAPE, handmade.pseudo_random(6, size, chunk), book, size, 0)
        data = pack_streams(handmade.vq_head(6, chunk, shape))
        segments.append(Segment(SegmentKind.HEAD, chunk, data, (book,)))
    root = root_keys(12, 0, codebooks=books)
    data = build(Draft(root, [Group(segments, [ChunkRow(6)] * 2)]))
    return Valid("two-books", data, ("5.3", "5.5"), "two codebooks, each needed by one chunk")


def _late_book() -> Valid:
    """Return the vector of codebooks stored after the chunks whose indices refer to a codebook."""
    shape = handmade.vq(Attribute.SHAPE, [0, 1, 2, 1], 0, 3, 0)
    colour = handmade.vq(Attribute.SHN, [1, 0, 1, 1], 1, 2, 0)
    segments = [
        *_chunk(5, 1, 0),
        Segment(SegmentKind.HEAD, 1, pack_streams(handmade.vq_head(4, 2, shape)), (0,)),
        Segment(SegmentKind.TAIL, 1, pack_streams([colour]), (1,)),
        Segment(SegmentKind.COLOUR_BAND2, 1, pack_streams([handmade.band(2, 2, 8)])),
        Segment(SegmentKind.SHAPE_CODEBOOK, 0, pack_streams(handmade.shape_codebook(3, 1))),
        *_chunk(6, 5, 2),
        Segment(SegmentKind.COLOUR_BAND1, 1, pack_streams([handmade.band(1, 2, 8)])),
    ]
    books: list[Value] = [
        {"attribute": "shape", "rows": 3},
        {"attribute": "colour", "rows": 2},
    ]
    root = root_keys(15, 2, codebooks=books)
    data = build(Draft(root, [Group(segments, [ChunkRow(5), ChunkRow(4), ChunkRow(6)])]))
    note = "codebooks behind the chunks that need them: a prefix must wait for them"
    return Valid("late-book", data, ("5.1", "8.2"), note)


def _chunks() -> Valid:
    """Return the vector of four chunks whose tails are late and out of order."""
    parts = _plain([3, 7, 12, 20], 2)
    head, tail = 0, 1
    order = [(0, head), (1, head), (1, tail), (2, head), (0, tail), (3, head), (3, tail), (2, tail)]
    segments = [parts[chunk][part] for chunk, part in order]
    rows = [ChunkRow(n, contribution=9.0 - i) for i, n in enumerate([3, 7, 12, 20])]
    data = build(Draft(root_keys(42, 2), [Group(segments, rows)]))
    return Valid("chunks", data, ("5.1", "5.4", "8.2"), "four chunks, tails late and out of order")


def _pages() -> Valid:
    """Return the vector of three pages of the root."""
    parts = _plain([5, 6, 7, 8, 9], 1)
    groups = [
        Group(parts[0], [ChunkRow(5)]),
        Group([parts[1][0], parts[2][0], parts[2][1], parts[1][1]], [ChunkRow(6), ChunkRow(7)]),
        Group(parts[3], [ChunkRow(8)]),
        Group(parts[4], [ChunkRow(9, layer=1, cell=4, object=2)]),
    ]
    data = build(Draft(root_keys(35, 1), groups))
    return Valid(
        "pages", data, ("5.6", "8.2"), "three pages of the root, tails late and out of order"
    )


def _page_tree() -> Valid:
    """Return the vector of pages three deep, whose chunks are numbered depth first."""
    sizes = [5, 6, 7, 8, 9, 4, 3]
    parts = _plain(sizes, 1)
    rows = [
        ChunkRow(size, (-8.0, -8.0, -8.0, 8.0, 8.0, 8.0 - 0.5 * i), 9.0 - i, cell=cell)
        for i, (size, cell) in enumerate(zip(sizes, [1, 2, 8, 17, 5, 6, 3], strict=True))
    ]

    def page(chunk: int, cell: int, *pages: Group) -> Group:
        return Group(parts[chunk], rows[chunk : chunk + 1], pages, cell)

    groups = [
        Group(parts[0], rows[:1]),
        page(1, 2, page(2, 4, page(3, 8)), page(4, 5)),
        page(5, 3),
        Group([*parts[6], Segment(200, 7, b"last")], rows[6:], cell=3),
    ]
    data = build(Draft(root_keys(sum(sizes), 1), groups))
    note = "pages of pages, three deep: chunks depth first, parents only in indices above"
    return Valid("pages-tree", data, ("5.1", "5.4", "5.6", "8.2"), note)


def _pages_only() -> Valid:
    """Return the vector of a root without segments of its own, only pages."""
    parts = _plain([4, 4], 0)
    groups = [Group([], []), *(Group(part, [ChunkRow(4)]) for part in parts)]
    data = build(Draft(root_keys(8, 0), groups))
    return Valid("pages-only", data, ("5.6",), "a root that lists no segment, only pages")


def _tails_missing() -> Valid:
    """Return the vector of three chunks, one with a tail and two without."""
    parts = _plain([6, 7, 8], 3)
    segments = [parts[0][0], *parts[1], parts[2][0]]
    rows = [ChunkRow(6), ChunkRow(7), ChunkRow(8)]
    data = build(Draft(root_keys(21, 3), [Group(segments, rows)]))
    return Valid(
        "tails-missing", data, ("5.4", "7.3"), "two of three chunks have no tail: shN is 0"
    )


def _bands_absent() -> Valid:
    """Return the vector of a tail of SH degree 3 without band 2, which decodes as zeros."""
    tail = pack_streams([handmade.band(1, 9, 1), handmade.band(3, 9, 1)])
    head = pack_streams(handmade.random_head(9, 1))
    data = build(one_chunk(head, 9, tail=tail, sh_degree=3))
    return Valid("band-absent", data, ("7.3",), "a tail without its second band: zeros there")


def _book_band_absent() -> Valid:
    """Return the vector of a colour codebook without band 1, which decodes as zeros."""
    colour = handmade.vq(Attribute.SHN, [0, 1, 2, 1, 0], 0, 3, 0)
    empty = pack_streams([])
    books = {"colour": (3, [empty, pack_streams([handmade.band(2, 3, 8)])])}
    head = pack_streams(handmade.random_head(5, 1))
    draft = one_chunk(head, 5, tail=pack_streams([colour]), sh_degree=2, books=books, needs=(0,))
    note = "a colour codebook's band of no streams: zeros"
    return Valid("book-band-absent", build(draft), ("7.1",), note)


def _root_values() -> Valid:
    """Return the vector of a root and a chunk row whose values differ from the defaults."""
    view: Index = {
        "width": 1920,
        "height": 1080,
        "fx": 1100.5,
        "fy": 1099.25,
        "cx": 960.0,
        "cy": 540.0,
        "rotation": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        "translation": [0.5, -1.5, 4.0],
        "target": [0.25, 7.0, -3.75],
    }
    root = root_keys(
        6,
        0,
        writer="a writer with é and 🙂 in its name",
        origin=[4.5e6, -1.25e5, 0.1],
        axes="LUB",
        colour_space="linear",
        kernel_px=0.1,
        antialiased=True,
        first_view=view,
        up=[0.0, -0.6, 0.8],
        core_box=[-8.0, -7.5, -3.0, 2.0, 2.5, 8.0],
        capture=struct.pack("<8f", 1.5, -2.0, 0.25, 640.0, -1e30, 0.0, 1e-30, 0.5),
    )
    rows = [ChunkRow(6, (-4.5, -8.0, -4.0, 4.0, 4.0, 8.5), 12.5, 1, 2, 3, 41.25)]
    data = build(Draft(root, [Group(_chunk(6, 1, 0), rows)]))
    note = (
        "origin, axes, colour space, kernel, first view, up, capture, layer, cell, object, quality"
    )
    return Valid("root-values", data, ("4.2", "4.4", "5.4"), note)


def _unknown_segments() -> Valid:
    """Return the vector of segments of unknown kinds, which decoders skip."""
    parts = _plain([6, 7], 1)
    segments = [
        Segment(201, 7, b"to be skipped"),
        *parts[0],
        Segment(255, 0xFFFFFFFF, bytes(9)),
        *parts[1],
        Segment(200, 0, b"\x00"),
        Segment(200, 0, b"\x00"),
    ]
    data = build(Draft(root_keys(13, 1), [Group(segments, [ChunkRow(6), ChunkRow(7)])]))
    return Valid("unknown-segments", data, ("5.2",), "segments of kinds 200 to 255, to be skipped")


def _unknown_keys() -> Valid:
    """Return the vector of unknown keys in every map of the index."""
    deep: Value = "bottom"
    for _ in range(6):
        deep = [deep]
    extra: Index = {
        "__proto__": {"polluted": True},
        "constructor": None,
        "": -(1 << 53) + 1,
        "largest": (1 << 53) - 1,
        "integers": [0, 127, 128, 255, 256, 65535, 65536, -1, -32, -33, -128, -129, -32769],
        "floats": [math.inf, -math.inf, 0.5, -0.0],
        "nested": deep,
        "bin": bytes(300),
        "text": "x" * 40,
        "many": list(range(20)),
        "not!last": 1,
    }

    def edit(number: int, index: Index) -> None:
        table(index, "segments")["colour"] = "any"
        table(index, "chunks")["score"] = bytes(3)
        if number:
            index["next"] = None
            return
        index.update(extra)
        table(index, "pages")["why"] = {"a": []}

    books: list[Value] = [{"attribute": "shape", "rows": 2, "seed": 7}]
    book = Segment(SegmentKind.SHAPE_CODEBOOK, 0, pack_streams(handmade.shape_codebook(2, 1)))
    parts = _plain([6, 7], 0)
    groups = [Group([book, *parts[0]], [ChunkRow(6)]), Group(parts[1], [ChunkRow(7)])]
    data = build(Draft(root_keys(13, 0, codebooks=books), groups), edit)
    note = "keys that this version does not have in every map, among them __proto__"
    return Valid("unknown-keys", data, ("4.1", "4.3"), note)


def _compressed() -> Valid:
    """Return the vector of byte planes stored as zstd frames."""
    rows = 80
    codes = [
        [0] * rows,
        [row // 10 % 2 for row in range(rows)],
        [row * 7 % 251 for row in range(rows)],
    ]
    means = handmade.scalar(Attribute.MEANS, [(-1.0, 1.0, 256)] * 3, codes)
    mixed = handmade.random_quats(rows, 1, ranges=[(0.0, 0.0, 1)] * 3, largest=[0, 1] * (rows // 2))
    head = pack_streams(handmade.uniform_head(rows, means, mixed))
    note = "zstd frames: one byte over and over, runs, a period"
    return Valid("compressed", build(one_chunk(head, rows)), ("6.3",), note)


def _stored() -> Valid:
    """Return the vector of byte planes stored uncompressed, one byte each."""
    draft = one_chunk(pack_streams(handmade.random_head(1, 1)), 1)
    data = build(draft, lambda _, index: index.update(writer=""))
    return Valid("stored", data, ("6.3",), "planes of one byte, none of them compressed")


def _frame_of_blocks() -> Valid:
    """Return the vector of a hand-made zstd frame with a window descriptor and RLE blocks."""
    rows = 64
    plane = np.array([row // 8 for row in range(rows)], np.uint8)
    opacities = handmade.scalar(Attribute.OPACITIES, [(-2.0, 2.0, 8)], [plane.tolist()])
    # RFC 8878: content size of 4 bytes, window of 1 KiB, eight RLE blocks.
    blocks = [
        ((row == 7) | 1 << 1 | (8 << 3)).to_bytes(3, "little") + bytes([row]) for row in range(8)
    ]
    frame = bytes.fromhex("28b52ffd8000") + rows.to_bytes(4, "little") + b"".join(blocks)
    head = handmade.uniform_head(rows, opacities)
    records = [record(entry) for entry in head]
    records[handmade.stream_index(head, Attribute.OPACITIES)].planes = [
        (len(frame) | 1 << 31, frame)
    ]
    note = "a hand-made zstd frame: window descriptor, four-byte content size, RLE blocks"
    return Valid("frame-blocks", build(one_chunk(payload(records), rows)), ("6.3",), note)


def valid() -> list[Valid]:
    """Return the valid vectors of scalar streams, codebooks and tables, in manifest order."""
    return [
        _empty(),
        _one_splat(),
        *(_sh(degree) for degree in range(4)),
        _plane_counts(),
        _grid_ends(),
        _negative_zero(),
        _quats(),
        _quats_over_one(),
        _infinities(),
        _floats(),
        _stored(),
        _compressed(),
        _frame_of_blocks(),
        _vq(),
        _vq_escape(),
        _vq_all_escape(),
        _two_books(),
        _late_book(),
        _chunks(),
        _tails_missing(),
        _bands_absent(),
        _book_band_absent(),
        _pages(),
        _page_tree(),
        _pages_only(),
        _root_values(),
        _unknown_segments(),
        _unknown_keys(),
    ]
