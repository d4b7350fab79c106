"""Conformance vectors of chunks that end and of levels (SPEC 5.10, 5.11, 7.5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute, Kind, Stream
from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    Index,
    build,
    in_pages,
    pack_streams,
    payload,
    record,
    root_keys,
    table,
)
from .invalid import Invalid, build_edited, key_setter, uniform_chunk, with_segments
from .refinement_vectors import digits
from .valid import Valid

_ROWS = 7


def _level(chunks: Value, scale: Value) -> Value:
    """Return an entry of the key ``levels``."""
    return {"chunks": chunks, "scale": scale}


def _head(chunk: int, *changed: Stream) -> Segment:
    """Return the random head of a chunk in which given streams are replaced."""
    return Segment(
        SegmentKind.HEAD, chunk, pack_streams(handmade.random_head(_ROWS, 3 + chunk, *changed))
    )


def _opacities(chunk: int, *streams: Stream) -> Segment:
    """Return an opacities segment of a chunk, with given streams."""
    return Segment(SegmentKind.OPACITIES, chunk, pack_streams(streams))


def _logits(seed: int) -> Stream:
    """Return a scalar stream of pseudo-random opacities, as logits."""
    return handmade.random_scalar(Attribute.OPACITIES, _ROWS, seed, span=4.0)


def _differences(seed: int) -> Stream:
    """Return a stream of opacities as pseudo-random differences from the head."""
    return replace(_logits(seed), kind=Kind.DIFFERENCES)


def _tail(chunk: int) -> Segment:
    """Return the random tail of a chunk, SH degree 1."""
    return Segment(SegmentKind.TAIL, chunk, pack_streams(handmade.bands(1, _ROWS, 5 + chunk)))


def _refinement(chunk: int) -> Segment:
    """Return a refinement of a chunk's scales and opacities."""
    own = {stream.attribute: stream for stream in handmade.random_head(_ROWS, 3 + chunk)}
    finer = [
        digits(Attribute.SCALES, own[Attribute.SCALES], (2, 3, 4), 5 + chunk),
        digits(Attribute.OPACITIES, own[Attribute.OPACITIES], (16,), 6 + chunk),
    ]
    return Segment(SegmentKind.REFINEMENT, chunk, pack_streams(finer))


def _ending_chunks() -> Draft:
    """Return the draft of four chunks; chunk 0 ends at 3 chunks of prefix, chunk 1 at 4."""
    segments = [
        _head(0), _head(1), _tail(0), _head(2), _refinement(0), _tail(2), _head(3), _refinement(3),
    ]  # fmt: skip
    rows = [ChunkRow(_ROWS, until=until) for until in (3, 4, 0, 0)]
    return Draft(root_keys(4 * _ROWS, 1), [Group(segments, rows)])


def _three_levels() -> Draft:
    """Return the draft of levels of two, three and five chunks; chunk 1 ends at level 1."""
    infinite = handmade.scalar(
        Attribute.OPACITIES, [(-1.0, 1.0, 30)], [[31, 30, 1, 2, 3, 4, 5]], flags=INFINITIES
    )
    segments = [
        _head(0), _head(1), _refinement(0), _tail(1), _tail(0),
        _opacities(0, _logits(41)), _head(2, infinite),
        _head(3), _opacities(0, _differences(42)), _opacities(2, _differences(43)), _head(4),
        _tail(4),
    ]  # fmt: skip
    rows = [
        ChunkRow(_ROWS, layer=layer, until=until)
        for layer, until in ((0, 0), (0, 3), (1, 0), (2, 0), (2, 0))
    ]
    levels: list[Value] = [_level(2, 4.0), _level(3, 2.0), _level(5, 1.0)]
    return Draft(root_keys(5 * _ROWS, 1, levels=levels), [Group(segments, rows)])


def _kept_opacities() -> Draft:
    """Return the draft of four levels; only chunk 0 has opacities of a later level."""
    floats = handmade.floats(
        Attribute.OPACITIES, [[-0.0], [math.inf], [-math.inf], [1.0], [2.0], [2.0**100], [-3.5]]
    )
    segments = [
        _head(0), _opacities(0, floats), _head(1), _head(2), _refinement(1), _head(3),
    ]  # fmt: skip
    levels: list[Value] = [_level(k + 1, 8.0 / 2**k) for k in range(4)]
    rows = [ChunkRow(_ROWS, until=until) for until in (4, 0, 0, 0)]
    return Draft(root_keys(4 * _ROWS, 0, levels=levels), [Group(segments, rows)])


