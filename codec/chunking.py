"""Cut an order into chunks: small ones first, so that the first picture is soon there."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

DEFAULT_LARGEST: Final = 16384
MAX_CHUNK_SPLATS: Final = 1 << 18
"""Most splats a chunk may hold (SPEC 9.1)."""
FIRST_SPLATS: Final = 1024
# Each chunk so much larger than the one before: the wait for the next stays in proportion.
_GROWTH: Final = 1.5


def plan_chunks(splats: int, largest: int = DEFAULT_LARGEST) -> list[slice]:
    """Return consecutive runs that cover `splats` rows.

    Parameters
    ----------
    splats : int
        Rows in all; none give no chunk.
    largest : int
        Most rows in a chunk.

    Returns
    -------
    list of slice
        Growing from at most `FIRST_SPLATS` rows until one would be `largest`; the rest in even runs
        of at most that.
    """
    if not 1 <= largest <= MAX_CHUNK_SPLATS:
        raise ValueError(f"chunks of {largest} splats, expected 1 to {MAX_CHUNK_SPLATS}")
    chunks: list[slice] = []
    start, size = 0, float(min(FIRST_SPLATS, largest))
    while start < splats:
        rest = splats - start
        if size >= largest:
            # As few chunks as hold the rest, and even ones: a tiny last chunk costs its framing.
            count = -(-rest // largest)
            bounds = [start + rest * number // count for number in range(count + 1)]
            return chunks + [slice(a, b) for a, b in pairwise(bounds)]
        stop = start + int(size)
        # A rest smaller than half a chunk joins this one where it may.
        if splats - stop < size / 2 and rest <= largest:
            stop = splats
        stop = min(stop, splats)
        chunks.append(slice(start, stop))
        start, size = stop, min(size * _GROWTH, float(largest))
    return chunks
