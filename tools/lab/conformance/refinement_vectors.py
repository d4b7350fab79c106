"""Conformance vectors of refinements, valid and must-reject (SPEC 6.16, 6.17, 7.4)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cogsplat.codec.streams import refinement_bits, sorted_means
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import ENTRY_BYTES
from cogsplat.codec.streams.records import INFINITIES, Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from . import valid_transform as coarse
from .file_builder import ChunkRow, Draft, Group, build, pack_streams, root_keys
from .invalid import Invalid, with_segments
from .valid import Valid

_ROWS: Final = 24
_CELLS: Final = 9

_COARSE: Final = StepModel((-2.75, 1.0, 0.75, -0.25, 1.0, 0.5))
"""Step model that gives 0 to 10 extra bits for the scales of `coarse.differences`."""


def digits(attribute: Attribute, head: Stream, radices: Sequence[int], seed: int) -> Stream:
    """Return a digits stream that refines a stream of a head, with pseudo-random digits.

    Its first two rows have the lowest and the highest digit.
    """
    entries = list(struct.iter_unpack("<ffI", head.params[: len(radices) * ENTRY_BYTES]))
    grid = handmade.grid(
        [(-1.5 - i, 2.5 + i, entries[i][2] * radix) for i, radix in enumerate(radices)]
    )
    planes = [
        np.array([0, radix - 1, *handmade.pseudo_random(head.rows - 2, radix, seed + i)], np.uint8)
        for i, radix in enumerate(radices)
        if radix > 1
    ]
    return Stream(attribute, Kind.DIGITS, head.rows, grid.pack() + bytes(radices), planes)


def refined_means(
    scales: Stream, bits: int, seed: int, *, model: StepModel = _COARSE, cells: int = _CELLS
) -> tuple[Stream, Stream]:
    """Return pseudo-random sorted means of a head, and their refinement by `bits` bits per axis.

    The first row has the lowest code in head and refinement, 0, so that tests can go below it.

    Parameters
    ----------
    scales : Stream
        Scales of the head, from which `model` derives the extra bits.
    bits, seed : int
        Bits that the refinement adds to each axis; seed of the codes.
    model : StepModel
        Step model of the means.
    cells : int
        Number of cells along each axis.
    """
    extra = coarse.extra_bits(scales, model)
    count = scales.rows
    picked = [[0, 0, 0], *(handmade.pseudo_random(3, cells, seed + row) for row in range(1, count))]
    rows = np.array(picked, np.int64)
    rows = rows[sorted_means.morton_order(rows, np.zeros_like(extra))]
    low = np.array([handmade.pseudo_random(3, 1 << 15, seed + 50 + row) for row in range(count)])
    low[0] = 0
    codes = (rows << extra.astype(np.int64)[:, None]) | (low & ((1 << extra[:, None]) - 1))
    half = refinement_bits.half_level(bits)
    digit = np.array(
        [handmade.pseudo_random(3, 1 << bits, seed + 99 + row) for row in range(count)]
    )
    # No code may fall below 0.
    digit = np.where(codes == 0, digit | half, digit)
    digit[0] = half
    grid = handmade.grid([(-1.0, 1.0, cells), (-0.5, 0.5, cells), (0.0, 3.0, cells)])
    below = refinement_bits.write((codes << bits) + digit - half, bits)
    return sorted_means.write(codes, grid, extra, model), below


def _chunk(head: bytes, rows: int, refined: bytes) -> Draft:
    """Return the draft of a file of one chunk, given the payloads of its head and refinement."""
    segments = [Segment(SegmentKind.HEAD, 0, head), Segment(SegmentKind.REFINEMENT, 0, refined)]
    return Draft(root_keys(rows, 0), [Group(segments, [ChunkRow(rows)])])


def _refined_head(seed: int) -> tuple[list[Stream], list[Stream]]:
    """Return the streams of a head and of a refinement of all its attributes but rotations."""
    scales = coarse.differences(_ROWS, seed)
    moved, bits = refined_means(scales, 4, seed + 3)
    clear = handmade.random_scalar(Attribute.OPACITIES, _ROWS, seed + 4, span=5.0, levels=30)
    colour = coarse.sh0_basis(_ROWS, seed + 5)
    return [scales, coarse.rotations(scales, seed + 2), moved, clear, colour], [
        digits(Attribute.SCALES, scales, (3, 1, 16), seed + 1),
        bits,
        digits(Attribute.OPACITIES, clear, (5,), seed + 6),
        digits(Attribute.SH0, colour, (2, 7, 4), seed + 7),
    ]


def valid() -> list[Valid]:
    """Return the valid vectors of refinements, in the order of the manifest."""
    head, below = _refined_head(1)
    plain = handmade.random_head(12, 3)
    own = {stream.attribute: stream for stream in plain}
    scalar = [
        digits(Attribute.SCALES, own[Attribute.SCALES], (2, 3, 4), 5),
        digits(Attribute.OPACITIES, own[Attribute.OPACITIES], (16,), 6),
        digits(Attribute.SH0, own[Attribute.SH0], (1, 1, 1), 7),
    ]
    scales = coarse.differences(_ROWS, 4)
    moved, bits = refined_means(scales, 1, 6)
    still = handmade.uniform_head(_ROWS, scales, moved)
    most = StepModel.constant(15)
    far, most_bits = refined_means(scales, 15, 7, model=most, cells=1 << 17)
    wide = handmade.uniform_head(_ROWS, scales, far)

    def file(
        name: str, head: Sequence[Stream], below: Sequence[Stream], clauses: tuple[str, ...],
        note: str,
    ) -> Valid:  # fmt: skip
        draft = _chunk(pack_streams(head), head[0].rows, pack_streams(below))
        return Valid(name, build(draft), clauses, note)

    return [
        file("digits", plain, scalar, ("6.16", "7.4"),
             "scalar streams and digits of radix 1 to 16"),
        file("bits", still, [bits], ("6.17", "7.4"), "means that gain one bit an axis"),
        file("bits-most", wide, [most_bits], ("6.5", "6.17", "7.4"),
             "means of 17 bits an axis, 15 extra ones and 15 of a refinement"),
        file("refinement", head, below, ("6.16", "6.17", "7.4"),
             "all kinds refined, steps by scales that are not"),
        file("refinement-empty", plain, [], ("7.4",), "a refinement of no streams"),
        Valid("refinements", build(_late()), ("5.4", "7.4", "8.2"),
             "three chunks, two of them refined, late and out of order"),
    ]  # fmt: skip


def _late() -> Draft:
    """Return the draft of a file of three chunks whose two refinements come last."""
    bodies = [_refined_head(seed) for seed in (11, 31, 51)]
    heads = [
        Segment(SegmentKind.HEAD, chunk, pack_streams(head))
        for chunk, (head, _) in enumerate(bodies)
    ]
    first, last = (
        Segment(SegmentKind.REFINEMENT, chunk, pack_streams(bodies[chunk][1])) for chunk in (0, 2)
    )
    tail = Segment(SegmentKind.TAIL, 0, pack_streams(handmade.bands(1, _ROWS, 5)))
    segments = [heads[0], heads[1], tail, heads[2], last, first]
    return Draft(root_keys(3 * _ROWS, 1), [Group(segments, [ChunkRow(_ROWS)] * 3)])


def invalid_order() -> list[Invalid]:
    """Return the must-reject vectors of the order of refinement segments (SPEC 5.4)."""
    head, below = _refined_head(1)
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


def _padded() -> Invalid:
    """Return the vector with a padding bit set: five rows of three bits leave one bit."""
    scales = coarse.differences(5, 1)
    means, bits = refined_means(scales, 1, 5)
    octets = bytearray(bits.planes[0].tobytes())
    octets[-1] |= 0x80
    bits = replace(bits, planes=[np.frombuffer(bytes(octets), np.uint8)])
    head = pack_streams(handmade.uniform_head(5, scales, means))
    data = build(_chunk(head, 5, pack_streams([bits])))
    return Invalid("bits-padding", data, "bits-padding", "6.15", "a padding bit set", "decode")


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of refinements (SPEC 6.16, 6.17, 7.4)."""
    head, below = _refined_head(1)
    sizes, bits, clear, _ = below

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

    def replaced(stream: Stream) -> list[Stream]:
        return [stream if s.attribute == stream.attribute else s for s in head]

    few = bytearray(clear.params)
    struct.pack_into("<I", few, 8, 140)
    low = bits.planes[0].tobytes()
    # The first row's code in the head is 0: with refinement bits of 0 it becomes negative.
    below_zero = int.from_bytes(low, "little") & ~0xFFF
    under = below_zero.to_bytes(len(low), "little")
    infinite = handmade.scalar(
        Attribute.OPACITIES, [(-1.0, 1.0, 30)], [[31, *range(_ROWS - 1)]], flags=INFINITIES
    )
    logits = handmade.floats(Attribute.OPACITIES, [[0.5]] * _ROWS)
    factor = handmade.constant(Attribute.SCALE_FACTOR, _ROWS, 0.0)
    return [
        bad("digits-radix-0", [radices(0, 1, 16)], "refinement-radix", "6.16", "a radix of 0"),
        bad("digits-radix-17", [radices(3, 1, 17)], "refinement-radix", "6.16", "a radix of 17"),
        bad("digits-high", [plane(clear, 0, bytes([5]) * _ROWS)], "code-range", "6.16",
            "digits of 5 at radix 5"),
        bad("digits-code", [replace(clear, params=bytes(few))], "code-range", "6.16",
            "fine codes past 140 levels"),
        bad("digits-coarse", [digits(Attribute.OPACITIES, head[3], (2,), 1)], "code-range", "6.4",
            "a coarse code past its own grid", replaced(plane(head[3], 0, bytes([200]) * _ROWS))),
        bad("digits-params", [replace(sizes, params=sizes.params[:-1])], "stream-params", "6.2",
            "38 bytes of parameters, not 39"),
        bad("digits-planes", [replace(sizes, planes=sizes.planes[:1])], "stream-planes", "6.2",
            "one plane for two radices above 1"),
        bad("digits-infinities", [digits(Attribute.OPACITIES, infinite, (5,), 1)], "stream-kind",
            "6.16", "digits for a stream with infinities", replaced(infinite)),
        bad("digits-of-floats", [clear], "stream-kind", "7.4", "digits for a float stream",
            replaced(logits)),
        bad("digits-of-sorted", [replace(sizes, attribute=Attribute.MEANS)], "stream-kind", "7.4",
            "digits for sorted means"),
        bad("digits-scalar", [head[3]], "stream-kind", "7.4", "a scalar stream in a refinement"),
        bad("digits-in-head", [], "stream-kind", "6.2", "digits in a head", replaced(clear)),
        bad("digits-rows", [replace(clear, rows=_ROWS - 1, planes=[clear.planes[0][1:]])],
            "stream-rows", "6.2", "23 rows of digits for 24"),
        bad("bits-params", [replace(bits, params=bits.params[:1])], "stream-params", "6.2",
            "one byte of parameters, not four"),
        bad("bits-0", [replace(bits, params=bytes(4))], "refinement-bits", "6.17", "no bits"),
        bad("bits-16", [replace(bits, params=b"\x10\0\0\0")], "refinement-bits", "6.17",
            "16 bits"),
        bad("bits-reserved", [replace(bits, params=b"\4\0\0\1")], "refinement-bits", "6.17",
            "a reserved byte set"),
        bad("bits-planes", [replace(bits, planes=[])], "stream-planes", "6.2", "no plane"),
        bad("bits-short", [plane(bits, 0, low[:-1])], "plane-length", "6.3", "one byte short"),
        _padded(),
        bad("bits-below", [plane(bits, 0, under)], "code-range", "6.17", "a refined code below 0"),
        bad("bits-kind", [replace(bits, attribute=Attribute.SH0)], "stream-kind", "7.4",
            "bits for sh0"),
        bad("bits-in-head", [], "stream-kind", "6.2", "bits in a head", replaced(bits)),
        bad("bits-of-scalar", [bits], "stream-kind", "7.4", "bits for scalar means",
            handmade.random_head(_ROWS, 3)),
        bad("refinement-quats", [replace(bits, attribute=Attribute.QUATS)], "stream-unexpected",
            "7.4", "quats in a refinement"),
        bad("refinement-factor", [factor], "stream-unexpected", "7.4",
            "a scale factor in a refinement"),
        bad("refinement-escape", [replace(clear, flags=1)], "stream-unexpected", "7.4",
            "escape rows in a refinement"),
    ]  # fmt: skip
