"""Must-reject conformance vectors, and the small valid files that they are made from."""

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
    """A must-reject file, which breaks one rule and has valid CRCs.

    Parameters
    ----------
    name : str
    data : bytes
    code : str
        Reason code of the refusal.
    clause : str
        SPEC clause that the file breaks.
    note : str
        Description of the fault.
    stage : str
        Operation that must refuse the file: ``open``, ``decode`` or ``verify``.
    partial : bool
        Whether a reader of truncated files accepts the file.
    """

    name: str
    data: bytes
    code: str
    clause: str
    note: str
    stage: str = "open"
    partial: bool = False


def no_splats() -> Draft:
    """Return the draft of a file without splats: only preamble and root, SH degree 0."""
    return Draft(root_keys(0, 0), [Group([], [])])


def uniform_chunk() -> Draft:
    """Return the draft of a file of one chunk of three equal splats, SH degree 0."""
    return one_chunk(pack_streams(handmade.uniform_head(3)), 3)


def chunk_with_tail(degree: int = 2) -> Draft:
    """Return the draft of a file of one chunk of three splats with a tail."""
    head = pack_streams(handmade.uniform_head(3))
    return one_chunk(head, 3, tail=pack_streams(handmade.bands(degree, 3, 5)), sh_degree=degree)


def chunk_with_codebooks() -> Draft:
    """Return the draft of a file of one chunk with shape and colour codebooks, SH degree 2."""
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
    """Return the draft of a file of two chunks with tails, SH degree 1."""
    segments = []
    for number in range(2):
        head = pack_streams(handmade.uniform_head(2))
        tail = pack_streams(handmade.bands(1, 2, 5 + number))
        segments.append(Segment(SegmentKind.HEAD, number, head))
        segments.append(Segment(SegmentKind.TAIL, number, tail))
    return Draft(root_keys(4, 1), [Group(segments, [ChunkRow(2)] * 2)])


def paged_chunks() -> Draft:
    """Return the draft of `two_chunks` with the second chunk listed in a page."""
    whole = two_chunks()
    segments = whole.groups[0].segments
    parts = [Group(segments[:2], [ChunkRow(2)]), Group(segments[2:], [ChunkRow(2)])]
    return replace(whole, groups=parts)


def build_edited(draft: Draft, change: Callable[[Index], object], number: int = 0) -> bytes:
    """Pack the draft after `change` of one index; `number` 0 is the root, 1 and up are pages."""

    def edit(index_number: int, index: Index) -> None:
        if index_number == number:
            change(index)

    return build(draft, edit)


def key_setter(key: str, value: Value, *, within: str = "") -> Callable[[Index], object]:
    """Return a function that sets a key of an index, or of its table named `within`."""

    def change(index: Index) -> None:
        (table(index, within) if within else index)[key] = value

    return change


def with_segments(draft: Draft, segments: Sequence[Segment]) -> Draft:
    """Return the draft with the root's segments replaced."""
    group = Group(segments, draft.groups[0].chunks)
    return replace(draft, groups=[group, *draft.groups[1:]])
