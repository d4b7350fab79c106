"""Valid vectors of packed planes and of the kinds ladder, turn, fine and basis (SPEC 6.9 on)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import bit_fields, shn_transform, sorted_means, swing_twist
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.records import COMPONENTS, SH_BANDS, Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as scenes
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    build,
    one_chunk,
    pack_streams,
    packed_plane,
    payload,
    record,
    root_keys,
)
from .reference_streams import SCALES, numbers, parse
from .valid import Valid

_RESOLUTION: Final = StepModel((3.25, 1.5, 0.75, -0.25, 2.0, 0.5))
"""Halvings from 0 to 15 over the scales of `ladder`."""


def ladder(rows: int, seed: int) -> Stream:
    """Return a ladder stream of scales."""
    ranges = [(-5.0, 6.0, 40), (0.0, 4.1, 30), (-0.5, 3.3, 300)]
    codes = [scenes.numbers(rows, count, seed + i) for i, (_, _, count) in enumerate(ranges)]
    return replace(scenes.coded(Attribute.SCALES, ranges, codes), kind=Kind.DIFFERENCES)


def halvings(scales: Stream, resolution: StepModel = _RESOLUTION) -> NDArray[np.uint8]:
    """Return the halvings of each row of a scales stream."""
    stored = parse(pack_streams([scales]))[SCALES, 0]
    rows = np.array(numbers(stored), np.float32)
    return resolution.extra_bits(rows)


def turns(scales: Stream, seed: int, spin: StepModel = _RESOLUTION) -> Stream:
    """Return a turn stream of pseudo-random codes, with the first and the last among them."""
    planes = []
    for column, resolution in enumerate((_RESOLUTION, _RESOLUTION, spin)):
        halved = halvings(scales, resolution)
        codes = [
            scenes.numbers(1, (1 << int(h)) + 1, seed + 7 * row + column)[0] if h else 0
            for row, h in enumerate(halved)
        ]
        codes[:2] = [0, (1 << int(halved[1])) if halved[1] else 0]
        symbols, rest = swing_twist.split(np.array(codes, np.uint32), halved)
        planes += [*symbols, rest]
    params = _RESOLUTION.pack() + spin.pack()
    return Stream(Attribute.QUATS, Kind.SWING_TWIST, scales.rows, params, planes)


def fine_means(scales: Stream, seed: int, levels: int = 9) -> Stream:
    """Return a fine stream of means."""
    halved = halvings(scales)
    count = scales.rows
    cells = np.array([scenes.numbers(3, levels, seed + row) for row in range(count)], np.uint32)
    cells = cells[np.argsort(morton.interleave(cells), kind="stable")]
    classes, deltas = sorted_means.pack_deltas(morton.interleave(cells))
    fields = [scenes.numbers(1, 1 << 3 * int(h), seed + 5 * i)[0] for i, h in enumerate(halved)]
    rest = bit_fields.pack(np.array(fields, np.uint64), halved * np.uint8(3))
    ranges = [(-3.0, 3.1, levels), (-2.0, 2.2, levels), (0.3, 0.9, levels)]
    params = scenes.grid(ranges).pack() + _RESOLUTION.pack()
    return Stream(Attribute.MEANS, Kind.FINE, count, params, [classes, deltas, rest])


def sh0_basis(rows: int, seed: int) -> Stream:
    """Return a basis stream of sh0."""
    axes = (0.6, 0.57, 0.56, -0.71, 0.05, 0.7, 0.37, -0.82, 1.0)
    body = scenes.spread(Attribute.SH0, rows, seed, span=1.5, levels=90)
    return replace(body, kind=Kind.BASIS, params=body.params + struct.pack("<9f", *axes))


def shn_basis(codes: Sequence[Sequence[int]], book: int, step: float, shrink: float) -> Stream:
    """Return a basis stream of shN of signed coordinates, row by row."""
    return shn_transform.write(np.array(codes, np.int64), book, step, shrink)


def _one_stream(name: str, streams: Sequence[Stream], clauses: tuple[str, ...], note: str) -> Valid:
    rows = streams[0].rows
    head = pack_streams(scenes.still_head(rows, *streams))
    return Valid(name, build(one_chunk(head, rows)), clauses, note)


def pack_digits(body: Sequence[Stream], *, zstd: bool) -> bytes:
    """Return a payload whose planes are packed where their symbols are few enough."""
    records = [record(stream) for stream in body]
    for entry, stream in zip(records, body, strict=True):
        for number, plane in enumerate(stream.planes):
            raw = plane.tobytes()
            radix = max(raw, default=16) + 1
            if 2 <= radix <= 16:
                octets = packed_plane(raw, radix)
                frame: bytes = zstandard.ZstdCompressor(level=19).compress(octets)
                stored = bytes([radix]) + (frame if zstd else octets)
                entry.planes[number] = (len(stored) | (3 if zstd else 1) << 30, stored)
    return payload(records)


def _packed() -> list[Valid]:
    """Return files with planes of every radix."""
    rows = 40
    bands, first = [], 0
    for band in SH_BANDS:
        ranges, codes = [], []
        for value in range(first, first + COMPONENTS[band]):
            radix = 2 + value % 15
            ranges.append((-0.1 * value, 0.2 * value + 0.1, radix))
            codes.append([radix - 1, *scenes.numbers(rows - 1, radix, value)])
        bands.append(scenes.coded(band, ranges, codes))
        first += COMPONENTS[band]
    head = pack_streams(scenes.still_head(rows))
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
    """Return a file whose planes end at every place within a packed byte."""
    segments, rows = [], []
    for chunk, count in enumerate(range(1, 10)):
        opacities = scenes.coded(Attribute.OPACITIES, [(-1.0, 1.0, 2)], [[1] * count])
        body = scenes.still_head(count, opacities)
        segments.append(Segment(SegmentKind.HEAD, chunk, pack_digits(body, zstd=False)))
        rows.append(ChunkRow(count))
    draft = Draft(root_keys(45, 0), [Group(segments, rows)])
    return Valid("packed-ends", build(draft), ("6.9",), "planes of 1 to 9 symbols of radix 2")


def _shn() -> list[Valid]:
    rows = [
        [0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0],
        [-1, 2, 0, 0, 0],
        [0, 0, -300, 0, 0],
        [200, -200, 0, 5, 0],
        [0, 0, 0, 70000, 0],
    ]
    many = [
        [x - 1 for x in scenes.numbers(5 * row, 3, row)] + [0] * (30 - 5 * row) for row in range(6)
    ]
    many[5][29] = 1
    many[2], many[5] = many[5], many[2]
    books = {"colour": (31, [pack_streams([scenes.band(i, 31, 2)]) for i in (1, 2)])}

    def file(name: str, stream: Stream, note: str) -> Valid:
        head = pack_streams(scenes.still_head(6))
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


def _all_of_it() -> Valid:
    rows = 24
    scales = ladder(rows, 2)
    head = [
        scales,
        turns(scales, 3),
        fine_means(scales, 4),
        scenes.spread(Attribute.OPACITIES, rows, 5, span=5.0, levels=30),
        sh0_basis(rows, 6),
    ]
    codes = [[x - 2 for x in scenes.numbers(7, 5, row)] for row in range(rows)]
    tail = [shn_basis(codes, 0, 0.1, 0.15)]
    books = {"colour": (9, [pack_streams([scenes.band(i, 9, 2)]) for i in (1, 2, 3)])}
    draft = one_chunk(
        pack_digits(head, zstd=True),
        rows,
        tail=pack_digits(tail, zstd=False),
        sh_degree=3,
        books=books,
        needs=(0,),
    )
    clauses = ("6.9", "6.10", "6.11", "6.12", "6.13", "6.14", "6.15")
    return Valid(
        "transform", build(draft), clauses, "all kinds of a transform-coded chunk, digits packed"
    )


def valid() -> list[Valid]:
    """Return the vectors, in the order of the manifest."""
    scales = ladder(24, 1)
    plain = scenes.spread(Attribute.SCALES, 24, 8, span=6.0)
    never = StepModel((-9.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    always = StepModel((1e6, 0.0, 0.0, 0.0, 0.0, 0.0))
    return [
        *_packed(),
        _packed_ends(),
        _one_stream("ladder", [scales], ("6.12",), "scales from the longest axis down"),
        _one_stream(
            "turn", [scales, turns(scales, 2)], ("6.10", "6.11"), "turns of 0 to 15 halvings"
        ),
        _one_stream(
            "turn-coarse", [scales, turns(scales, 2, never)], ("6.10", "6.11"), "no spin at all"
        ),
        _one_stream(
            "turn-fine", [plain, turns(plain, 2, always)], ("6.10", "6.11"), "15 halvings of spin"
        ),
        _one_stream(
            "fine", [scales, fine_means(scales, 3)], ("6.10", "6.15"), "means, 0 to 45 bits"
        ),
        _one_stream("sh0-basis", [sh0_basis(24, 4)], ("6.13",), "sh0 on three axes"),
        *_shn(),
        _all_of_it(),
    ]
