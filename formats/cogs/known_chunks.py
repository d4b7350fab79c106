"""Chunks of an index that was read in part, where an unread page counts as one (SPEC 5.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.partition.nested_cells import parents

from .page_tree import PagePlace
from .scene_index import SceneIndex

I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class KnownChunks:
    """Chunks in file order, where an unread page counts as one chunk.

    Parameters
    ----------
    numbers : (k,) int64
        Number of each chunk, of a page that of the first chunk below it.
    pages : sequence of (PagePlace or None)
        Unread page that each row stands for; None for a chunk.
    splats : (k,) int64
        Number of splats.
    cells : (k,) int64
        Cell; 0 in a scene without cells.
    boxes : (k, 6) float32
        Bounding box: minimum corner, maximum corner; scene units.
    contributions : (k,) float64
        Sum of the contributions of the splats.
    parents : (k,) int64
        Row of the parent; -1 for none.
    """

    numbers: I64
    pages: list[PagePlace | None]
    splats: I64
    cells: I64
    boxes: NDArray[np.float32]
    contributions: NDArray[np.float64]
    parents: I64


def known_chunks(index: SceneIndex) -> KnownChunks:
    """Return the chunks of all indices that were read, and one for each unread page below them."""
    indices = {each.path: each for each in index.indices}
    parts: list[tuple[int, PagePlace | None, tuple[int, ...], int]] = []
    for each in index.indices:
        first = each.first_chunk
        own = range(len(each.tables.chunks))
        parts += [(first + row, None, each.path, row) for row in own]
        unread = [page for page in each.pages() if page.path not in indices and page.extent.chunks]
        parts += [(page.first_chunk, page, each.path, page.path[-1]) for page in unread]
    parts.sort(key=lambda part: part[0])
    tables = [
        (indices[path].tables.chunks if page is None else indices[path].tables.pages, row)
        for _, page, path, row in parts
    ]
    numbers = np.array([number for number, *_ in parts], np.int64)
    cells = np.array([table.cell[row] for table, row in tables], np.int64)
    # Rows below each page: those of a page that was read, and the one of a page that was not.
    subtrees = [
        (int(first), int(end))
        for first, end in np.searchsorted(numbers, np.reshape(index.subtrees, (-1, 2)))
    ]
    subtrees += [(row, row + 1) for row, (_, page, _, _) in enumerate(parts) if page is not None]
    subtrees.sort(key=lambda rows: (rows[0], -rows[1]))
    return KnownChunks(
        numbers,
        [page for _, page, _, _ in parts],
        np.array([table.splats[row] for table, row in tables], np.int64),
        cells,
        np.array([table.box[row] for table, row in tables], np.float32).reshape(-1, 6),
        np.array([table.contribution[row] for table, row in tables], np.float64),
        parents(cells, subtrees),
    )
