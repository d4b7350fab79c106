"""Builder of conformance files, valid or broken on purpose.

`formats.cogs.writer` writes valid files only. Here every table, length and byte can be changed.
The CRCs are then recomputed, so that exactly one rule is broken.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Final

import zstandard

from cogsplat.codec.streams.records import COMPONENTS, Stream
from cogsplat.formats.cogs.canonical_msgpack import Value, pack, unpack
from cogsplat.formats.cogs.layout import MAGIC, MAJOR, MINOR, SegmentKind
from cogsplat.formats.cogs.segment_rows import CHUNK_KINDS
from cogsplat.formats.cogs.writer import Segment

Index = dict[str, Value]
Edit = Callable[[int, Index], None]

PREAMBLE_BYTES: Final = 64


@dataclass(frozen=True)
class ChunkRow:
    """One row of a chunk table (SPEC 5.4)."""

    splats: int
    box: tuple[float, ...] = (-8.0, -8.0, -8.0, 8.0, 8.0, 8.0)
    contribution: float = 1.0
    layer: int = 0
    cell: int = 0
    object: int = 0
    quality: float = 0.0
    until: int = 0


@dataclass(frozen=True)
class Group:
    """Segments and chunks that one index lists; an index is the root or a page.

    Parameters
    ----------
    segments : sequence of Segment
        Segments in file order.
    chunks : sequence of ChunkRow
        Rows of the chunk table.
    pages : sequence of Group
        Pages that the index lists.
    cell : int
        Cell in the row of the page, 0 for the root.
    """

    segments: Sequence[Segment]
    chunks: Sequence[ChunkRow]
    pages: Sequence[Group] = ()
    cell: int = 0


@dataclass(frozen=True)
class Draft:
    """Content of a conformance file before `build` packs it.

    Parameters
    ----------
    root : dict
        Keys of the root, without tables and pages.
    groups : sequence of Group
        The root's group, then one per page of the root.
    """

    root: Index
    groups: Sequence[Group]


def in_pages(draft: Draft, counts: Sequence[int]) -> Draft:
    """Return a draft whose chunks are listed in the root and in pages, each with its segments.

    Parameters
    ----------
    draft : Draft
        Draft of a root without pages.
    counts : sequence of int
        Number of chunks of the root and of each page.
    """
    (whole,) = draft.groups
    groups, first = [], 0
    for number, count_ in enumerate(counts):
        own = range(first, first + count_)
        segments = [
            part
            for part in whole.segments
            if (part.owner in own if part.kind in CHUNK_KINDS else not number)
        ]
        groups.append(Group(segments, whole.chunks[first : own.stop]))
        first = own.stop
    return replace(draft, groups=groups)


def root_keys(splats: int, sh_degree: int, **changes: Value) -> Index:
    """Return the required keys of a root without tables; `changes` replace or add keys."""
    root: Index = {
        "writer": "vectors",
        "splats": splats,
        "sh_degree": sh_degree,
        "origin": [0.0, 0.0, 0.0],
        "axes": "RDF",
        "colour_space": "srgb",
        "kernel_px": 0.3,
        "antialiased": False,
        "box": [-8.0, -8.0, -8.0, 8.0, 8.0, 8.0],
        "codebooks": [],
    }
    return root | changes


def _u32(values: Sequence[int]) -> bytes:
    """Pack values as little-endian 32-bit integers."""
    return struct.pack(f"<{len(values)}I", *values)


def _tables(group: Group) -> Index:
    """Return the tables ``segments`` and ``chunks`` of an index, as maps of packed columns."""
    parts, rows = group.segments, group.chunks
    boxes = [x for row in rows for x in row.box]
    chunks: Index = {
        "splats": _u32([row.splats for row in rows]),
        "box": struct.pack(f"<{len(boxes)}f", *boxes),
        "contribution": struct.pack(f"<{len(rows)}d", *(row.contribution for row in rows)),
    }
    for name in ("layer", "cell", "object", "until"):
        column = [getattr(row, name) for row in rows]
        if any(column):
            chunks[name] = _u32(column)
    if any(row.quality for row in rows):
        chunks["quality"] = struct.pack(f"<{len(rows)}f", *(row.quality for row in rows))
    return {
        "segments": {
            "kind": bytes(part.kind for part in parts),
            "owner": _u32([part.owner for part in parts]),
            "length": _u32([len(part.payload) for part in parts]),
            "crc": _u32([zlib.crc32(part.payload) for part in parts]),
            "hash": b"".join(hashlib.sha256(part.payload).digest()[:16] for part in parts),
            "needs": _u32([sum(1 << need for need in part.needs) for part in parts]),
        },
        "chunks": chunks,
    }


def table(index: Index, name: str) -> dict[str, Value]:
    """Return a table of an index by name, such as ``chunks``; changes to it change the index."""
    found = index[name]
    if not isinstance(found, dict):
        raise TypeError(f"{name} is {type(found).__name__}, expected a map")
    return found


def column(index: Index, name: str, key: str) -> bytes:
    """Return the bytes of a column of an index's table."""
    found = table(index, name)[key]
    if not isinstance(found, bytes):
        raise TypeError(f"{key} is {type(found).__name__}, expected bin")
    return found


