"""What a must-reject conformance vector is, and the valid files they are made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from cogsplat.codec.streams.records import Attribute
from cogsplat.formats.cogs.canonical_msgpack import Value
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import handmade_streams as handmade
from .file_builder import (
    ChunkRow,
    Draft,
    Group,
    Index,
    build,
    one_chunk,
    pack_streams,
    root_keys,
    table,
)


@dataclass(frozen=True)
class Invalid:
    """A file to refuse: one rule broken, all CRCs made to fit.

    Parameters
    ----------
    name : str
    data : bytes
    code : str
        Reason code.
    clause : str
        SPEC clause that the file breaks.
    note : str
        What is wrong.
    stage : str
        ``open``, ``decode`` or ``verify``: what refuses it.
    partial : bool
        Whether a reader that takes the first bytes of a file opens it.
    """

    name: str
    data: bytes
    code: str
    clause: str
    note: str
    stage: str = "open"
    partial: bool = False


def no_splats() -> Draft:
    """Return a file of no splats at SH degree 0: a root and nothing behind it."""
    return Draft(root_keys(0, 0), [Group([], [])])


def uniform_chunk() -> Draft:
    """Return a file of one chunk of three splats, all alike, at SH degree 0."""
    return one_chunk(pack_streams(handmade.uniform_head(3)), 3)


def plain() -> Draft:
    """Return a file of one chunk of three splats at SH degree 0."""
    return one_chunk(pack_streams(handmade.random_head(3, 1)), 3)


def chunk_with_tail(degree: int = 2) -> Draft:
    """Return a file of one chunk of three splats with a tail."""
    head = pack_streams(handmade.uniform_head(3))
    return one_chunk(head, 3, tail=pack_streams(handmade.bands(degree, 3, 5)), sh_degree=degree)


def chunk_with_codebooks() -> Draft:
    """Return a file of one chunk whose shapes and colours come from codebooks, SH degree 2."""
    shape = handmade.vq(Attribute.SHAPE, [0, 4, 2], 0, 5, 0)
    colour = handmade.vq(Attribute.SHN, [1, 0, 3], 1, 4, 0)
    rows = {
        "shape": (5, [pack_streams(handmade.shape_codebook(5, 1))]),
        "colour": (4, [pack_streams([handmade.band(i, 4, 2)]) for i in (1, 2)]),
    }
    head = pack_streams(handmade.vq_head(3, 1, shape, still=True))
    tail = pack_streams([colour])
    return one_chunk(head, 3, tail=tail, sh_degree=2, books=rows, needs=(0, 1))


def two_chunks() -> Draft:
    """Return a file of two chunks with tails, SH degree 1."""
    segments = []
    for number in range(2):
        head = pack_streams(handmade.uniform_head(2))
        tail = pack_streams(handmade.bands(1, 2, 5 + number))
        segments.append(Segment(SegmentKind.HEAD, number, head))
        segments.append(Segment(SegmentKind.TAIL, number, tail))
    return Draft(root_keys(4, 1), [Group(segments, [ChunkRow(2)] * 2)])


def paged_chunks() -> Draft:
    """Return a file whose second chunk is listed in an index page."""
    whole = two_chunks()
    segments = whole.groups[0].segments
    parts = [Group(segments[:2], [ChunkRow(2)]), Group(segments[2:], [ChunkRow(2)])]
    return replace(whole, groups=parts)


def build_edited(draft: Draft, change: Callable[[Index], object], number: int = 0) -> bytes:
    """Return the file with one index changed: 0 is the root, 1 and up pages."""

    def edit(index_number: int, index: Index) -> None:
        if index_number == number:
            change(index)

    return build(draft, edit)


def key_setter(key: str, value: Value, *, within: str = "") -> Callable[[Index], object]:
    """Return a change that sets a key of the index, or of a table within it."""

    def change(index: Index) -> None:
        (table(index, within) if within else index)[key] = value

    return change


def with_segments(draft: Draft, segments: Sequence[Segment]) -> Draft:
    """Return the file with other segments in the root."""
    group = Group(segments, draft.groups[0].chunks)
    return replace(draft, groups=[group, *draft.groups[1:]])
