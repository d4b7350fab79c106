"""Valid vectors of packed planes, sorted means, differences, swing-twist and bases (SPEC 6)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from cogsplat.codec.streams import shn_transform, swing_twist
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.records import COMPONENTS, ESCAPE, SH_BANDS, Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    build,
    one_chunk,
    pack_streams,
    pack_symbols,
    payload,
    record,
    root_keys,
)
from .reference_streams import SCALE_FACTOR, SCALES, f32, numbers, parse
from .valid import Valid

_MODEL: Final = StepModel((3.25, 1.5, 0.75, -0.25, 2.0, 0.5))
"""Step model that gives 0 to 15 extra bits for the scales of `differences`."""


def differences(rows: int, seed: int) -> Stream:
    """Return a differences stream of pseudo-random log scales."""
    ranges = [(-5.0, 6.0, 40), (0.0, 4.1, 30), (-0.5, 3.3, 300)]
    codes = [
        handmade.pseudo_random(rows, count, seed + i) for i, (_, _, count) in enumerate(ranges)
    ]
    return replace(handmade.scalar(Attribute.SCALES, ranges, codes), kind=Kind.DIFFERENCES)


def extra_bits(scales: Stream, model: StepModel = _MODEL) -> NDArray[np.uint8]:
    """Return the extra bits that a model gives each row of a scales stream."""
    stored = parse(pack_streams([scales]))[SCALES, 0]
    return model.extra_bits(np.array(numbers(stored), np.float32))


def rotations(scales: Stream, seed: int, twist: StepModel = _MODEL) -> Stream:
    """Return a swing_twist stream of pseudo-random codes, with the lowest and highest code."""
    planes = []
    for column, model in enumerate((_MODEL, _MODEL, twist)):
        extra = extra_bits(scales, model)
        codes = [
            handmade.pseudo_random(1, (1 << int(h)) + 1, seed + 7 * row + column)[0] if h else 0
            for row, h in enumerate(extra)
        ]
        codes[:2] = [0, (1 << int(extra[1])) if extra[1] else 0]
        planes += swing_twist.split_component(np.array(codes, np.uint32), extra)
    params = _MODEL.pack() + twist.pack()
    return Stream(Attribute.QUATS, Kind.SWING_TWIST, scales.rows, params, planes)


def sorted_means(scales: Stream, seed: int, levels: int = 9) -> Stream:
    """Return a sorted stream of means whose extra bits depend on a scales stream."""
    cells = [handmade.pseudo_random(3, levels, seed + row) for row in range(scales.rows)]
    ranges = [(-3.0, 3.1, levels), (-2.0, 2.2, levels), (0.3, 0.9, levels)]
    return handmade.sorted_means(cells, ranges, _MODEL, extra_bits(scales).tolist(), seed)


def sh0_basis(rows: int, seed: int) -> Stream:
    """Return a basis stream of pseudo-random sh0."""
    axes = (0.6, 0.57, 0.56, -0.71, 0.05, 0.7, 0.37, -0.82, 1.0)
    body = handmade.random_scalar(Attribute.SH0, rows, seed, span=1.5, levels=90)
    return replace(body, kind=Kind.BASIS, params=body.params + struct.pack("<9f", *axes))


def shn_basis(codes: Sequence[Sequence[int]], book: int, step: float, shrink: float) -> Stream:
    """Return a basis stream of shN, given coordinates as lists; see `shn_transform.write`.

    Parameters
    ----------
    codes : sequence of sequence of int
        Coordinates of each row: signed multiples of `step`.
    book : int
        Number of the codebook whose rows are the basis.
    step : float
        Quantiser step of the coordinates.
    shrink : float
        Part of a step by which decoders reduce the magnitude of non-zero coordinates, 0 to 0.5.
    """
    return shn_transform.write(np.array(codes, np.int64), book, step, shrink)


def _chunk_vector(
    name: str, streams: Sequence[Stream], clauses: tuple[str, ...], note: str
) -> Valid:
    """Return a vector of one chunk; attributes without a given stream are constant."""
    rows = streams[0].rows
    head = pack_streams(handmade.uniform_head(rows, *streams))
    return Valid(name, build(one_chunk(head, rows)), clauses, note)


def pack_digits(body: Sequence[Stream], *, zstd: bool) -> bytes:
    """Return a payload whose planes of symbols below 16 are packed, in zstd frames if `zstd`."""
    records = [record(stream) for stream in body]
    for entry, stream in zip(records, body, strict=True):
        for number, plane in enumerate(stream.planes):
            raw = plane.tobytes()
            radix = max(raw, default=16) + 1
            if 2 <= radix <= 16:
                octets = pack_symbols(raw, radix)
                frame: bytes = zstandard.ZstdCompressor(level=19).compress(octets)
                stored = bytes([radix]) + (frame if zstd else octets)
                entry.planes[number] = (len(stored) | (3 if zstd else 1) << 30, stored)
    return payload(records)


def _packed() -> list[Valid]:
    """Return vectors with planes of every radix from 2 to 16."""
    rows = 40
    bands, first = [], 0
    for band in SH_BANDS:
        ranges, codes = [], []
        for value in range(first, first + COMPONENTS[band]):
            radix = 2 + value % 15
            ranges.append((-0.1 * value, 0.2 * value + 0.1, radix))
            codes.append([radix - 1, *handmade.pseudo_random(rows - 1, radix, value)])
        bands.append(handmade.scalar(band, ranges, codes))
        first += COMPONENTS[band]
    head = pack_streams(handmade.uniform_head(rows))
    made = []
    for name, zstd, note in (
        ("packed", False, "planes of radix 2 to 16, several symbols to the byte"),
        ("packed-zstd", True, "the same in zstd frames"),
    ):
        tail = pack_digits(bands, zstd=zstd)
        data = build(one_chunk(head, rows, tail=tail, sh_degree=3))
        made.append(Valid(name, data, ("6.3", "6.9"), note))
    return made


def _packed_ends() -> Valid:
    """Return the vector of planes whose last packed byte holds 1 to 8 symbols."""
    segments, rows = [], []
    for chunk, count in enumerate(range(1, 10)):
        opacities = handmade.scalar(Attribute.OPACITIES, [(-1.0, 1.0, 2)], [[1] * count])
        body = handmade.uniform_head(count, opacities)
        segments.append(Segment(SegmentKind.HEAD, chunk, pack_digits(body, zstd=False)))
        rows.append(ChunkRow(count))
    draft = Draft(root_keys(45, 0), [Group(segments, rows)])
    return Valid("packed-ends", build(draft), ("6.9",), "planes of 1 to 9 symbols of radix 2")


def _shn() -> list[Valid]:
    """Return the vectors of basis streams of shN."""
    rows = [
        [0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0],
        [-1, 2, 0, 0, 0],
        [0, 0, -300, 0, 0],
        [200, -200, 0, 5, 0],
        [0, 0, 0, 70000, 0],
    ]
    many = [
        [x - 1 for x in handmade.pseudo_random(5 * row, 3, row)] + [0] * (30 - 5 * row)
        for row in range(6)
    ]
    many[5][29] = 1
    many[2], many[5] = many[5], many[2]
    books = {"colour": (31, [pack_streams([handmade.band(i, 31, 2)]) for i in (1, 2)])}

    def file(name: str, stream: Stream, note: str) -> Valid:
        head = pack_streams(handmade.uniform_head(6))
        tail = pack_streams([stream])
        data = build(one_chunk(head, 6, tail=tail, sh_degree=2, books=books, needs=(0,)))
        return Valid(name, data, ("6.14",), note)

    return [
        file("shn-basis", shn_basis(rows, 0, 0.013, 0.2), "coordinates of 1, 2 and 3 bytes, ends"),
        file("shn-basis-groups", shn_basis(many, 0, 0.05, 0.1), "30 coordinates: shared planes"),
        file("shn-basis-flat", shn_basis([[0]] * 6, 0, 1.0, 0.0), "no coordinates: width 0"),
        file(
            "shn-basis-large", shn_basis([[1 << 22, -1]] * 6, 0, 2.0**32, 0.5), "the largest step"
        ),
    ]


def _sorted() -> Valid:
    """Return the vector of sorted means without extra bits."""
    codes = [
        [handmade.pseudo_random(1, 500, 3 * i + axis)[0] for axis in range(3)] for i in range(60)
    ]
    codes[7] = codes[8] = codes[9]
    means = handmade.sorted_means(codes, [(-3.0, 3.1, 500), (-2.0, 2.2, 500), (0.3, 0.9, 500)])
    data = build(one_chunk(pack_streams(handmade.random_head(60, 6, means)), 60))
    return Valid("sorted", data, ("6.5",), "means without extra bits, three of them equal")


def _sorted_wide() -> Valid:
    """Return the vector of sorted means with the most bits, 17 of the cell and 15 extra."""
    top = (1 << 17) - 1
    codes = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [top, top, top], [0, 0, 1 << 16], [7, 1 << 15, 0]]
    ranges = [(-1.0, 1.0, 1 << 17)] * 3
    means = handmade.sorted_means(codes, ranges, StepModel.constant(15), [15] * 6)
    data = build(one_chunk(pack_streams(handmade.random_head(6, 6, means)), 6))
    note = "17 bits an axis and 15 below: differences of up to 51 bits, codes above 2^24 rounded"
    return Valid("sorted-wide", data, ("6.5",), note)


def _sorted_flat() -> Valid:
    """Return the vector of equal means."""
    ranges = [(-0.0, -0.0, 1), (2.5, 2.5, 1), (0.1, 0.1, 1)]
    means = handmade.sorted_means([[0, 0, 0]] * 3, ranges)
    data = build(one_chunk(pack_streams(handmade.random_head(3, 6, means)), 3))
    return Valid("sorted-flat", data, ("6.5",), "equal means: planes of no bytes")


def _sorted_shapes() -> Valid:
    """Return the vector of means whose extra bits depend on a shape codebook and scale factors."""
    rows = 12
    shape = handmade.vq(Attribute.SHAPE, [i % 5 for i in range(rows)], 0, 5, 0)
    factor = handmade.random_scalar(Attribute.SCALE_FACTOR, rows, 9, span=4.0, levels=50)
    model = StepModel((5.5, 1.5, 0.25, 0.5, -0.5, 0.25))
    book = handmade.shape_codebook(5, 3)
    base = numbers(parse(pack_streams(book))[SCALES, 0])
    added = numbers(parse(pack_streams([factor]))[SCALE_FACTOR, 0])
    scales = [[f32(s + added[row][0]) for s in base[row % 5]] for row in range(rows)]
    extra = model.extra_bits(np.array(scales, np.float32)).tolist()
    cells = [handmade.pseudo_random(3, 9, row) for row in range(rows)]
    means = handmade.sorted_means(cells, [(-3.0, 3.1, 9)] * 3, model, extra)
    head = [factor if s.attribute == factor.attribute else s
            for s in handmade.vq_head(rows, 4, shape)]  # fmt: skip
    head = [means if s.attribute == means.attribute else s for s in head]
    books = {"shape": (5, [pack_streams(book)])}
    data = build(one_chunk(pack_streams(head), rows, books=books, needs=(0,)))
    note = "extra bits of means by scales from a codebook and a scale factor"
    return Valid("sorted-shapes", data, ("6.5", "6.10", "7.2"), note)


def _shapes_swing_twist() -> Valid:
    """Return the vector of a codebook and escape rows whose extra bits depend on their scales."""
    rows, size, escape = 12, 5, 4
    index = [size if i % 3 == 1 else i % size for i in range(rows)]
    shape = handmade.vq(Attribute.SHAPE, index, 0, size, escape)
    book, own = (differences(count, seed) for count, seed in ((size, 1), (escape, 2)))
    turned = [rotations(scales, 7) for scales in (book, own)]
    head = handmade.vq_head(
        rows, 4, shape, replace(own, flags=ESCAPE), replace(turned[1], flags=ESCAPE)
    )
    books = {"shape": (size, [pack_streams([book, turned[0]])])}
    data = build(one_chunk(pack_streams(head), rows, books=books, needs=(0,)))
    note = "a codebook and escape rows as differences and as swing and twist"
    return Valid("shapes-swing-twist", data, ("6.7", "6.10", "6.11", "7.1", "7.2"), note)


def _sorted_underflow(scales: Stream) -> Valid:
    """Return the vector of means with grid steps so small that half a step underflows float32."""
    cells = [handmade.pseudo_random(3, 9, 60 + row) for row in range(scales.rows)]
    ranges = [(0.0, 1e-40, 9), (-1e-41, 1e-41, 9), (1e-45, 3e-45, 9)]
    means = handmade.sorted_means(cells, ranges, _MODEL, extra_bits(scales).tolist(), 7)
    note = "steps that underflow when they are halved"
    return _chunk_vector("sorted-underflow", [scales, means], ("6.5",), note)


def _all_transform_kinds() -> Valid:
    """Return the vector of a chunk with all kinds of transform streams, and a colour codebook."""
    rows = 24
    scales = differences(rows, 2)
    head = [
        scales,
        rotations(scales, 3),
        sorted_means(scales, 4),
        handmade.random_scalar(Attribute.OPACITIES, rows, 5, span=5.0, levels=30),
        sh0_basis(rows, 6),
    ]
    codes = [[x - 2 for x in handmade.pseudo_random(7, 5, row)] for row in range(rows)]
    tail = [shn_basis(codes, 0, 0.1, 0.15)]
    books = {"colour": (9, [pack_streams([handmade.band(i, 9, 2)]) for i in (1, 2, 3)])}
    draft = one_chunk(
        pack_digits(head, zstd=True),
        rows,
        tail=pack_digits(tail, zstd=False),
        sh_degree=3,
        books=books,
        needs=(0,),
    )
    clauses = ("6.5", "6.9", "6.10", "6.11", "6.12", "6.13", "6.14")
    return Valid(
        "transform", build(draft), clauses, "all kinds of a transform-coded chunk, digits packed"
    )


def valid() -> list[Valid]:
    """Return the valid vectors of transform streams, in the order of the manifest."""
    scales = differences(24, 1)
    plain = handmade.random_scalar(Attribute.SCALES, 24, 8, span=6.0)
    never, always = StepModel.constant(-9), StepModel.constant(1_000_000)
    clauses = ("6.10", "6.11")
    return [
        *_packed(),
        _packed_ends(),
        _sorted(),
        _sorted_wide(),
        _sorted_flat(),
        _chunk_vector("sorted-bits", [scales, sorted_means(scales, 3)], ("6.5", "6.10"),
                      "means of 0 to 15 extra bits an axis"),
        _sorted_shapes(),
        _shapes_swing_twist(),
        _sorted_underflow(scales),
        _chunk_vector("differences", [scales], ("6.12",), "scales from the longest axis down"),
        _chunk_vector("swing-twist", [scales, rotations(scales, 2)], clauses,
                      "rotations of 0 to 15 extra bits"),
        _chunk_vector("swing-twist-coarse", [scales, rotations(scales, 2, never)], clauses,
                      "no twist at all"),
        _chunk_vector("swing-twist-fine", [plain, rotations(plain, 2, always)], clauses,
                      "15 extra bits of twist"),
        _chunk_vector("sh0-basis", [sh0_basis(24, 4)], ("6.13",), "sh0 on three axes"),
        *_shn(),
        _all_transform_kinds(),
    ]  # fmt: skip
