"""Selection of chunks by range, object or number of splats (SPEC 5.4, 5.10)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from .drawn_chunks import drawn_chunks
from .index_tables import ChunkTable

# Maximum number of labels in a message.
_MAX_NAMED: Final = 12


def select_chunks(
    table: ChunkTable,
    complete: int,
    chunks: tuple[int | None, int | None] | None = None,
    objects: Iterable[int] | None = None,
    splats: int | None = None,
) -> list[int]:
    """Return the numbers of the selected chunks, in file order.

    Parameters
    ----------
    table : ChunkTable
        Chunks of the file.
    complete : int
        Number of leading chunks that can be decoded.
    chunks, objects, splats
        Conditions; see `CogsFile.select`.

    Raises
    ------
    ValueError
        A range outside the file's chunks, a label of no chunk, or a negative number of splats.
    """
    count = complete
    selected = list(range(count))
    if chunks is not None:
        first = 0 if chunks[0] is None else chunks[0]
        last = len(table) if chunks[1] is None else chunks[1]
        if not 0 <= first <= last <= len(table):
            raise ValueError(f"chunks {first}:{last}, expected a range within 0:{len(table)}")
        selected = list(range(first, last))
    if objects is not None:
        own = _chunks_of(table, set(objects))
        selected = [chunk for chunk in selected if chunk in own]
    if splats is not None:
        if splats < 0:
            raise ValueError(f"splats {splats}, expected 0 or more")
        ends = np.cumsum(table.splats[selected].astype(np.int64))
        selected = selected[: int(np.searchsorted(ends, splats)) + 1] if splats else []
        count = selected[-1] + 1 if selected else 0
    if chunks is None:
        drawn = set(drawn_chunks(table, count))
        selected = [chunk for chunk in selected if chunk in drawn]
    return selected


def _chunks_of(table: ChunkTable, objects: set[int]) -> set[int]:
    """Return the numbers of the chunks with one of some object labels."""
    labels = table.object.tolist()
    there = sorted(set(labels))
    for label in sorted(objects):
        if label not in there and there in ([], [0]):
            raise ValueError(f"object {label}, expected a file with chunks of one object each")
        if label not in there:
            some = ", ".join(map(str, there[:_MAX_NAMED])) + " …" * (len(there) > _MAX_NAMED)
            raise ValueError(f"object {label}, expected one of {some}")
    return {chunk for chunk, label in enumerate(labels) if label in objects}