def poke(data: bytes, offset: int, layout: str, value: float) -> bytes:
    """Return `data` with the bytes at `offset` overwritten by a little-endian number."""
    changed = bytearray(data)
    struct.pack_into(f"<{layout}", changed, offset, value)
    return bytes(changed)


def build(draft: Draft, edit: Edit | None = None, *, behind_page: bytes = b"") -> bytes:
    """Pack a draft into the bytes of a file.

    Parameters
    ----------
    draft : Draft
    edit : callable, optional
        Called as ``edit(number, index)`` to change an index before it is packed. Number 0 is the
        root, 1 and up are pages in file order. An index is packed after its pages, so it lists the
        changed pages.
    behind_page : bytes
        Bytes appended to every page.
    """
    first, *others = draft.groups
    numbers = count(1)
    body, pages = _pack_pages([*first.pages, *others], edit, behind_page, numbers)
    root = draft.root | _tables(first)
    if pages:
        root["pages"] = pages
    if edit:
        edit(0, root)
    return with_root(pack(root), b"".join(part.payload for part in first.segments) + body)


@dataclass(frozen=True)
class _Below:
    """Sums over an index and all that is below it."""

    segments: int
    chunks: Sequence[ChunkRow]


def _below(group: Group) -> _Below:
    """Return the sums over a group and the pages below it."""
    found = [_below(page) for page in group.pages]
    return _Below(
        len(group.segments) + sum(each.segments for each in found),
        [*group.chunks, *(row for each in found for row in each.chunks)],
    )


def _pack_pages(
    groups: Sequence[Group], edit: Edit | None, behind_page: bytes, numbers: Iterator[int]
) -> tuple[bytes, Index]:
    """Return the bytes of pages with all that is below them, and their table (SPEC 5.6)."""
    bodies: list[bytes] = []
    lengths, crcs, spans = [], [], []
    for group in groups:
        number = next(numbers)
        below, pages = _pack_pages(group.pages, edit, behind_page, numbers)
        page = _tables(group)
        if pages:
            page["pages"] = pages
        if edit:
            edit(number, page)
        data = pack(page) + behind_page
        span = b"".join(part.payload for part in group.segments) + below
        bodies += [data, span]
        lengths.append(len(data))
        crcs.append(zlib.crc32(data))
        spans.append(len(span))
    if not groups:
        return b"", {}
    sums = [_below(group) for group in groups]
    boxes = [x for each in sums for x in _box_around([row.box for row in each.chunks])]
    table: Index = {
        "length": _u32(lengths),
        "crc": _u32(crcs),
        "segments": _u32([each.segments for each in sums]),
        "chunks": _u32([len(each.chunks) for each in sums]),
        "span": struct.pack(f"<{len(spans)}Q", *spans),
        "splats": _u32([sum(row.splats for row in each.chunks) for each in sums]),
        "box": struct.pack(f"<{len(boxes)}f", *boxes),
        "contribution": struct.pack(
            f"<{len(sums)}d", *(sum(row.contribution for row in each.chunks) for each in sums)
        ),
    }
    if any(group.cell for group in groups):
        table["cell"] = _u32([group.cell for group in groups])
    return b"".join(bodies), table


