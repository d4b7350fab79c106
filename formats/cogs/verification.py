"""Checks of a verifier on an open file, one by one (SPEC 1.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams.zstd_frames import exact_streams

from .chunk_decoder import ChunkDecoder
from .drawn_chunks import first_level
from .folder_places import check_object, key_of
from .layout import SegmentKind


@dataclass(frozen=True)
class Check:
    """One check of an open file.

    Parameters
    ----------
    what : str
        Name of the checked part, such as ``head of chunk 3``.
    offset : int
        Byte offset of the checked segment.
    run : callable
        Function that raises a `CogsplatError` if the file breaks a rule.
    """

    what: str
    offset: int
    run: Callable[[], object]


def checks(file: ChunkDecoder) -> Iterator[Check]:
    """Yield all checks of an open file (SPEC 1.4).

    Parameters
    ----------
    file : CogsFile
        Open file, whose preamble, root, pages and tables were checked on opening.

    Yields
    ------
    Check
        In this order: decoded size; CRC and hash of every segment; object names of a folder;
        codebooks; cameras; compensation; view table; description with pictures; then head,
        refinement, opacities, tail with attributes, and bounding box of every chunk.
    """
    # Several checks decode the same frames.
    known: set[int] = set()
    for check in _checks(file):
        yield replace(check, run=exact_streams(known)(check.run))


def _checks(file: ChunkDecoder) -> Iterator[Check]:
    """Yield the checks of `checks`, with Huffman streams checked as far as libzstd does."""
    yield Check("decoded size", 0, file.require_size)
    for row in range(len(file.segments)):
        yield Check(f"segment {row}", int(file.offsets[row]), partial(read_verified, file, row))
    for name, offset in file.objects().items():
        yield Check(name, offset, partial(_check_object, file, name))
    for book in range(len(file.root.codebooks)):
        # Codebooks that no chunk needs are checked as well.
        kinds = (SegmentKind.SHAPE_CODEBOOK, SegmentKind.COLOUR_BAND1)
        rows = [row for kind in kinds for row in file.segment_rows(kind, book)]
        offset = int(file.offsets[rows[0]]) if rows else 0
        yield Check(f"codebook {book}", offset, partial(file.load_codebook, book))
    if file.camera_row is not None:
        yield Check("cameras", int(file.offsets[file.camera_row]), file.cameras)
    layers = np.flatnonzero(file.segments.kind == SegmentKind.COMPENSATION)
    if len(layers):
        yield Check("compensation", int(file.offsets[layers[0]]), file.compensation)
    for path, row in file.view_table_rows.items():
        at = int(file.offsets[row])
        yield Check(f"view table of index {path}", at, partial(file.view_table, path))
    described = file.description_row
    if described is not None:
        offset = int(file.offsets[described])
        check = partial(file.description, pictures=file.has_all_pages)
        yield Check("description", offset, check)
    for chunk in range(file.num_chunks):
        yield from _progressive_checks(file, chunk)


def _progressive_checks(file: ChunkDecoder, chunk: int) -> Iterator[Check]:
    """Yield checks that decode a chunk with one more segment each: head, refinement, and so on."""
    rows = file.chunk_rows(chunk)
    start = int(file.offsets[rows.head])

    def coarse() -> None:
        means = file.decode([chunk], sh_degree=0, refine=False, extras=False, threads=1).means
        _require_inside(file, chunk, means, start)

    yield Check(f"head of chunk {chunk}", start, coarse)
    if rows.refinement is not None:
        at = int(file.offsets[rows.refinement])

        def fine() -> None:
            means = file.decode([chunk], sh_degree=0, extras=False, threads=1).means
            _require_inside(file, chunk, means, at)

        yield Check(f"refinement of chunk {chunk}", at, fine)
    first = first_level(file.root.levels, chunk)
    for later, opacities in enumerate(rows.opacities, start=1):
        yield Check(
            f"opacities of chunk {chunk} at level {first + later}",
            int(file.offsets[opacities]),
            partial(
                file.decode, [chunk], level=first + later, sh_degree=0, extras=False, threads=1
            ),
        )
    rest = [row for row in (rows.tail, rows.attributes) if row is not None]
    if rest:
        yield Check(
            f"tail and attributes of chunk {chunk}",
            int(file.offsets[rest[0]]),
            partial(file.decode, [chunk], threads=1),
        )


def read_verified(file: ChunkDecoder, row: int) -> memoryview:
    """Return a segment's bytes after checks of their CRC and hash.

    Raises
    ------
    TruncatedError
        ``file-truncated``, ``segment-missing``: the source lacks the segment.
    FormatError
        ``segment-crc``, ``segment-hash``.
    """
    data = file.read_segment(row)
    if key_of(data) != file.segments.hash[row].tobytes():
        raise FormatError(
            "segment-hash",
            f"{file.name}: segment {row}: its SHA-256 does not match, expected "
            f"{file.segments.hash[row].tobytes().hex()} as in the table",
            clause="5.3",
            offset=int(file.offsets[row]),
        )
    return data


def _check_object(file: ChunkDecoder, name: str) -> None:
    """Refuse an object of a folder whose name is not its hash."""
    check_object(name, file.read_object(name), file.name)


def _require_inside(file: ChunkDecoder, chunk: int, means: np.ndarray, offset: int) -> None:
    """Refuse means outside the bounding box of their chunk (SPEC 5.4)."""
    box = file.chunks.box[chunk]
    if not ((means >= box[:3]) & (means <= box[3:])).all():
        raise FormatError(
            "chunk-box",
            f"{file.name}: chunk {chunk}: means from {means.min(axis=0).tolist()} to "
            f"{means.max(axis=0).tolist()}, expected within {box.tolist()}",
            clause="5.4",
            offset=offset,
        )
