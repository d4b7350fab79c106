"""Byte counts of a COGS file by chunk, and by kind of stream."""

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
_CHUNK_KINDS: Final = (
    SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL, SegmentKind.OPACITIES,
)  # fmt: skip

# Segment and label of the kinds that are counted whole.
_WHOLE: Final = {
    SegmentKind.CAMERAS: ("cameras", "all columns"),
    SegmentKind.COMPENSATION: ("compensation", "shifts and codes"),
    SegmentKind.VIEW_TABLE: ("view table", "viewpoints and shares"),
    SegmentKind.DESCRIPTION: ("description", "texts and views"),
    SegmentKind.PICTURE: ("picture", "poster and sky"),
}


@dataclass(frozen=True)
class StoredSize:
    """Bytes of all streams with one label, in all segments of one kind.

    Parameters
    ----------
    segment : str
        Kind of the segments; ``index`` for bytes outside streams.
    label : str
        Label such as ``scales scalar escape`` (`StoredStream.label`), or name of an extra
        attribute.
    stored_bytes : int
        Compressed size, bytes.
    """

    segment: str
    label: str
    stored_bytes: int

    def report(self) -> dict[str, object]:
        """Return the fields by their names in JSON output."""
        return {"segment": self.segment, "stream": self.label, "bytes": self.stored_bytes}


@dataclass(frozen=True)
class ChunkSizes:
    """Sizes, offsets and contribution of one chunk.

    Parameters
    ----------
    number : int
        Number of the chunk.
    splats : int
        Number of its splats.
    head_bytes, head_offset : int
        Size of the head and its offset in the file, bytes.
    refinement_bytes, refinement_offset, tail_bytes, tail_offset : int
        Sizes and offsets of the refinement and the tail, bytes; 0 if the chunk has none.
    contribution : float
        Sum of its splats' contributions.
    share_of_contribution : float or None
        Fraction of the scene's contribution; None if the scene was not scored.
    share_so_far : float or None
        Fraction of the scene's contribution in all chunks up to this one.
    object_label : int
        Label of the chunk's object; 0 in scenes without objects.
    until : int
        Length, in chunks, of the shortest prefix that no longer draws the chunk; 0 if all draw it.
    cell : int
        Number of the chunk's cell (SPEC 5.4); 0 in scenes without cells.
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
        """Return the fields by their names in JSON output."""
        fields = asdict(self)
        return {"object" if name == "object_label" else name: x for name, x in fields.items()}


def format_version(file: CogsFile) -> str:
    """Return the format version of a COGS file, e.g. ``0.1``."""
    preamble = unpack_preamble(file.read_bytes(0, PREAMBLE_BYTES), file.name)
    return f"{preamble.major}.{preamble.minor}"


def chunk_sizes(file: CogsFile) -> list[ChunkSizes]:
    """Return the sizes of every chunk, in file order."""
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
    """Return the bytes of every kind of stream; the sum is the size of the file.

    Parameters
    ----------
    file : CogsFile
        Open file, possibly a prefix. Missing segments are one row per kind; bytes behind the last
        known segment are another row.
    by_stream : bool
        Whether to read the segments and count their streams. If false, there is one row per kind
        of segment, from the index alone.

    Raises
    ------
    CogsplatError
        A segment cannot be read or violates SPEC 5.7 or 6.
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
        if number == SegmentKind.ATTRIBUTES:
            payload = file.read_segment(row)
            where = f"{file.name}: segment {row}"
            for label, size in attribute_bytes(payload, file.root.attributes, where).items():
                found["attributes", label] += size
            continue
        if number in _WHOLE:
            found[_WHOLE[SegmentKind(number)]] += int(file.segments.length[row])
            continue
        if number >= SKIPPABLE_KIND:
            found[f"kind {number}", "unknown"] += int(file.segments.length[row])
            continue
        kind = SegmentKind(number)
        name = _segment_name(number)
        payload = file.read_segment(row)
        rest = len(payload)
        where = f"{file.name}: segment {row}"
        for stream in records.unpack(payload, where, _stream_rows(file, kind, owner)):
            found[name, stream.label] += stream.stored_bytes
            rest -= stream.stored_bytes
        found[_INDEX, "framing of segments"] += rest
    return [StoredSize(*key, size) for key, size in found.items()]


def _unlisted_bytes(file: CogsFile) -> int:
    """Return the bytes behind the last known segment; 0 unless pages of the index are missing."""
    if file.source_bytes == file.file_length or not len(file.segments):
        return 0
    last = int((file.offsets + file.segments.length.astype(np.int64)).max())
    return file.file_length - last


def _segment_name(number: int) -> str:
    """Return the display name of the segment kind with a number."""
    if number >= SKIPPABLE_KIND:
        return f"kind {number}"
    return SegmentKind(number).name.lower().replace("_", " ")


def _stream_rows(file: CogsFile, kind: SegmentKind, owner: int) -> int:
    """Return the number of rows in a segment's streams.

    These are the splats of chunk number `owner`, or the entries of codebook number `owner`.
    """
    if kind in _CHUNK_KINDS:
        return int(file.chunks.splats[owner])
    return file.root.codebooks[owner].rows


def _by_owner(file: CogsFile, kind: SegmentKind) -> dict[int, tuple[int, int]]:
    """Return the offset and length of each segment of a kind, by number of its chunk."""
    rows = np.flatnonzero(file.segments.kind == kind)
    return {
        int(file.segments.owner[row]): (int(file.offsets[row]), int(file.segments.length[row]))
        for row in rows
    }