def claimed_pages(rows: int, segments: int) -> Index:
    """Return a page table of `rows` equal pages of no chunks, with that many segments each."""
    return {
        "length": _u32([1] * rows),
        "crc": bytes(4 * rows),
        "segments": _u32([segments] * rows),
        "chunks": bytes(4 * rows),
        "span": struct.pack(f"<{rows}Q", *[1] * rows),
        "splats": bytes(4 * rows),
        "box": bytes(24 * rows),
        "contribution": bytes(8 * rows),
    }


def _box_around(boxes: Sequence[Sequence[float]]) -> list[float]:
    """Return the bounding box of boxes; zeros for none."""
    if not boxes:
        return [0.0] * 6
    sides = list(zip(*boxes, strict=True))
    return [*map(min, sides[:3]), *map(max, sides[3:])]


def with_root(root: bytes, behind: bytes) -> bytes:
    """Return a file, given its root as msgpack bytes and all bytes that follow the root."""
    file_length = PREAMBLE_BYTES + len(root) + len(behind)
    fields = (MAGIC, MAJOR, MINOR, len(root), file_length, zlib.crc32(root), 0)
    return seal(struct.pack("<8sHHIQII28x", *fields)) + root + behind


def seal(head: bytes) -> bytes:
    """Return the preamble whose first 60 bytes are those of `head`, with its CRC computed."""
    return head[:60] + struct.pack("<I", zlib.crc32(head[:60]))


def preamble_field(data: bytes, offset: int, layout: str, value: int) -> bytes:
    """Return the file with one preamble field changed and the preamble's CRC recomputed."""
    return seal(poke(data[:PREAMBLE_BYTES], offset, layout, value)) + data[PREAMBLE_BYTES:]


def split_root(data: bytes) -> tuple[bytes, bytes]:
    """Return the root of a file as msgpack bytes, without the preamble, and all bytes after it."""
    (length,) = struct.unpack_from("<I", data, 12)
    end = PREAMBLE_BYTES + length
    return data[PREAMBLE_BYTES:end], data[end:]


def replace_payloads(data: bytes, payloads: Mapping[int, bytes]) -> bytes:
    """Replace segments of a file without pages; lengths, CRCs and hashes are recomputed.

    Parameters
    ----------
    data : bytes
    payloads : mapping of int to bytes
        New payloads by row of the segment table.
    """
    root, behind = split_root(data)
    index = unpack(root, "root")
    segments = table(index, "segments")
    lengths = struct.unpack(
        f"<{len(column(index, 'segments', 'kind'))}I", column(index, "segments", "length")
    )
    parts, start = [], 0
    for row, length in enumerate(lengths):
        parts.append(payloads.get(row, behind[start : start + length]))
        start += length
    segments["length"] = _u32([len(part) for part in parts])
    segments["crc"] = _u32([zlib.crc32(part) for part in parts])
    segments["hash"] = b"".join(hashlib.sha256(part).digest()[:16] for part in parts)
    return with_root(pack(index), b"".join(parts))


@dataclass
class Record:
    """A stream record whose fields may break the rules (SPEC 6.2).

    Parameters
    ----------
    fields : list of int
        Attribute, kind, components, flags, rows.
    params : bytes
        Parameters of the stream's kind.
    planes : list of (int, bytes)
        Length word and stored bytes of each plane.
    """

    fields: list[int]
    params: bytes
    planes: list[tuple[int, bytes]] = field(default_factory=list)


