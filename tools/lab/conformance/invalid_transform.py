"""Must-reject vectors of packed planes, swing-twist, sorted means and bases (SPEC 6)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import zstandard

from cogsplat.codec.streams.records import Attribute, Kind, Stream

from . import handmade_streams as handmade
from . import valid_transform as good_streams
from .file_builder import build, one_chunk, pack_streams, pack_symbols, payload, record
from .invalid import Invalid


def _refused(name: str, head: bytes, rows: int, code: str, clause: str, note: str) -> Invalid:
    """Return a must-reject vector whose head decoding refuses."""
    return Invalid(name, build(one_chunk(head, rows)), code, clause, note, "decode")


def packings() -> list[Invalid]:
    """Return the vectors of invalid packed planes (SPEC 6.9)."""
    rows = 12
    codes = [row % 3 for row in range(rows)]
    opacities = handmade.scalar(Attribute.OPACITIES, [(-1.0, 1.0, 3)], [codes])
    body = handmade.uniform_head(rows, opacities)
    where = handmade.stream_index(body, Attribute.OPACITIES)
    good = pack_symbols(bytes(codes), 3)

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
        bad("packed-code", b"\4" + pack_symbols(bytes([3] * rows), 4), "code-range",
            "digits of 3 for 3 levels", "6.4"),
        bad("packed-frame", b"\3" + frame(good)[:-1], "zstd-frame", "a frame cut short", "6.3", 3),
        bad("packed-frame-size", b"\3" + frame(bytes(codes)), "zstd-size",
            "a frame of twelve bytes, not three", "6.3", 3),
        bad("packed-frame-none", b"\3", "zstd-frame", "a radix and no frame", "6.3", 3),
        bad("packed-frame-checksum", b"\3" + frame(good, checksum=True), "zstd-checksum",
            "a frame with a checksum", "6.3", 3),
    ]  # fmt: skip


def kinds() -> list[Invalid]:
    """Return the vectors of invalid step models, rotations, differences and bases of sh0.

    They break SPEC 6.5 or 6.10 to 6.13.
    """
    rows = 24
    scales = good_streams.differences(rows, 1)
    rotations = good_streams.rotations(scales, 2)
    means = good_streams.sorted_means(scales, 3)
    sh0 = good_streams.sh0_basis(rows, 4)

    def bad(name: str, changed: Sequence[Stream], code: str, clause: str, note: str) -> Invalid:
        head = pack_streams(handmade.uniform_head(rows, scales, *changed))
        return _refused(name, head, rows, code, clause, note)

    def params(stream: Stream, offset: int, value: float) -> Stream:
        changed = bytearray(stream.params)
        struct.pack_into("<f", changed, offset, value)
        return replace(stream, params=bytes(changed))

    def plane(stream: Stream, index: int, content: bytes) -> Stream:
        planes = list(stream.planes)
        planes[index] = np.frombuffer(content, np.uint8)
        return replace(stream, planes=planes)

    # Planes 0 to 5 are the symbols of the first component, plane 6 its low bits.
    extra = good_streams.extra_bits(scales)
    first = next(m for m in range(1, 7) if len(rotations.planes[m - 1]))
    beyond = bytes([200]) * len(rotations.planes[first - 1])
    padded = rotations.planes[6].tobytes()
    low = sum(max(int(h) - 6, 0) for h in extra) % 8
    filled = padded[:-1] + bytes([padded[-1] | 128]) if low else padded + b"\x80"
    # The last row with 15 extra bits has the last low bits: a symbol of 64 and a bit set.
    top = bytearray(rotations.planes[5].tobytes())
    top[:] = bytes([64]) * len(top)
    rest = means.planes[2].tobytes()
    bits = sum(3 * int(h) for h in extra) % 8
    spoilt = rest[:-1] + bytes([rest[-1] | 128]) if bits else rest + b"\x80"
    return [
        bad("swing-twist-params", [replace(rotations, params=rotations.params[:-4])],
            "stream-params", "6.2", "44 bytes of parameters, not 48"),
        bad("swing-twist-coefficient", [params(rotations, 8, 1.1e6)], "step-model", "6.10",
            "a coefficient above 10^6"),
        bad("swing-twist-coefficient-nan", [params(rotations, 24, float("nan"))], "step-model",
            "6.10", "a coefficient of NaN"),
        bad("swing-twist-20-planes", [replace(rotations, planes=rotations.planes[:-1])],
            "stream-planes", "6.2", "20 planes, not 21"),
        bad("swing-twist-code", [plane(rotations, first - 1, beyond)], "code-range", "6.11",
            "symbols of 200"),
        bad("swing-twist-low-bits", [plane(rotations, 5, bytes(top))], "code-range", "6.11",
            "codes above 2^h by their low bits"),
        bad("swing-twist-symbols-more", [plane(rotations, first - 1, beyond + b"\0")],
            "plane-length", "6.3", "a symbol more than rows"),
        bad("swing-twist-padding", [plane(rotations, 6, filled)], "bits-padding", "6.15",
            "a padding bit set"),
        bad("swing-twist-on-sh0", [replace(rotations, attribute=Attribute.SH0)], "stream-kind",
            "6.2", "sh0 as swing and twist"),
        bad("differences-on-means", [replace(scales, attribute=Attribute.MEANS)], "stream-kind",
            "6.2", "means as differences"),
        bad("sorted-coefficient", [params(means, 36, float("inf"))], "step-model", "6.10",
            "an infinite coefficient"),
        bad("sorted-low-short", [plane(means, 2, rest[:-1])], "plane-length", "6.3",
            "low bits one byte short"),
        bad("sorted-padding", [plane(means, 2, spoilt)], "bits-padding", "6.15",
            "a bit set behind the low bits"),
        bad("sorted-params", [replace(means, params=means.params[:-1])], "stream-params", "6.2",
            "59 bytes of parameters, not 60"),
        bad("sh0-axes", [params(sh0, 36, 1.5)], "basis-value", "6.13", "an axis of 1.5"),
        bad("sh0-axes-nan", [params(sh0, 68, float("nan"))], "basis-value", "6.13",
            "an axis of NaN"),
        bad("basis-on-opacities", [replace(sh0, attribute=Attribute.OPACITIES)], "stream-kind",
            "6.2", "opacities on axes"),
    ]  # fmt: skip


def large_planes() -> list[Invalid]:
    """Return the vector of a plane of more than 8 MiB (SPEC 9.1)."""
    rows, width = 36_800, 255
    ends = bytes([width]) * rows
    # Random opacities enlarge the file: the limit on decoded bytes grows with its size (SPEC 9.2).
    codes = handmade.pseudo_random(rows, 256, 1)
    opacities = handmade.scalar(Attribute.OPACITIES, [(-4.0, 4.0, 256)], [codes])
    # The inner codes of the last group, coordinates 26 to 254, are one byte: 228 a row.
    sizes = bytearray(2 * 12)
    sizes[22] = 1
    params = struct.pack("<IffHH", 0, 1.0, 0.0, width, 0) + bytes(sizes)
    stored: bytes = zstandard.ZstdCompressor(level=19).compress(bytes((width - 27) * rows))
    stream = Stream(Attribute.SHN, Kind.BASIS, rows, params, [])
    entry = record(stream)
    entry.planes = [(rows, ends), (len(stored) | 1 << 31, stored)]
    book = handmade.constant(Attribute.SH1, width, *[0.5] * 9)
    draft = one_chunk(
        pack_streams(handmade.uniform_head(rows, opacities)),
        rows,
        tail=payload([entry]),
        sh_degree=1,
        books={"colour": (width, [pack_streams([book])])},
        needs=(0,),
    )
    note = "a plane of 8,390,400 bytes"
    return [Invalid("plane-large", build(draft), "plane-length", "9.1", note, "decode")]


def bases() -> list[Invalid]:
    """Return the vectors of invalid basis streams of shN (SPEC 6.14)."""
    codes = [[1, 0, -2], [0, 3, 0], [300, 0, 1]]
    good = good_streams.shn_basis(codes, 0, 0.1, 0.2)
    book = handmade.band(1, 4, 2)

    def file(
        name: str, stream: Stream, code: str, note: str, clause: str = "6.14", book: Stream = book
    ) -> Invalid:
        head = pack_streams(handmade.uniform_head(3))
        tail = pack_streams([stream])
        books = {"colour": (4, [pack_streams([book])])}
        draft = one_chunk(head, 3, tail=tail, sh_degree=1, books=books, needs=(0,))
        return Invalid(name, build(draft), code, clause, note, "decode")

    def field(name: str, offset: int, layout: str, value: float, code: str, note: str) -> Invalid:
        changed = bytearray(good.params)
        struct.pack_into(f"<{layout}", changed, offset, value)
        clause = {"codebook-missing": "6.7", "stream-params": "6.2"}.get(code, "6.14")
        return file(name, replace(good, params=bytes(changed)), code, note, clause)

    wide = good_streams.shn_basis([[1] * 5] * 3, 0, 0.1, 0.2)
    ends = replace(good, planes=[np.array([3, 4, 3], np.uint8), *good.planes[1:]])
    high = handmade.scalar(Attribute.SH1, [(0.0, 2.0**33, 2)] * 9, [[0, 1, 0, 1]] * 9)
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
            "shn-kind",
            replace(good, kind=Kind.SWING_TWIST),
            "stream-kind",
            "shN as swing and twist",
            "6.2",
        ),
    ]
