"""Must-reject vectors of two faults in payloads; the first sets the code (SPEC 7.6, 8.10)."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

from cogsplat.codec.streams.records import Attribute, Kind, Stream
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    Record,
    build,
    one_chunk,
    pack_streams,
    payload,
    record,
    root_keys,
)
from .invalid import Invalid, chunk_with_codebooks, with_segments

_ROWS = 3


def invalid() -> list[Invalid]:
    """Return the vectors of two faults in payloads, ordered by the first fault as in SPEC 7.6."""
    head = handmade.random_head(_ROWS, 1)
    at = {stream.attribute: handmade.stream_index(head, stream.attribute) for stream in head}
    sh0 = head[at[Attribute.SH0]]
    quats = head[at[Attribute.QUATS]]
    past = handmade.scalar(Attribute.SCALES, [(0.0, 1.0, 4)] * 3, [[0, 1, 4], [0] * 3, [0] * 3])
    grids = struct.pack("<ffIffIffI", -1, 1, 0, math.nan, 1, 4, -1, 1, 4)
    wide = struct.pack("<B3xffIffIffI", 9, -1, 2, 4, -1, 1, 4, -1, 1, 4)
    shape = handmade.vq(Attribute.SHAPE, [0, 4, 2], 7, 5, 0)

    def bad(name: str, data: bytes, code: str, clause: str, note: str) -> Invalid:
        return Invalid(f"order-{name}", data, code, clause, note, "decode")

    def of(*entries: Record) -> bytes:
        return build(one_chunk(payload(entries), _ROWS))

    def with_head(*changed: Stream) -> bytes:
        return build(one_chunk(pack_streams(handmade.random_head(_ROWS, 1, *changed)), _ROWS))

    records = [record(stream) for stream in head]
    unknown = replace(records[0], fields=[records[0].fields[0], 99, *records[0].fields[2:]])
    longer = replace(records[-1], planes=[(1000, b"")])
    more = record(replace(sh0, kind=Kind.SORTED), rows=_ROWS - 1)
    odd = record(replace(sh0, kind=Kind.SORTED), components=2)
    coarse = handmade.random_head(_ROWS, 1, past)
    extra = handmade.random_scalar(Attribute.SCALE_FACTOR, _ROWS, 3)
    left = replace(quats, params=wide)
    return [
        bad("record-planes", of(unknown, *records[1:-1], longer), "stream-kind-unknown", "6.2",
            "an unknown kind in the first record, and a plane of the last that leaves the payload"),
        bad("fields-kind", of(*records[:-1], odd), "stream-record", "6.2",
            "two components of sh0, and a kind that sh0 does not have"),
        bad("duplicate-kind", of(*records, _of_another_kind(records[-1])),
            "stream-duplicate", "6.2",
            "sh0 twice, the second time of a kind that it does not have"),
        bad("rows-kind", of(*records[:-1], more), "stream-rows", "6.2",
            "two rows of sh0 for three, and a kind that sh0 does not have"),
        bad("ranges-levels", with_head(replace(sh0, params=grids)), "grid-value", "6.4",
            "no level in the first component, and a minimum of NaN in the second"),
        bad("largest-range", with_head(left), "quat-largest", "6.6",
            "component 9 left out, and components up to 2"),
        bad("code-missing", build(one_chunk(pack_streams(
            [s for s in coarse if s.attribute != Attribute.SH0]), _ROWS)), "code-range", "6.4",
            "a code of scales that their grid does not have, and no sh0"),
        bad("code-unexpected", build(one_chunk(pack_streams([extra, *coarse]), _ROWS)),
            "code-range", "6.4",
            "a code of scales that their grid does not have, and a stream that no head has"),
        bad("missing-unexpected", build(one_chunk(pack_streams(
            [extra, *(s for s in head if s.attribute != Attribute.SH0)]), _ROWS)),
            "stream-missing", "7.2", "no sh0, and a stream that no head has"),
        bad("codebook-factor", _with_head(pack_streams(
            [s for s in handmade.vq_head(_ROWS, 1, shape, still=True)
             if s.attribute != Attribute.SCALE_FACTOR])), "codebook-missing", "6.7",
            "a codebook that is not there, and no scale factor"),
        bad("books-heads", _broken_book(), "code-range", "6.4",
            "a code of the second chunk's codebook that its grid does not have, and no streams in "
            "the first chunk's head"),
    ]  # fmt: skip


def _of_another_kind(entry: Record) -> Record:
    """Return the record with the kind `SORTED`, which its attribute cannot have."""
    return replace(entry, fields=[entry.fields[0], int(Kind.SORTED), *entry.fields[2:]])


def _with_head(head: bytes) -> bytes:
    """Return the file of `chunk_with_codebooks` with another head."""
    draft = chunk_with_codebooks()
    segments = [
        replace(part, payload=head) if part.kind == SegmentKind.HEAD else part
        for part in draft.groups[0].segments
    ]
    return build(with_segments(draft, segments))


def _broken_book() -> bytes:
    """Return a file of two chunks: the first has an empty head, the second a broken codebook."""
    ranges = [(-1.0, 1.0, 4)] * 3
    scales = handmade.scalar(Attribute.SCALES, ranges, [[0, 1], [0, 5], [2, 3]])
    book = pack_streams([scales, handmade.random_quats(2, 4)])
    shape = handmade.vq(Attribute.SHAPE, [0, 1, 1], 0, 2, 0)
    segments = [
        Segment(SegmentKind.SHAPE_CODEBOOK, 0, book),
        Segment(SegmentKind.HEAD, 0, struct.pack("<H", 0)),
        Segment(
            SegmentKind.HEAD, 1, pack_streams(handmade.vq_head(_ROWS, 1, shape, still=True)), (0,)
        ),
    ]
    keys = root_keys(2 * _ROWS, 0, codebooks=[{"attribute": "shape", "rows": 2}])
    return build(Draft(keys, [Group(segments, [ChunkRow(_ROWS)] * 2)]))


def invalid_unused() -> list[Invalid]:
    """Return the vector of a broken codebook that no chunk needs, which only verifiers refuse."""
    draft = one_chunk(
        pack_streams(handmade.uniform_head(_ROWS)),
        _ROWS,
        books={"shape": (2, [struct.pack("<H", 0)])},
    )
    data = build(draft)
    note = "a codebook without streams that no chunk needs"
    return [Invalid("codebook-unused", data, "stream-missing", "7.1", note, "verify")]
