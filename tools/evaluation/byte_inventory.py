"""Byte counts of a COGS file: by chunk, and by kind of stream."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from cogsplat.codec.segments.attributes import attribute_bytes
from cogsplat.codec.streams import records
from cogsplat.formats.cogs.layout import (
    PREAMBLE_BYTES,
    SKIPPABLE_KIND,
    SegmentKind,
    unpack_preamble,
)
from cogsplat.formats.cogs.reader import CogsFile

_INDEX: Final = "index"
_OF_CHUNKS: Final = (
    SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL, SegmentKind.OPACITIES,
)  # fmt: skip


@dataclass(frozen=True)
class StoredSize:
    """Bytes of one kind of stream, or one attribute, in one kind of segment, over the whole file.

    Parameters
    ----------
    segment : str
        The segment's kind, or ``index`` for all that is no stream.
    label : str
        Attribute, kind and flag (`StoredStream.label`); the name of an extra attribute.
    stored_bytes : int
    """

    segment: str
    label: str
    stored_bytes: int

    def report(self) -> dict[str, object]:
        """Return the fields as JSON output has them."""
        return {"segment": self.segment, "stream": self.label, "bytes": self.stored_bytes}


@dataclass(frozen=True)
class ChunkSizes:
    """Sizes, offsets and contribution of one chunk.

    Parameters
    ----------
    number, splats : int
    head_bytes, head_offset : int
    refinement_bytes, refinement_offset, tail_bytes, tail_offset : int
        0 where it has none.
    contribution : float
        Sum over its splats.
    share_of_contribution, share_so_far : float or None
        Of the scene's, alone and with all chunks before; None where nothing was scored.
    object_label : int
        Label of what it holds; 0 in scenes without objects.
    until : int
        Chunks from which on a prefix does not draw it; 0 where all do.
    cell : int
        Number of its cell of space (SPEC 5.4); 0 in scenes that are not cut into cells.
    """

    number: int
    splats: int
    head_bytes: int
    head_offset: int
    refinement_bytes: int
    refinement_offset: int
    tail_bytes: int
    tail_offset: int
    contribution: float
    share_of_contribution: float | None
    share_so_far: float | None
    object_label: int
    until: int
    cell: int

    def report(self) -> dict[str, object]:
        """Return the fields as JSON output has them."""
        fields = asdict(self)
        return {"object" if name == "object_label" else name: x for name, x in fields.items()}


def format_version(file: CogsFile) -> str:
    """Return the version of the format that a COGS file states, such as ``0.1``."""
    preamble = unpack_preamble(file.read_bytes(0, PREAMBLE_BYTES), file.name)
    return f"{preamble.major}.{preamble.minor}"


def chunk_sizes(file: CogsFile) -> list[ChunkSizes]:
    """Return a row for each chunk, in order."""
    contribution = file.chunks.contribution
    total = float(contribution.sum())
    so_far = np.cumsum(contribution)
    heads = _by_owner(file, SegmentKind.HEAD)
    refinements = _by_owner(file, SegmentKind.REFINEMENT)
    tails = _by_owner(file, SegmentKind.TAIL)
    rows = []
    for number in range(file.num_chunks):
        head_offset, head_bytes = heads.get(number, (0, 0))
        refinement_offset, refinement_bytes = refinements.get(number, (0, 0))
        tail_offset, tail_bytes = tails.get(number, (0, 0))
        rows.append(
            ChunkSizes(
                number=number,
                splats=int(file.chunks.splats[number]),
                head_bytes=head_bytes,
                head_offset=head_offset,
                refinement_bytes=refinement_bytes,
                refinement_offset=refinement_offset,
                tail_bytes=tail_bytes,
                tail_offset=tail_offset,
                contribution=float(contribution[number]),
                share_of_contribution=float(contribution[number]) / total if total > 0 else None,
                share_so_far=float(so_far[number]) / total if total > 0 else None,
                object_label=int(file.chunks.object[number]),
                until=int(file.chunks.until[number]),
                cell=int(file.chunks.cell[number]),
            )
        )
    return rows


def stored_sizes(file: CogsFile, *, by_stream: bool = True) -> list[StoredSize]:
    """Return the bytes of every kind of stream; their sum is the size of the file.

    Parameters
    ----------
    file : CogsFile
    by_stream : bool
        Whether segments are read, which say what their streams take; otherwise each kind of
        segment is one row, of which the index says enough.

    Of a file that has not arrived whole, segments that are not there count as one row each kind,
    and everything behind the last segment listed as one more.

    Raises
    ------
    CogsplatError
        A segment cannot be read or breaks SPEC 5.7 or 6.
    """
    found: dict[tuple[str, str], int] = defaultdict(int)
    segment_bytes = int(file.segments.length.sum(dtype=np.uint64))
    unlisted = _unlisted_bytes(file)
    found[_INDEX, "preamble, root, pages"] = file.file_length - segment_bytes - unlisted
    if unlisted:
        found[_INDEX, "not there, not listed"] = unlisted
    found[_INDEX, "framing of segments"] = 0
    for row in range(len(file.segments)):
        number, owner = int(file.segments.kind[row]), int(file.segments.owner[row])
        if not file.is_present(row):
            found[_segment_name(number), "not there"] += int(file.segments.length[row])
            continue
        if not by_stream:
            found[_segment_name(number), "not read"] += int(file.segments.length[row])
            continue
        if number == SegmentKind.CAMERAS:
            found["cameras", "all columns"] += int(file.segments.length[row])
            continue
        if number == SegmentKind.ATTRIBUTES:
            payload = file.read_segment(row)
            where = f"{file.name}: segment {row}"
            for label, size in attribute_bytes(payload, file.root.attributes, where).items():
                found["attributes", label] += size
            continue
        if number == SegmentKind.COMPENSATION:
            found["compensation", "shifts and codes"] += int(file.segments.length[row])
            continue
        if number == SegmentKind.VIEW_TABLE:
            found["view table", "viewpoints and shares"] += int(file.segments.length[row])
            continue
        if number >= SKIPPABLE_KIND:
            found[f"kind {number}", "unknown"] += int(file.segments.length[row])
            continue
        kind = SegmentKind(number)
        name = _segment_name(number)
        payload = file.read_segment(row)
        rest = len(payload)
        where = f"{file.name}: segment {row}"
        for stream in records.unpack(payload, where, _rows(file, kind, owner)):
            found[name, stream.label] += stream.stored_bytes
            rest -= stream.stored_bytes
        found[_INDEX, "framing of segments"] += rest
    return [StoredSize(*key, size) for key, size in found.items()]


def _unlisted_bytes(file: CogsFile) -> int:
    """Return the bytes behind the last segment listed, where pages of the index are missing."""
    if file.source_bytes == file.file_length or not len(file.segments):
        return 0
    last = int((file.offsets + file.segments.length.astype(np.int64)).max())
    return file.file_length - last


def _segment_name(number: int) -> str:
    if number >= SKIPPABLE_KIND:
        return f"kind {number}"
    return SegmentKind(number).name.lower().replace("_", " ")


def _rows(file: CogsFile, kind: SegmentKind, owner: int) -> int:
    if kind in _OF_CHUNKS:
        return int(file.chunks.splats[owner])
    return file.root.codebooks[owner].rows


def _by_owner(file: CogsFile, kind: SegmentKind) -> dict[int, tuple[int, int]]:
    """Return offset and length of the segments of a kind, by the chunk they belong to."""
    rows = np.flatnonzero(file.segments.kind == kind)
    return {
        int(file.segments.owner[row]): (int(file.offsets[row]), int(file.segments.length[row]))
        for row in rows
    }