def _compensated_ending() -> Draft:
    """Return the draft of `_ending_chunks` with a compensation layer of its first two chunks."""
    layer: dict[str, Value] = {
        "scales": b"\x33\x0b", "opacities": b"\x21\xf5", "strengths": bytes(4),
        "book": b"", "codes": b"",
    }  # fmt: skip
    draft = _ending_chunks()
    first = Segment(SegmentKind.COMPENSATION, 0, pack(layer))
    group = draft.groups[0]
    return replace(draft, groups=[Group([first, *group.segments], group.chunks)])


def valid() -> list[Valid]:
    """Return the valid vectors of chunks that end and of levels (SPEC 5.10, 5.11, 7.5)."""
    ending, levelled = _ending_chunks(), _three_levels()
    rest = len(levelled.groups[0].chunks) - 3
    ends, levels = in_pages(ending, [2, 2]), in_pages(levelled, [2, 1, rest])
    return [
        Valid("ends", build(ending), ("5.10", "8.2"),
              "four chunks of which two end, one of them with the file"),
        Valid("ends-pages", build(ends), ("5.6", "5.10", "8.2"), "the same listed in pages"),
        Valid("ends-compensation", build(_compensated_ending()), ("5.10", "8.5"),
              "the same compensated, ended chunks counted"),
        Valid("levels", build(levelled), ("5.10", "5.11", "6.12", "7.5"),
              "three levels; opacities as they are and as differences, also to infinities"),
        Valid("levels-pages", build(levels), ("5.6", "5.11", "7.5"), "the same listed in pages"),
        Valid("levels-kept", build(_kept_opacities()), ("5.11", "7.5"),
              "opacities of one later level that the next keeps; chunks without"),
    ]  # fmt: skip


def invalid_ends() -> list[Invalid]:
    """Return the must-reject vectors of chunks that end (SPEC 5.10)."""

    def bad(name: str, chunk: int, until: int, note: str) -> Invalid:
        draft = _ending_chunks()
        group = draft.groups[0]
        rows = list(group.chunks)
        rows[chunk] = replace(rows[chunk], until=until)
        data = build(replace(draft, groups=[Group(group.segments, rows)]))
        return Invalid(name, data, "chunk-until", "5.10", note)

    short = build_edited(uniform_chunk(), key_setter("until", bytes(8), within="chunks"))
    return [
        bad("until-before", 2, 3, "a chunk that ends with itself"),
        bad("until-1", 0, 1, "a first chunk that is never drawn"),
        bad("until-beyond", 1, 5, "an end behind four chunks"),
        Invalid("chunks-until", short, "root-columns", "5.4", "two ends for one chunk"),
    ]


def invalid_levels() -> list[Invalid]:
    """Return the must-reject vectors of the root's levels (SPEC 5.11)."""

    def bad(name: str, value: Value, code: str, note: str, clause: str = "5.11") -> Invalid:
        return Invalid(
            name, build_edited(_three_levels(), key_setter("levels", value)), code, clause, note
        )

    def pair(
        name: str, first: Value, second: Value, note: str, code: str = "root-value"
    ) -> Invalid:
        return bad(name, [first, second], code, note)

    whole = _level(5, 1.0)
    heads = _three_levels().groups[0]
    rest = [s for s in heads.segments if (s.kind, s.owner) != (SegmentKind.HEAD, 4)]

    def fewer(index: Index) -> None:
        index["levels"] = [_level(3, 1.0)]

    both = with_segments(_three_levels(), rest)
    sealed: Value = {"chunks": 5, "scale": 1.0, "colour!": 1}
    return [
        bad("levels-map", {}, "root-type", "levels in a map", "4.2"),
        bad("levels-none", [], "root-value", "no level", "4.2"),
        bad("levels-17", [_level(k + 1, 20.0 - k) for k in range(17)], "root-value", "17 levels",
            "4.2"),
        bad("level-text", ["1"], "root-type", "a level that is no map"),
        bad("level-no-scale", [{"chunks": 5}], "root-missing", "no scale"),
        bad("level-scale-integer", [_level(5, 1)], "root-type", "a scale that is an integer"),
        bad("level-chunks-0", [_level(0, 2.0), whole], "root-value", "a level of no chunks"),
        bad("level-must-understand", [sealed], "root-must-understand", "a key with !", "4.3"),
        pair("level-no-growth", _level(5, 2.0), whole, "two levels of five chunks"),
        pair("level-scale-rising", _level(2, 0.5), whole, "a scale above the one before"),
        pair("level-scale-0", _level(2, 4.0), _level(5, 0.0), "a scale of 0"),
        pair("level-scale-nan", _level(2, math.nan), whole, "a scale of NaN"),
        pair("level-scale-infinite", _level(2, math.inf), whole, "an infinite scale"),
        pair("level-fewer", _level(2, 2.0), _level(4, 1.0), "levels of four chunks of five",
             "level-chunks"),
        pair("level-more", _level(2, 2.0), _level(6, 1.0), "levels of six chunks of five",
             "level-chunks"),
        Invalid("order-levels-heads", build_edited(both, fewer), "level-chunks", "5.11",
                "levels of three chunks of five, and a chunk without a head"),
    ]  # fmt: skip


