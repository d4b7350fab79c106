"""Vectors of refinements (SPEC 6.16, 6.17, 7.4): valid ones, and others to refuse."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import refinement_bits, sorted_means, swing_twist
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import ENTRY_BYTES
from cogsplat.codec.streams.records import INFINITIES, Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as scenes
from . import valid_transform as coarse
from .file_builder import ChunkRow, Draft, Group, build, pack_streams, root_keys
from .invalid import Invalid, with_segments
from .reference_streams import SCALES, numbers, parse
from .valid import Valid

_ROWS: Final = 24
_CELLS: Final = 9

_COARSE: Final = StepModel((-2.75, 1.0, 0.75, -0.25, 1.0, 0.5))
"""Halvings from 0 to 10 over the scales of `coarse.ladder`."""

_GAIN: Final = 3.5


def digits(attribute: Attribute, head: Stream, radices: Sequence[int], seed: int) -> Stream:
    """Return digits for a stream of a head, of which the first and the last that there may be."""
    entries = list(struct.iter_unpack("<ffI", head.params[: len(radices) * ENTRY_BYTES]))
    grid = scenes.grid(
        [(-1.5 - i, 2.5 + i, entries[i][2] * radix) for i, radix in enumerate(radices)]
    )
    planes = [
        np.array([0, radix - 1, *scenes.numbers(head.rows - 2, radix, seed + i)], np.uint8)
        for i, radix in enumerate(radices)
        if radix > 1
    ]
    return Stream(attribute, Kind.DIGITS, head.rows, grid.pack() + bytes(radices), planes)


def _scales(head: Stream, below: Stream | None = None) -> NDArray[np.float32]:
    finer = None if below is None else parse(pack_streams([below]))[SCALES, 0]
    return np.array(numbers(parse(pack_streams([head]))[SCALES, 0], None, finer), np.float32)


def refined_turns(head: Stream, below: Stream | None, seed: int) -> tuple[Stream, Stream]:
    """Return turns of a head and their bits, by its scales and what refines those."""
    values = np.array([scenes.numbers(3, 2001, seed + row) for row in range(head.rows)]) / 1000 - 1
    values[:2] = [[-1, 1, -1], [1, -1, 1]]
    constants = [_COARSE.coefficients[0] + _GAIN, _COARSE.coefficients[0] + 1.25]
    stream, bits, _ = swing_twist.refined_turns(
        values, _scales(head), _COARSE, _COARSE, _scales(head, below), constants
    )
    return stream, bits


def refined_means(head: Stream, below: Stream | None, seed: int) -> tuple[Stream, Stream]:
    """Return fine means of a head and their bits, by its scales and what refines those."""
    halvings = _COARSE.extra_bits(_scales(head))
    constant = _COARSE.coefficients[0] + _GAIN
    finer = refinement_bits.with_constant(_COARSE, constant)
    extra = refinement_bits.gained(finer, _scales(head, below), halvings)
    # Cells in the order of their Morton codes; none but the first at an edge, where bits could
    # lead out of the grid.
    count = head.rows
    picked = [[0, 0, 0], *(scenes.numbers(3, _CELLS - 2, seed + row) for row in range(1, count))]
    cells = np.array(picked, np.uint32)
    cells[1:] += 1
    cells = cells[sorted_means.morton_order(cells, np.zeros_like(halvings))]
    wide, gain = halvings.astype(np.int64)[:, None], extra.astype(np.int64)[:, None]
    low = np.array([scenes.numbers(3, 1 << 15, seed + 50 + row) for row in range(count)])
    low[0] = 0
    stored = (cells.astype(np.int64) << wide) | (low & ((1 << wide) - 1))
    digit = np.array([scenes.numbers(3, 1 << 15, seed + 99 + row) for row in range(count)])
    digit[0] = 1 << 14
    fine = (stored << gain) + (digit >> 15 - gain) - ((1 << gain) >> 1)
    kept, bits = sorted_means.refine(fine.astype(np.uint32), extra, constant)
    grid = scenes.grid([(-1.0, 1.0, _CELLS), (-0.5, 0.5, _CELLS), (0.0, 3.0, _CELLS)])
    return sorted_means.write(kept, grid, halvings, _COARSE), bits


def _chunk(head: bytes, rows: int, refined: bytes) -> Draft:
    segments = [Segment(SegmentKind.HEAD, 0, head), Segment(SegmentKind.REFINEMENT, 0, refined)]
    return Draft(root_keys(rows, 0), [Group(segments, [ChunkRow(rows)])])


def _body(seed: int) -> tuple[list[Stream], list[Stream]]:
    """Return a head of all kinds that can be refined, and what refines it."""
    scales = coarse.ladder(_ROWS, seed)
    finer_scales = digits(Attribute.SCALES, scales, (3, 1, 16), seed + 1)
    turned, turn_bits = refined_turns(scales, finer_scales, seed + 2)
    moved, mean_bits = refined_means(scales, finer_scales, seed + 3)
    clear = scenes.spread(Attribute.OPACITIES, _ROWS, seed + 4, span=5.0, levels=30)
    colour = coarse.sh0_basis(_ROWS, seed + 5)
    return [scales, turned, moved, clear, colour], [
        finer_scales,
        turn_bits,
        mean_bits,
        digits(Attribute.OPACITIES, clear, (5,), seed + 6),
        digits(Attribute.SH0, colour, (2, 7, 4), seed + 7),
    ]


def valid() -> list[Valid]:
    """Return the vectors, in the order of the manifest."""
    head, below = _body(1)
    plain = scenes.head(12, 3)
    own = {stream.attribute: stream for stream in plain}
    scalar = [
        digits(Attribute.SCALES, own[Attribute.SCALES], (2, 3, 4), 5),
        digits(Attribute.OPACITIES, own[Attribute.OPACITIES], (16,), 6),
        digits(Attribute.SH0, own[Attribute.SH0], (1, 1, 1), 7),
    ]
    scales = coarse.ladder(_ROWS, 4)
    turned, turn_bits = refined_turns(scales, None, 5)
    moved, mean_bits = refined_means(scales, None, 6)
    still = scenes.still_head(_ROWS, scales, turned, moved)
    bits = pack_streams([turn_bits, mean_bits])

    def file(name: str, data: bytes, clauses: tuple[str, ...], note: str) -> Valid:
        return Valid(name, data, clauses, note)

    return [
        file("digits", build(_chunk(pack_streams(plain), 12, pack_streams(scalar))),
             ("6.16", "7.4"), "scalar streams and digits of radix 1 to 16"),
        file("bits", build(_chunk(pack_streams(still), _ROWS, bits)), ("6.17", "7.4"),
             "means and turns that gain halvings, some from none"),
        file("refinement", build(_chunk(pack_streams(head), _ROWS, pack_streams(below))),
             ("6.16", "6.17", "7.4"), "all kinds refined, halvings by refined scales"),
        file("refinement-empty", build(_chunk(pack_streams(plain), 12, pack_streams([]))),
             ("7.4",), "a refinement of no streams"),
        file("refinements", build(_late()), ("5.4", "7.4", "8.2"),
             "three chunks, two of them refined, late and out of order"),
    ]  # fmt: skip


def _late() -> Draft:
    bodies = [_body(seed) for seed in (11, 31, 51)]
    heads = [
        Segment(SegmentKind.HEAD, chunk, pack_streams(head))
        for chunk, (head, _) in enumerate(bodies)
    ]
    first, last = (
        Segment(SegmentKind.REFINEMENT, chunk, pack_streams(bodies[chunk][1])) for chunk in (0, 2)
    )
    tail = Segment(SegmentKind.TAIL, 0, pack_streams(scenes.bands(1, _ROWS, 5)))
    segments = [heads[0], heads[1], tail, heads[2], last, first]
    return Draft(root_keys(3 * _ROWS, 1), [Group(segments, [ChunkRow(_ROWS)] * 3)])


def orders() -> list[Invalid]:
    """Return the vectors of SPEC 5.4 about refinements."""
    head, below = _body(1)
    good = _chunk(pack_streams(head), _ROWS, pack_streams(below))
    first, refined = good.groups[0].segments

    def bad(name: str, segments: list[Segment], note: str) -> Invalid:
        data = build(with_segments(good, segments))
        return Invalid(name, data, "chunk-refinements", "5.4", note)

    return [
        bad("refinement-twice", [first, refined, refined], "two refinements of a chunk"),
        bad("refinement-first", [refined, first], "a refinement before its head"),
        bad(
            "refinement-beyond", [first, replace(refined, owner=1)], "a refinement of chunk 1 of 1"
        ),
    ]


def refinements() -> list[Invalid]:
    """Return the vectors of SPEC 6.16, 6.17 and 7.4."""
    head, below = _body(1)
    sizes, turn_bits, mean_bits, clear, _ = below
    halvings = _COARSE.extra_bits(_scales(head[0]))
    gained = refinement_bits.gained(
        refinement_bits.with_constant(_COARSE, _COARSE.coefficients[0] + _GAIN),
        _scales(head[0], sizes),
        halvings,
    )

    def bad(
        name: str, streams: Sequence[Stream], code: str, clause: str, note: str,
        body: Sequence[Stream] = head,
    ) -> Invalid:  # fmt: skip
        data = build(_chunk(pack_streams(body), _ROWS, pack_streams(streams)))
        return Invalid(name, data, code, clause, note, "decode")

    def plane(stream: Stream, index: int, content: bytes) -> Stream:
        planes = list(stream.planes)
        planes[index] = np.frombuffer(content, np.uint8)
        return replace(stream, planes=planes)

    def radices(*values: int) -> Stream:
        return replace(sizes, params=sizes.params[:-3] + bytes(values))

    few = bytearray(clear.params)
    struct.pack_into("<I", few, 8, 140)
    # The first row's coarse codes are 0: bits that count below them.
    low = mean_bits.planes[0].tobytes()
    below_zero = int.from_bytes(low, "little") & ~((1 << 3 * int(gained[0])) - 1)
    under = below_zero.to_bytes(len(low), "little")
    infinite = scenes.coded(
        Attribute.OPACITIES, [(-1.0, 1.0, 30)], [[31, *range(_ROWS - 1)]], flags=INFINITIES
    )
    fields = turn_bits.planes[-1].tobytes()
    factor = scenes.constant(Attribute.SCALE_FACTOR, _ROWS, 0.0)
    return [
        bad("digits-radix-0", [radices(0, 1, 16)], "refinement-radix", "6.16", "a radix of 0"),
        bad("digits-radix-17", [radices(3, 1, 17)], "refinement-radix", "6.16", "a radix of 17"),
        bad("digits-high", [plane(clear, 0, bytes([5]) * _ROWS)], "code-range", "6.16",
            "digits of 5 at radix 5"),
        bad("digits-code", [replace(clear, params=bytes(few))], "code-range", "6.16",
            "fine codes past 140 levels"),
        bad("digits-coarse", [digits(Attribute.OPACITIES, head[3], (2,), 1)], "code-range", "6.4",
            "a coarse code past its own grid", [*head[:3], plane(head[3], 0, bytes([200]) * _ROWS),
            head[4]]),
        bad("digits-params", [replace(sizes, params=sizes.params[:-1])], "stream-params", "6.2",
            "38 bytes of parameters, not 39"),
        bad("digits-planes", [replace(sizes, planes=sizes.planes[:1])], "stream-planes", "6.2",
            "one plane for two radices above 1"),
        bad("digits-infinities", [digits(Attribute.OPACITIES, infinite, (5,), 1)], "stream-kind",
            "6.16", "digits for a stream with infinities", [*head[:3], infinite, head[4]]),
        bad("digits-scalar", [replace(head[3], attribute=Attribute.OPACITIES)], "stream-kind",
            "7.4", "a scalar stream in a refinement"),
        bad("digits-in-head", [], "stream-kind", "6.2", "digits in a head", [*head[:3], clear,
            head[4]]),
        bad("digits-rows", [replace(clear, rows=_ROWS - 1, planes=[clear.planes[0][1:]])],
            "stream-rows", "6.2", "23 rows of digits for 24"),
        bad("bits-params", [replace(turn_bits, params=turn_bits.params[:4])], "stream-params",
            "6.2", "one constant, not two"),
        bad("bits-constant", [replace(mean_bits, params=struct.pack("<f", 1.1e6))],
            "resolution-value", "6.17", "a constant above 10^6"),
        bad("bits-constant-nan", [replace(mean_bits, params=struct.pack("<f", float("nan")))],
            "resolution-value", "6.17", "a constant of NaN"),
        bad("bits-planes", [replace(turn_bits, planes=turn_bits.planes[1:])], "stream-planes",
            "6.2", "a plane less than the scales imply"),
        bad("bits-means-planes", [sizes, replace(mean_bits, planes=[])], "stream-planes", "6.2",
            "means without a plane"),
        bad("bits-short", [sizes, plane(mean_bits, 0, low[:-1])], "plane-length", "6.3",
            "bits one byte short"),
        bad("bits-below", [sizes, plane(mean_bits, 0, under)], "code-range", "6.17",
            "a fine code below 0"),
        bad("bits-turn-below", [sizes, plane(turn_bits, -1, bytes(len(fields)))], "code-range",
            "6.17", "a turn's fine code below 0"),
        bad("bits-kind", [replace(mean_bits, attribute=Attribute.SH0)], "stream-kind", "7.4",
            "bits for sh0"),
        bad("bits-of-scalar", [mean_bits], "stream-kind", "7.4",
            "bits for scalar means", scenes.head(_ROWS, 3)),
        bad("refinement-factor", [factor], "stream-unexpected", "7.4",
            "a scale factor in a refinement"),
        bad("refinement-kept", [replace(clear, flags=1)], "stream-unexpected", "7.4",
            "kept rows in a refinement"),
    ]  # fmt: skip