def plane(raw: bytes) -> tuple[int, bytes]:
    """Return the word and the stored bytes of a plane, as a zstd frame if that is smaller."""
    frame: bytes = zstandard.ZstdCompressor(level=19).compress(raw)
    return (len(frame) | 1 << 31, frame) if len(frame) < len(raw) else (len(raw), raw)


def record(stream: Stream, **changes: int) -> Record:
    """Return the record of a stream; `changes` override its fields by name, such as ``rows=4``."""
    fields = {
        "attribute": int(stream.attribute),
        "kind": int(stream.kind),
        "components": COMPONENTS[stream.attribute],
        "flags": stream.flags,
        "rows": stream.rows,
    }
    planes = [plane(raw.tobytes()) for raw in stream.planes]
    return Record(list((fields | changes).values()), stream.params, planes)


PAYLOAD_HEAD: Final = 2
"""Bytes before the first record: the number of streams (SPEC 6.1)."""


def pack_symbols(raw: bytes, radix: int) -> bytes:
    """Return a plane with several symbols per byte, without the radix byte (SPEC 6.9)."""
    count = next(d for d in range(8, 1, -1) if radix**d <= 256)
    groups = [raw[start : start + count] for start in range(0, len(raw), count)]
    return bytes(sum(s * radix**i for i, s in enumerate(group)) for group in groups)


def payload(records: Sequence[Record], *, count: int | None = None) -> bytes:
    """Return a segment's payload; `count` overrides the stated number of streams."""
    heads = [struct.pack("<H", len(records) if count is None else count)]
    bodies = []
    for entry in records:
        words = [word for word, _ in entry.planes]
        heads.append(struct.pack("<BBBBIHH", *entry.fields, len(words), len(entry.params)))
        heads.append(entry.params + _u32(words))
        bodies += [stored for _, stored in entry.planes]
    return b"".join(heads + bodies)


def pack_streams(streams: Sequence[Stream]) -> bytes:
    """Return the payload of streams whose planes are uncompressed or zstd frames, not packed."""
    return payload([record(stream) for stream in streams])


def one_chunk(
    head: bytes,
    splats: int,
    *,
    tail: bytes | None = None,
    sh_degree: int = 0,
    books: Mapping[str, tuple[int, Sequence[bytes]]] | None = None,
    needs: tuple[int, ...] = (),
    reach: float = 8.0,
) -> Draft:
    """Return the draft of a file of one chunk.

    Parameters
    ----------
    head, tail : bytes
        Payloads of the chunk's head and tail.
    splats : int
        Splats in the chunk.
    sh_degree : int
    books : mapping of str to (int, sequence of bytes), optional
        Row count and segment payloads of each codebook, by attribute.
    needs : tuple of int
        Numbers of the codebooks that head and tail need.
    reach : float
        Half the side of the scene's and the chunk's box, centred at the origin.
    """
    books = books or {}
    segments: list[Segment] = []
    entries: list[Value] = []
    for number, (attribute, (rows, payloads)) in enumerate(books.items()):
        entries.append({"attribute": attribute, "rows": rows})
        first = SegmentKind.SHAPE_CODEBOOK if attribute == "shape" else SegmentKind.COLOUR_BAND1
        segments += [Segment(first + i, number, data) for i, data in enumerate(payloads)]
    segments.append(Segment(SegmentKind.HEAD, 0, head, needs))
    if tail is not None:
        segments.append(Segment(SegmentKind.TAIL, 0, tail, needs))
    box = (-reach, -reach, -reach, reach, reach, reach)
    root = root_keys(splats, sh_degree, codebooks=entries, box=list(box))
    return Draft(root, [Group(segments, [ChunkRow(splats, box)])])