def invalid_opacities() -> list[Invalid]:
    """Return the must-reject vectors of segments of opacities (SPEC 5.11, 7.5)."""
    draft = _three_levels()
    body = list(draft.groups[0].segments)
    logits = _opacities(0, _logits(44))

    def order(name: str, segments: Sequence[Segment], note: str) -> Invalid:
        data = build(with_segments(draft, segments))
        return Invalid(name, data, "chunk-opacities", "5.11", note)

    def last(name: str, data: bytes, code: str, clause: str, note: str) -> Invalid:
        """Return a vector in which the last opacities payload of chunk 0 is replaced by `data`."""
        place = max(k for k, s in enumerate(body)
                    if (s.kind, s.owner) == (SegmentKind.OPACITIES, 0))  # fmt: skip
        changed = [*body[:place], replace(body[place], payload=data), *body[place + 1 :]]
        return Invalid(name, build(with_segments(draft, changed)), code, clause, note, "decode")

    def streams(name: str, found: Sequence[Stream], code: str, clause: str, note: str) -> Invalid:
        return last(name, pack_streams(found), code, clause, note)

    def levelless(index: Index) -> None:
        del index["levels"]

    def ended(index: Index) -> None:
        table(index, "chunks")["until"] = b"".join(
            until.to_bytes(4, "little") for until in (3, 3, 0, 0, 0)
        )

    mixed = [_logits(44), handmade.constant(Attribute.SH0, _ROWS, 0.0, 0.0, 0.0)]
    escape = replace(_logits(44), flags=ESCAPE)
    fewer = handmade.random_scalar(Attribute.OPACITIES, _ROWS - 1, 44)
    own = {stream.attribute: stream for stream in handmade.random_head(_ROWS, 3)}
    finer = digits(Attribute.OPACITIES, own[Attribute.OPACITIES], (16,), 6)
    sealed = payload([record(_differences(44), flags=INFINITIES)])
    differing = [_head(0, _differences(4)), *body[1:]]
    return [
        Invalid("opacities-no-levels", build_edited(draft, levelless), "chunk-opacities", "5.11",
                "opacities of levels in a file without"),
        Invalid("opacities-ended", build_edited(draft, ended), "chunk-opacities", "5.11",
                "opacities of two later levels of a chunk that ends at level 1"),
        order("opacities-more", [*body, logits], "three later levels of chunk 0, two there are"),
        order("opacities-last", [*body, replace(logits, owner=3)],
              "a later level of a chunk of the last"),
        order("opacities-first", [logits, *body], "opacities before their head"),
        order("opacities-beyond", [*body, replace(logits, owner=5)], "opacities of chunk 5 of 5"),
        streams("opacities-none", [], "stream-missing", "7.5", "no stream"),
        streams("opacities-and-colours", mixed, "stream-unexpected", "7.5", "sh0 beside them"),
        streams("opacities-escape", [escape], "stream-missing", "7.5", "escape rows"),
        streams("opacities-digits", [finer], "stream-kind", "6.2", "digits"),
        streams("opacities-rows", [fewer], "stream-rows", "6.2", "6 rows of 7"),
        last("opacities-infinities", sealed, "stream-record", "6.2",
             "differences with infinities"),
        last("opacities-cut", pack_streams([_logits(44)])[:-1], "stream-record", "6.1",
             "the last byte missing"),
        Invalid("differences-in-head", build(with_segments(draft, differing)), "stream-kind",
                "6.2", "differences of opacities in a head", "decode"),
    ]  # fmt: skip
