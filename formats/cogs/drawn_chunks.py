"""Chunks that a prefix or a level draws (SPEC 5.10, 5.11)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .index_tables import ChunkTable
from .root import Level

I64 = NDArray[np.int64]


def drawn_chunks(chunks: ChunkTable, count: int) -> list[int]:
    """Return the numbers of the chunks that a prefix draws, without ended preview chunks.

    Parameters
    ----------
    chunks : ChunkTable
        Table of at least the first `count` chunks.
    count : int
        Number of chunks of the prefix.
    """
    until = chunks.until[:count]
    return [int(chunk) for chunk in np.flatnonzero((until == 0) | (until > count))]


def first_level(levels: Sequence[Level], chunk: int) -> int:
    """Return the number of the first level that contains a chunk."""
    return sum(level.chunks <= chunk for level in levels)


def later_levels(levels: Sequence[Level], chunks: ChunkTable, first: int) -> I64:
    """Return the number of levels that draw each chunk, not counting its first level.

    A chunk has at most this number of opacity segments.

    Parameters
    ----------
    levels : sequence of Level
        Levels of the scene.
    chunks : ChunkTable
        Chunks of an index.
    first : int
        Number of the first of these chunks.
    """
    ends = [level.chunks for level in levels]
    stops = np.searchsorted(ends, chunks.until, side="left")
    stops[chunks.until == 0] = len(ends)
    firsts = np.searchsorted(ends, first + np.arange(len(chunks)), side="right")
    later: I64 = np.maximum(stops - firsts - 1, 0)
    return later
