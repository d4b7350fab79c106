"""Chunk plan: an order is cut into chunks of growing size, so that the first picture comes soon."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS

DEFAULT_CHUNK_SPLATS: Final = 16384
"""Default of the largest number of splats in a chunk."""

# Small chunks cost bytes, large chunks delay pictures. Swept on a captured scene (73,780 splats at
# 35.4 dB, by contribution). Columns: splats of the first chunk, growth, splats of the largest;
# bytes of the file; PSNR in dB of its first 32, 64, 128 and 256 KiB.
#    256 1.75 16384  482,312  15.5 19.5 20.4 24.6      256 1.75  4096  519,805  15.5 19.1 21.6 25.7
#    512 1.5   8192  496,905  16.3 17.9 22.2 25.4      512 1.3   8192  505,218  16.2 18.5 21.4 26.2
#   1024 1.5  16384  483,226  17.4 19.0 21.7 25.7     1024 1.25  8192  502,746  16.1 18.3 21.2 25.8
#   2048 1.5  16384  478,711  15.8 19.5 22.4 27.1     1024 1.75 16384  481,114  15.9 18.2 21.6 26.1
# The exact end of a chunk matters as much as these settings. A first chunk of 1,024 splats takes
# about 6 KiB. Without sorting by Morton code inside chunks the file is 35 % larger, and its first
# 256 KiB show 3.6 dB less.
FIRST_SPLATS: Final = 1024
"""Splats of the first chunk."""
GROWTH: Final = 1.5
"""Ratio of a chunk's size to the chunk before, up to the largest size.

The delay before each chunk stays in proportion to the splats already shown.
"""


def plan_chunks(splats: int, largest: int = DEFAULT_CHUNK_SPLATS) -> list[slice]:
    """Return the row ranges of the chunks that an order of `splats` rows is cut into.

    Parameters
    ----------
    splats : int
        Number of rows; 0 gives no chunk.
    largest : int
        Rows of a chunk at most.

    Returns
    -------
    list of slice
        Consecutive ranges. Their sizes grow from at most `FIRST_SPLATS` rows until one would reach
        `largest`; the remaining rows are cut into even chunks of at most `largest`.

    Raises
    ------
    ValueError
        `largest` is out of range.

    Examples
    --------
    >>> from cogsplat.codec.order.chunk_plan import plan_chunks
    >>> [chunk.stop - chunk.start for chunk in plan_chunks(10_000, largest=3000)]
    [1024, 1536, 2304, 2568, 2568]
    """
    if not 1 <= largest <= MAX_CHUNK_SPLATS:
        raise ValueError(f"chunks of {largest} splats, expected 1 to {MAX_CHUNK_SPLATS}")
    chunks: list[slice] = []
    start, size = 0, float(min(FIRST_SPLATS, largest))
    while start < splats:
        rest = splats - start
        if size >= largest:
            # The fewest chunks of even size: a tiny last chunk would still cost a head and an index
            # entry.
            count = -(-rest // largest)
            bounds = [start + rest * number // count for number in range(count + 1)]
            return chunks + [slice(a, b) for a, b in pairwise(bounds)]
        stop = start + int(size)
        # If less than half of the next chunk would remain, its rows join this chunk if they fit.
        if splats - stop < size / 2 and rest <= largest:
            stop = splats
        stop = min(stop, splats)
        chunks.append(slice(start, stop))
        start, size = stop, min(size * GROWTH, float(largest))
    return chunks


# A captured room ordered by marginal gain takes 16 % more bytes than ordered by contribution, and
# 4 % more once sorted in runs of three chunks. In runs of four, a prefix of 20 % of the splats has
# 0.6 dB less.
RUN_CHUNKS: Final = 3
"""Default number of chunks per sorted run, after the first chunk."""


def sort_runs(
    rows: NDArray[np.int64],
    priority: NDArray[np.float64],
    largest: int = DEFAULT_CHUNK_SPLATS,
    run_chunks: int = RUN_CHUNKS,
) -> NDArray[np.int64]:
    """Sort an order by priority inside runs of a few chunks, so that chunks hold similar splats.

    All splats of a chunk share its quantiser steps. If a few splats weigh more than the rest, the
    steps are finer than most of the chunk needs.

    Parameters
    ----------
    rows : (n,) int64
        Order of some or all rows of a scene.
    priority : (N,) float64
        Priority of each row of the scene, such as its contribution.
    largest : int
        Rows of a chunk at most; see `plan_chunks`.
    run_chunks : int
        Chunks of a run, at least 1.

    Returns
    -------
    (n,) int64
        Rows of the first chunk unchanged, then the runs, each by descending priority; ties keep
        their order.
    """
    chunks = plan_chunks(len(rows), largest)
    parts = [rows[run] for run in chunks[:1]]
    for first in range(1, len(chunks), run_chunks):
        last = min(first + run_chunks, len(chunks)) - 1
        run = rows[chunks[first].start : chunks[last].stop]
        parts.append(run[np.argsort(-priority[run], kind="stable")])
    return np.concatenate(parts) if parts else rows
