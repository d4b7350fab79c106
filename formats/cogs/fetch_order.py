"""Which segments a part of a scene takes, and in which order they are fetched (SPEC 8.8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from .drawn_chunks import first_level
from .index import Index, codebook_kinds

if TYPE_CHECKING:
    from .root import SegmentTable

# Segments of chunks that are decoded one after the other are fetched in the order of the file, in
# groups of so many bytes: few requests, and little that waits in memory.
_GROUP_BYTES: Final = 8 << 20


def needed_codebooks(table: SegmentTable, row: int, books: int) -> list[int]:
    """Return the numbers of the codebooks that a segment needs (SPEC 5.3)."""
    needs = int(table.needs[row])
    return [book for book in range(books) if needs >> book & 1]


def opacity_rows(index: Index, chunk: int, level: int | None) -> list[int]:
    """Return the segments that a chunk has of opacities up to a level, the last one's at the end.

    Without a level those of all levels (SPEC 5.11).
    """
    rows = list(index.opacities.get(chunk, ()))
    if level is None or not rows:
        return rows
    return rows[: max(level - first_level(index.root.levels, chunk), 0)]


def rows_of_chunk(
    index: Index,
    chunk: int,
    *,
    sh_degree: int,
    refine: bool,
    extras: bool,
    level: int | None = None,
) -> list[int]:
    """Return the rows of the segments that a chunk takes at a level, by default at the finest.

    They are its head, refinement, opacities, tail and extra attributes.
    """
    rows = [int(index.heads[chunk])]
    if refine:
        rows.append(int(index.refinements[chunk]))
    rows += opacity_rows(index, chunk, level)[-1:]
    if sh_degree:
        rows.append(int(index.tails[chunk]))
    if extras:
        rows.append(int(index.attributes[chunk]))
    return [row for row in rows if row >= 0]


def codebook_rows(index: Index, rows: Iterable[int], sh_degree: int) -> list[int]:
    """Return the rows of the codebooks that segments need up to an SH degree, each once."""
    books = index.root.codebooks
    needed = {book for row in rows for book in needed_codebooks(index.segments, row, len(books))}
    found: list[int] = []
    for book in sorted(needed):
        segments = index.codebooks[book]
        kinds = codebook_kinds(books[book].attribute, sh_degree)
        found += [segments[kind] for kind in kinds if kind in segments]
    return found


def ranges_to_decode(
    index: Index,
    chunks: Sequence[int],
    *,
    sh_degree: int,
    refine: bool,
    extras: bool,
    level: int | None = None,
    is_kept: Callable[[int], bool] = lambda row: False,
) -> list[tuple[int, int]]:
    """Return the ranges that decoding chunks takes, in the order in which to fetch them.

    Parameters
    ----------
    index : Index
    chunks : sequence of int
        In the order in which they are decoded.
    sh_degree : int
        Up to which tails and bands of codebooks are read.
    refine, extras : bool
        Whether refinements and extra attributes are read.
    level : int, optional
        Whose opacities are read; by default the finest.
    is_kept : callable
        Whether a segment, by its row, need not be fetched.

    Returns
    -------
    list of (int, int)
        Offset and length: in the order of the file codebooks and the segments of the first chunks,
        then those of a few further chunks at a time.
    """
    each = [
        rows_of_chunk(index, chunk, sh_degree=sh_degree, refine=refine, extras=extras, level=level)
        for chunk in chunks
    ]
    every = [row for rows in each for row in rows]
    books = codebook_rows(index, every, sh_degree)
    ordered: list[int] = []
    for group in _groups(index, [books, *each]):
        ordered += sorted(group)
    return [
        (int(index.offsets[row]), int(index.segments.length[row]))
        for row in ordered
        if not is_kept(row)
    ]


def _groups(index: Index, each: Sequence[Sequence[int]]) -> Iterator[list[int]]:
    group: list[int] = []
    size = 0
    for rows in each:
        group += rows
        size += int(np.sum(index.segments.length[np.array(rows, np.int64)], dtype=np.int64))
        if size > _GROUP_BYTES:
            yield group
            group, size = [], 0
    yield group
