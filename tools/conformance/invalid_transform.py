"""Must-reject vectors of packed planes and of the kinds turn, fine and basis (SPEC 6.9 on)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import zstandard

from cogsplat.codec.streams.records import Attribute, Kind, Stream

from . import handmade_streams as scenes
from . import valid_transform as fine
from .file_builder import build, one_chunk, pack_streams, packed_plane, payload, record
from .invalid import Invalid


def _refused(name: str, head: bytes, rows: int, code: str, clause: str, note: str) -> Invalid:
    return Invalid(name, build(one_chunk(head, rows)), code, clause, note, "decode")


def packings() -> list[Invalid]:
    """Return the vectors of SPEC 6.9."""
    rows = 12
    codes = [row % 3 for row in range(rows)]
    opacities = scenes.coded(Attribute.OPACITIES, [(-1.0, 1.0, 3)], [codes])
    body = scenes.still_head(rows, opacities)
    where = scenes.place(body, Attribute.OPACITIES)
    good = packed_plane(bytes(codes), 3)

    def bad(
        name: str, stored: bytes, code: str, note: str, clause: str = "6.9", flags: int = 1
    ) -> Invalid:
        entries = [record(stream) for stream in body]
        entries[where].planes = [(len(stored) | flags << 30, stored)]
        return _refused(name, payload(entries), rows, code, clause, note)

    def frame(octets: bytes, *, checksum: bool = False) -> bytes:
        made: bytes = zstandard.ZstdCompressor(level=19, write_checksum=checksum).compress(octets)
        return made

    return [
        bad("packed-none", b"", "plane-radix", "no radix"),
        bad("packed-radix-0", b"\0" + good, "plane-radix", "radix 0"),
        bad("packed-radix-1", b"\1" + bytes(rows), "plane-radix", "radix 1"),
        bad("packed-radix-17", b"\x11" + bytes(rows), "plane-radix", "radix 17"),
        bad("packed-short", b"\3" + good[:-1], "plane-length", "two bytes, not three", "6.3"),
        bad("packed-long", b"\3" + good + b"\0", "plane-length", "four bytes, not three", "6.3"),
        bad("packed-digits", b"\3\xf3" + good[1:], "plane-digits", "byte 243 at radix 3"),
        bad("packed-behind", b"\3" + good[:2] + b"\x09", "plane-digits", "a digit behind the last"),
        bad("packed-code", b"\4" + packed_plane(bytes([3] * rows), 4), "code-range",
            "digits of 3 for 3 levels", "6.4"),
        bad("packed-frame", b"\3" + frame(good)[:-1], "zstd-frame", "a frame cut short", "6.3", 3),
        bad("packed-frame-size", b"\3" + frame(bytes(codes)), "zstd-size",
            "a frame of twelve bytes, not three", "6.3", 3),
        bad("packed-frame-none", b"\3", "zstd-frame", "a radix and no frame", "6.3", 3),
        bad("packed-frame-checksum", b"\3" + frame(good, checksum=True), "zstd-checksum",
            "a frame with a checksum", "6.3", 3),
    ]  # fmt: skip


def kinds() -> list[Invalid]:
    """Return the vectors of SPEC 6.10 to 6.13 and 6.15."""
    rows = 24
    scales = fine.ladder(rows, 1)
    turns = fine.turns(scales, 2)
    means = fine.fine_means(scales, 3)
    sh0 = fine.sh0_basis(rows, 4)
    halved = fine.halvings(scales)

    def bad(name: str, changed: Sequence[Stream], code: str, clause: str, note: str) -> Invalid:
        head = pack_streams(scenes.still_head(rows, scales, *changed))
        return _refused(name, head, rows, code, clause, note)

    def params(stream: Stream, offset: int, value: float) -> Stream:
        changed = bytearray(stream.params)
        struct.pack_into("<f", changed, offset, value)
        return replace(stream, params=bytes(changed))

    def plane(stream: Stream, index: int, content: bytes) -> Stream:
        planes = list(stream.planes)
        planes[index] = np.frombuffer(content, np.uint8)
        return replace(stream, planes=planes)

    groups = len({min(int(h), 6) for h in halved if h})
    beyond = bytes([200]) * len(turns.planes[0])
    padded = turns.planes[groups].tobytes()
    spare = sum(max(int(h) - 6, 0) for h in halved) % 8
    filled = padded[:-1] + bytes([padded[-1] | 128]) if spare else padded + b"\x80"
    rest = means.planes[2].tobytes()
    past = fine.fine_means(scales, 3, levels=12)
    short = replace(past, params=scenes.grid([(-1.0, 1.0, 5)] * 3).pack() + past.params[36:])
    wide = replace(means, params=scenes.grid([(-1.0, 1.0, (1 << 21) + 1)] * 3).pack()
                   + means.params[36:])  # fmt: skip
    return [
        bad("turn-params", [replace(turns, params=turns.params[:-4])], "stream-params", "6.2",
            "44 bytes of parameters, not 48"),
        bad("turn-coefficient", [params(turns, 8, 1.1e6)], "resolution-value", "6.10",
            "a coefficient above 10^6"),
        bad("turn-coefficient-nan", [params(turns, 24, float("nan"))], "resolution-value", "6.10",
            "a coefficient of NaN"),
        bad("turn-planes", [replace(turns, planes=turns.planes[:-1])], "stream-planes", "6.11",
            "a plane less than the scales imply"),
        bad("turn-code", [plane(turns, 0, beyond)], "code-range", "6.11",
            "codes of 200 where there is one halving"),
        bad("turn-padding", [plane(turns, groups, filled)], "bits-padding", "6.5",
            "a padding bit set"),
        bad("turn-on-scales", [replace(turns, attribute=Attribute.SH0)], "stream-kind", "6.2",
            "sh0 as turns"),
        bad("ladder-on-means", [replace(scales, attribute=Attribute.MEANS)], "stream-kind", "6.2",
            "means as a ladder"),
        bad("fine-planes", [replace(means, planes=means.planes[:2])], "stream-planes", "6.15",
            "two planes, not three"),
        bad("fine-coefficient", [params(means, 36, float("inf"))], "resolution-value", "6.10",
            "an infinite coefficient"),
        bad("fine-code", [short], "code-range", "6.15", "coarse codes past 5 levels"),
        bad("fine-levels", [wide], "grid-levels", "6.4", "2^21 + 1 coarse levels"),
        bad("fine-rest-short", [plane(means, 2, rest[:-1])], "plane-length", "6.3",
            "low bits one byte short"),
        bad("fine-params", [replace(means, params=means.params[:-1])], "stream-params", "6.2",
            "59 bytes of parameters, not 60"),
        bad("sh0-axes", [params(sh0, 36, 1.5)], "basis-value", "6.13", "an axis of 1.5"),
        bad("sh0-axes-nan", [params(sh0, 68, float("nan"))], "basis-value", "6.13",
            "an axis of NaN"),
        bad("basis-on-scales", [replace(sh0, attribute=Attribute.OPACITIES)], "stream-kind", "6.2",
            "opacities on axes"),
    ]  # fmt: skip


def bases() -> list[Invalid]:
    """Return the vectors of SPEC 6.14."""
    codes = [[1, 0, -2], [0, 3, 0], [300, 0, 1]]
    good = fine.shn_basis(codes, 0, 0.1, 0.2)
    book = scenes.band(1, 4, 2)

    def file(
        name: str, stream: Stream, code: str, note: str, clause: str = "6.14", book: Stream = book
    ) -> Invalid:
        head = pack_streams(scenes.still_head(3))
        tail = pack_streams([stream])
        books = {"colour": (4, [pack_streams([book])])}
        draft = one_chunk(head, 3, tail=tail, sh_degree=1, books=books, needs=(0,))
        return Invalid(name, build(draft), code, clause, note, "decode")

    def field(name: str, offset: int, layout: str, value: float, code: str, note: str) -> Invalid:
        changed = bytearray(good.params)
        struct.pack_into(f"<{layout}", changed, offset, value)
        clause = {"codebook-missing": "6.7", "stream-params": "6.2"}.get(code, "6.14")
        return file(name, replace(good, params=bytes(changed)), code, note, clause)

    wide = fine.shn_basis([[1] * 5] * 3, 0, 0.1, 0.2)
    ends = replace(good, planes=[np.array([3, 4, 3], np.uint8), *good.planes[1:]])
    high = scenes.coded(Attribute.SH1, [(0.0, 2.0**33, 2)] * 9, [[0, 1, 0, 1]] * 9)
    return [
        field("shn-book", 0, "I", 1, "codebook-missing", "codebook 1 of one"),
        field("shn-step-0", 4, "f", 0.0, "basis-value", "a step of 0"),
        field("shn-step-nan", 4, "f", float("nan"), "basis-value", "a step of NaN"),
        field("shn-step-huge", 4, "f", 2.0**33, "basis-value", "a step of 2^33"),
        field("shn-shrink", 8, "f", 0.75, "basis-value", "a shrink of 0.75"),
        field("shn-reserved", 14, "H", 1, "basis-width", "reserved bytes set"),
        field("shn-width-long", 12, "H", 4, "stream-params", "four coordinates, sizes of three"),
        field("shn-sizes", 16, "B", 4, "stream-planes", "codes of four bytes"),
        file("shn-width", wide, "basis-width", "five coordinates on a basis of four rows"),
        file("shn-ends", ends, "code-range", "an end of 4 of 3 coordinates"),
        file("shn-params", replace(good, params=good.params[:15]), "stream-params", "15 bytes"),
        file("shn-planes", replace(good, planes=good.planes[:-1]), "stream-planes", "one missing"),
        file("shn-basis-high", good, "basis-value", "a basis that reaches 2^33", book=high),
        file(
            "shn-kind", replace(good, kind=Kind.SWING_TWIST), "stream-kind", "shN as turns", "6.2"
        ),
    ]
