"""Valid vectors of rANS planes and of the kinds ladder, turn, fine and basis (SPEC 6.9 to 6.15)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec import bits, colour_streams, morton, turn
from cogsplat.codec.resolution import Resolution
from cogsplat.codec.streams import Attribute, Kind, Stream

from . import vectors_rans as rans
from . import vectors_scenes as scenes
from .vectors_file import build, one_chunk, pack_streams
from .vectors_streams import SCALES, numbers, parse
from .vectors_valid import Valid

_RESOLUTION: Final = Resolution((3.25, 1.5, 0.75, -0.25, 2.0, 0.5))
"""Halvings from 0 to 15 over the scales of `ladder`."""


def ladder(rows: int, seed: int) -> Stream:
    """Return a ladder stream of scales."""
    ranges = [(-5.0, 6.0, 40), (0.0, 4.1, 30), (-0.5, 3.3, 300)]
    codes = [scenes.numbers(rows, count, seed + i) for i, (_, _, count) in enumerate(ranges)]
    return replace(scenes.coded(Attribute.SCALES, ranges, codes), kind=Kind.LADDER)


def halvings(scales: Stream, resolution: Resolution = _RESOLUTION) -> NDArray[np.uint8]:
    """Return the halvings of each row of a scales stream."""
    stored = parse(pack_streams([scales]))[SCALES, 0]
    rows = np.array(numbers(stored), np.float32)
    return resolution.halvings(rows)


def turns(scales: Stream, seed: int, spin: Resolution = _RESOLUTION) -> Stream:
    """Return a turn stream of pseudo-random codes, with the first and the last among them."""
    planes = []
    for column, resolution in enumerate((_RESOLUTION, _RESOLUTION, spin)):
        halved = halvings(scales, resolution)
        codes = [
            scenes.numbers(1, (1 << int(h)) + 1, seed + 7 * row + column)[0] if h else 0
            for row, h in enumerate(halved)
        ]
        codes[:2] = [0, (1 << int(halved[1])) if halved[1] else 0]
        symbols, rest = turn.split(np.array(codes, np.uint32), halved)
        planes += [*symbols, rest]
    params = _RESOLUTION.pack() + spin.pack()
    return Stream(Attribute.QUATS, Kind.TURN, scales.rows, params, planes)


def fine_means(scales: Stream, seed: int, levels: int = 9) -> Stream:
    """Return a fine stream of means."""
    halved = halvings(scales)
    count = scales.rows
    cells = np.array([scenes.numbers(3, levels, seed + row) for row in range(count)], np.uint32)
    cells = cells[np.argsort(morton.interleave(cells), kind="stable")]
    classes, deltas = morton.pack_deltas(morton.interleave(cells))
    fields = [scenes.numbers(1, 1 << 3 * int(h), seed + 5 * i)[0] for i, h in enumerate(halved)]
    rest = bits.pack(np.array(fields, np.uint64), halved * np.uint8(3))
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
    return colour_streams.shn_on_basis(np.array(codes, np.int64), book, step, shrink)


def _one_stream(name: str, streams: Sequence[Stream], clauses: tuple[str, ...], note: str) -> Valid:
    rows = streams[0].rows
    head = pack_streams(scenes.still_head(rows, *streams))
    return Valid(name, build(one_chunk(head, rows)), clauses, note)


def _rans() -> list[Valid]:
    rows = 20
    head = scenes.head(rows, 3, scenes.quats(rows, 5, largest=[i % 4 for i in range(rows)]))
    tail = scenes.bands(1, rows, 9)

    def file(name: str, first: bytes, second: bytes, note: str) -> Valid:
        data = build(one_chunk(first, rows, tail=second, sh_degree=1))
        return Valid(name, data, ("6.3", "6.9"), note)

    one, eight = rans.pack(rans.coded(head, 1)), rans.pack(rans.coded(head, 8))
    many = rans.pack(rans.coded(tail, 64))
    mixed = rans.coded(tail, 2, plain=lambda stream, plane: plane % 3 == 1)
    one_code = scenes.coded(Attribute.OPACITIES, [(0.0, 1.0, 9)], [[7] * rows])
    still = rans.pack(rans.coded(scenes.still_head(rows, one_code), 1))
    return [
        file("rans", one, rans.pack(rans.coded(tail, 4)), "one lane, and four"),
        file("rans-lanes", eight, many, "lanes that the rows do not fill"),
        file("rans-mixed", one, rans.pack(mixed), "stored planes between rANS-coded ones"),
        file("rans-still", still, many, "a plane of one symbol: no words"),
    ]


def _vq_rans() -> Valid:
    shape = scenes.indices(Attribute.SHAPE, [*range(6), 260, 261], 0, 260, 2)
    own = [
        scenes.spread(Attribute.SCALES, 2, 70, levels=40, kept=True),
        scenes.quats(2, 71, kept=True),
    ]
    colour = scenes.indices(Attribute.SHN, [0, 1, 2, 3, 4, 5, 6, 7], 1, 4, 4)
    tail = [*scenes.bands(3, 4, 80, kept=True), colour]
    books = {
        "shape": (260, [rans.pack(rans.coded(scenes.shape_book(260, 1), 2))]),
        "colour": (4, [rans.pack(rans.coded([scenes.band(i, 4, 2)], 1)) for i in (1, 2, 3)]),
    }
    head = rans.pack(rans.coded(scenes.vq_head(8, 4, shape, *own), 2))
    draft = one_chunk(
        head, 8, tail=rans.pack(rans.coded(tail, 1)), sh_degree=3, books=books, needs=(0, 1)
    )
    return Valid("vq-rans", build(draft), ("6.9", "7.1", "7.2", "7.3"), "kept rows before indices")


def _shn() -> list[Valid]:
    rows = [
        [0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0],
        [-1, 2, 0, 0, 0],
        [0, 0, -300, 0, 0],
        [200, -200, 0, 5, 0],
        [0, 0, 0, 70000, 0],
    ]
    books = {"colour": (6, [pack_streams([scenes.band(i, 6, 2)]) for i in (1, 2)])}

    def file(name: str, stream: Stream, note: str) -> Valid:
        head = pack_streams(scenes.still_head(6))
        tail = pack_streams([stream])
        data = build(one_chunk(head, 6, tail=tail, sh_degree=2, books=books, needs=(0,)))
        return Valid(name, data, ("6.14",), note)

    return [
        file("shn-basis", shn_basis(rows, 0, 0.013, 0.2), "coordinates of 1, 2 and 3 bytes, ends"),
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
    books = {"colour": (9, [rans.pack(rans.coded([scenes.band(i, 9, 2)], 1)) for i in (1, 2, 3)])}
    draft = one_chunk(
        rans.pack(rans.coded(head, 4)),
        rows,
        tail=rans.pack(rans.coded(tail, 2)),
        sh_degree=3,
        books=books,
        needs=(0,),
    )
    clauses = ("6.9", "6.10", "6.11", "6.12", "6.13", "6.14", "6.15")
    return Valid(
        "transform", build(draft), clauses, "all kinds of a transform-coded chunk, in rANS"
    )


def valid() -> list[Valid]:
    """Return the vectors, in the order of the manifest."""
    scales = ladder(24, 1)
    plain = scenes.spread(Attribute.SCALES, 24, 8, span=6.0)
    never = Resolution((-9.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    always = Resolution((1e6, 0.0, 0.0, 0.0, 0.0, 0.0))
    return [
        *_rans(),
        _vq_rans(),
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
