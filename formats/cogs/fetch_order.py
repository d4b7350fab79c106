"""Segments needed to decode chunks, and the order in which to fetch the segments (SPEC 8.8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from .drawn_chunks import first_level
from .scene_index import SceneIndex
from .segment_rows import codebook_kinds

if TYPE_CHECKING:
    from .index_tables import SegmentTable

# Segments of consecutive chunks are fetched in file order within groups of this size: few requests,
# and few bytes that wait in memory.
_GROUP_BYTES: Final = 8 << 20


def needed_codebooks(table: SegmentTable, row: int, books: int) -> list[int]:
    """Return the numbers of the codebooks that a segment needs (SPEC 5.3)."""
    needs = int(table.needs[row])
    return [book for book in range(books) if needs >> book & 1]


def opacity_rows(index: SceneIndex, chunk: int, level: int | None) -> list[int]:
    """Return the rows of a chunk's opacity segments up to a level, in level order (SPEC 5.11).

    The first level that contains the chunk has none: the head holds the opacities.

    Parameters
    ----------
    index : SceneIndex
        Index of the file.
    chunk : int
        Chunk number.
    level : int or None
        Last level; None for the finest.
    """
    rows = list(index.opacities.get(chunk, ()))
    if level is None or not rows:
        return rows
    return rows[: max(level - first_level(index.root.levels, chunk), 0)]


def rows_of_chunk(
    index: SceneIndex,
    chunk: int,
    *,
    sh_degree: int,
    refine: bool,
    extras: bool,
    level: int | None = None,
) -> list[int]:
    """Return the segment-table rows of the segments needed to decode a chunk.

    Parameters
    ----------
    index : SceneIndex
        Index of the file.
    chunk : int
        Chunk number.
    sh_degree : int
        Highest SH degree; 0 leaves out the SH tail.
    refine, extras : bool
        Whether to include the refinement and the extra attributes.
    level : int, optional
        Level to decode, which selects the chunk's opacity segment; by default the finest.
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


def codebook_rows(index: SceneIndex, rows: Iterable[int], sh_degree: int) -> list[int]:
    """Return the rows of the codebook segments, up to an SH degree, that given segments need.

    Parameters
    ----------
    index : SceneIndex
        Index of the file.
    rows : iterable of int
        Rows of the segments to decode.
    sh_degree : int
        Highest SH degree to decode.
    """
    books = index.root.codebooks
    needed = {book for row in rows for book in needed_codebooks(index.segments, row, len(books))}
    found: list[int] = []
    for book in sorted(needed):
        segments = index.codebooks[book]
        kinds = codebook_kinds(books[book].attribute, sh_degree)
        found += [segments[kind] for kind in kinds if kind in segments]
    return found


def ranges_to_decode(
    index: SceneIndex,
    chunks: Sequence[int],
    *,
    sh_degree: int,
    refine: bool,
    extras: bool,
    level: int | None = None,
    is_cached: Callable[[int], bool] = lambda row: False,
) -> list[tuple[int, int]]:
    """Return the byte ranges to fetch for decoding chunks, in fetch order.

    Parameters
    ----------
    index : SceneIndex
        Index of the file.
    chunks : sequence of int
        Chunk numbers in decoding order.
    sh_degree : int
        Highest SH degree of tails and codebooks.
    refine, extras : bool
        Whether to include refinements and extra attributes.
    level : int, optional
        Level for which the chunks are decoded, which selects their opacity segments; by default
        the finest.
    is_cached : callable
        Function that tells whether the segment of a row is cached and need not be fetched.

    Returns
    -------
    list of (int, int)
        Offset and length of each segment, bytes. Codebooks and the first chunks come first, then
        groups of further chunks; within a group, in file order.
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
        if not is_cached(row)
    ]


def _groups(index: SceneIndex, each: Sequence[Sequence[int]]) -> Iterator[list[int]]:
    """Yield the rows of consecutive chunks in groups of more than `_GROUP_BYTES`, except the last.

    `each` has the rows of one chunk, or of the codebooks, per item.
    """
    group: list[int] = []
    size = 0
    for rows in each:
        group += rows
        size += int(np.sum(index.segments.length[np.array(rows, np.int64)], dtype=np.int64))
        if size > _GROUP_BYTES:
            yield group
            group, size = [], 0
    yield group
