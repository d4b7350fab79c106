"""Where the bytes of a COGS file go: by chunk, and by stream."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

import cogsplat
from cogsplat.codec import streams
from cogsplat.codec.planes import RANS_FLAG, metered
from cogsplat.codec.streams import StoredStream
from cogsplat.formats.cogs_layout import (
    PREAMBLE_BYTES,
    SKIPPABLE_KIND,
    SegmentKind,
    unpack_preamble,
)
from cogsplat.formats.cogs_reader import CogsFile
from cogsplat.formats.source import FileSource

_INDEX: Final = "index"


@dataclass(frozen=True)
class StoredSize:
    """Bytes of one kind of stream in one kind of segment, over the whole file.

    Parameters
    ----------
    segment : str
        The segment's kind, or ``index`` for all that is no stream.
    label : str
        Attribute, kind and flag (`StoredStream.label`).
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
    """One chunk's row of the table.

    Parameters
    ----------
    number, splats : int
    head_bytes, head_offset : int
    tail_bytes, tail_offset : int
        0 where it has none.
    contribution : float
        Sum over its splats.
    contribution_share, share_so_far : float or None
        Of the scene's, alone and with all chunks before; None where nothing was scored.
    """

    number: int
    splats: int
    head_bytes: int
    head_offset: int
    tail_bytes: int
    tail_offset: int
    contribution: float
    contribution_share: float | None
    share_so_far: float | None

    def report(self) -> dict[str, object]:
        """Return the fields as JSON output has them."""
        return asdict(self)


def format_version(path: Path) -> str:
    """Return the version of the format that a COGS file states, such as ``0.1``."""
    source = FileSource(path)
    try:
        preamble = unpack_preamble(source.read(0, PREAMBLE_BYTES), source.name)
    finally:
        source.close()
    return f"{preamble.major}.{preamble.minor}"


def chunk_sizes(file: CogsFile) -> list[ChunkSizes]:
    """Return a row for each chunk, in order."""
    contribution = file.chunks.contribution
    total = float(contribution.sum())
    so_far = np.cumsum(contribution)
    heads = _by_owner(file, SegmentKind.HEAD)
    tails = _by_owner(file, SegmentKind.TAIL)
    rows = []
    for number in range(file.num_chunks):
        head_offset, head_bytes = heads.get(number, (0, 0))
        tail_offset, tail_bytes = tails.get(number, (0, 0))
        rows.append(
            ChunkSizes(
                number=number,
                splats=int(file.chunks.splats[number]),
                head_bytes=head_bytes,
                head_offset=head_offset,
                tail_bytes=tail_bytes,
                tail_offset=tail_offset,
                contribution=float(contribution[number]),
                contribution_share=float(contribution[number]) / total if total > 0 else None,
                share_so_far=float(so_far[number]) / total if total > 0 else None,
            )
        )
    return rows


def stored_sizes(path: Path) -> list[StoredSize]:
    """Return the bytes of every kind of stream; they add up to the file.

    Planes that share a body of the range coder are given their part of it by what their symbols
    take under their tables.

    Raises
    ------
    CogsplatError
        A segment cannot be read, or decoding it fails.
    """
    found: dict[tuple[str, str], int] = defaultdict(int)
    with cogsplat.open(path) as file:
        plane_bits = _plane_bits(file)
        segment_bytes = int(file.segments.length.sum(dtype=np.uint64))
        found[_INDEX, "preamble, root, pages"] = file.file_length - segment_bytes
        found[_INDEX, "framing of segments"] = 0
        for row in range(len(file.segments)):
            number, owner = int(file.segments.kind[row]), int(file.segments.owner[row])
            if number >= SKIPPABLE_KIND:
                found[f"kind {number}", "unknown"] += int(file.segments.length[row])
                continue
            kind = SegmentKind(number)
            name = kind.name.lower().replace("_", " ")
            payload = file.read_segment(row)
            rest = len(payload)
            stored = streams.unpack(
                payload, f"{file.name}: segment {row}", _rows(file, kind, owner)
            )
            for stream, shared in zip(stored, _shared_bytes(stored, plane_bits), strict=True):
                found[name, stream.label] += stream.stored_bytes + shared
                rest -= stream.stored_bytes + shared
            found[_INDEX, "framing of segments"] += rest
    return [StoredSize(*key, size) for key, size in found.items()]


def _plane_bits(file: CogsFile) -> dict[bytes, list[float]]:
    """Decode all chunks and return the bits of the planes of each shared body, by its hash."""
    bits: dict[bytes, list[float]] = defaultdict(list)
    with metered(lambda body, spent: bits[_digest(body)].append(spent)):
        for chunk in range(file.num_chunks):
            # One chunk at a time on this thread: the meter counts where it was set.
            file.decode([chunk], threads=1)
    return bits


def _shared_bytes(
    stored: Sequence[StoredStream], plane_bits: Mapping[bytes, Sequence[float]]
) -> list[int]:
    """Return what each stream takes of the body that a segment's streams share."""
    body = stored[0].reader.body if stored else memoryview(b"")
    spent = plane_bits.get(_digest(body), ())
    planes = [int(np.count_nonzero(stream.words & RANS_FLAG)) for stream in stored]
    # A codebook that no chunk uses is never decoded: what it shares stays with the framing.
    if len(spent) < sum(planes) or not sum(spent) > 0:
        return [0] * len(stored)
    # Rounded as running sums, so that the parts add up to the body.
    running = np.concatenate([[0.0], np.cumsum(spent[: sum(planes)])])
    ends = np.cumsum([0, *planes])
    edges = np.rint(running[ends] / running[-1] * len(body)).astype(np.int64)
    return [int(size) for size in np.diff(edges)]


def _digest(body: memoryview) -> bytes:
    return hashlib.sha256(body).digest()


def _rows(file: CogsFile, kind: SegmentKind, owner: int) -> int:
    if kind in (SegmentKind.HEAD, SegmentKind.TAIL):
        return int(file.chunks.splats[owner])
    return file.root.codebooks[owner].rows


def _by_owner(file: CogsFile, kind: SegmentKind) -> dict[int, tuple[int, int]]:
    """Return offset and length of the segments of a kind, by the chunk they belong to."""
    rows = np.flatnonzero(file.segments.kind == kind)
    return {
        int(file.segments.owner[row]): (int(file.offsets[row]), int(file.segments.length[row]))
        for row in rows
    }
