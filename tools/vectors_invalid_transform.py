"""Must-reject vectors of rANS bodies and of the kinds turn, fine and basis (SPEC 6.9 to 6.15)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cogsplat.codec.streams import Attribute, Kind, Stream

from . import vectors_rans as rans
from . import vectors_scenes as scenes
from . import vectors_valid_transform as fine
from .vectors_file import Record, build, one_chunk, pack_streams, payload, record
from .vectors_invalid import Invalid


def _refused(name: str, head: bytes, rows: int, code: str, clause: str, note: str) -> Invalid:
    return Invalid(name, build(one_chunk(head, rows)), code, clause, note, "decode")


def bodies() -> list[Invalid]:
    """Return the vectors of SPEC 6.9."""
    rows = 12
    opacities = scenes.spread(Attribute.OPACITIES, rows, 3)
    sh0 = scenes.spread(Attribute.SH0, rows, 4)
    streams = scenes.still_head(rows, opacities, sh0)
    where = scenes.place(streams, Attribute.OPACITIES)
    good = rans.coded(streams, 2)

    def bad(name: str, code: str, note: str, data: bytes, clause: str = "6.9") -> Invalid:
        return _refused(name, data, rows, code, clause, note)

    def body(
        name: str, code: str, note: str, lanes: int, content: bytes, clause: str = "6.9"
    ) -> Invalid:
        return bad(name, code, note, payload(good.records, lanes=lanes, body=content), clause)

    def table(name: str, stored: bytes, note: str) -> Invalid:
        entries = _copied(good.records)
        entries[where].planes[0] = (len(stored) | 1 << 30, stored)
        data = payload(entries, lanes=2, body=good.body)
        return bad(name, "rans-table", note, data)

    def turned(order: Sequence[int]) -> bytes:
        return rans.pack(rans.coded([streams[i] for i in order], 2))

    both = _copied(good.records)
    both[where].planes[0] = (both[where].planes[0][0] | 1 << 31, both[where].planes[0][1])
    plain = [record(stream) for stream in streams]
    first = good.records[where].planes[0][1]
    low = struct.pack("<I", 0xFFFF) + good.body[4:]
    ended = rans.coded(streams, 2, start=(1 << 16) + 1)
    return [
        body("rans-lanes-3", "rans-lanes", "three lanes", 3, good.body + bytes(4)),
        body("rans-lanes-2048", "rans-lanes", "2048 lanes", 2048, good.body),
        body("rans-lanes-0", "stream-record", "planes in a body, no lanes", 0, good.body, "6.1"),
        bad("rans-no-planes", "stream-record", "lanes, and no plane in a body",
            payload(plain, lanes=2, body=good.body), "6.1"),
        body("rans-body-cut", "rans-states", "7 bytes for two states", 2, good.body[:7]),
        body("rans-body-none", "rans-states", "no bytes for two states", 2, b""),
        body("rans-state-low", "rans-states", "a state below 2^16", 2, low),
        body("rans-half-word", "rans-words", "half a word at the end", 2, good.body + b"\0"),
        body("rans-words-few", "rans-words", "a word missing", 2, good.body[:-2]),
        body("rans-words-more", "rans-end", "a word left over", 2, good.body + b"\0\0"),
        bad("rans-state-end", "rans-end", "a state that does not end at 2^16", rans.pack(ended)),
        bad("rans-both", "stream-record", "a plane of zstd and rANS", _packed(both, good), "6.3"),
        table("rans-table-none", b"", "a table of no bytes"),
        table("rans-table-cut", first[:-1], "the last code missing"),
        table("rans-table-more", first + b"\1", "a byte behind the table"),
        table("rans-table-zero", bytes([1, 5, 0]), "the last code is 0"),
        bad("rans-order", "stream-order", "sh0 before opacities", turned([0, 1, 2, 4, 3])),
        bad("rans-plane-missing", "rans-words", "more symbols than were coded",
            rans.pack(replace(good, body=rans.encode([], 2)))),
    ]  # fmt: skip


def _packed(records: Sequence[Record], found: rans.Coded) -> bytes:
    return payload(records, lanes=found.lanes, body=found.body)


def _copied(records: Sequence[Record]) -> list[Record]:
    return [Record(list(r.fields), r.params, list(r.planes)) for r in records]


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
        file("shn-kind", replace(good, kind=Kind.TURN), "stream-kind", "shN as turns", "6.2"),
    ]
