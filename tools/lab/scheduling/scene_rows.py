"""Chunks and pages of all indices of a file as rows of one table (docs/streaming.md, 4, 7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.formats.cogs.index_tables import ChunkTable, PageTable
from cogsplat.formats.cogs.page_tree import Index, PagePlace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SceneRows:
    """Chunks by their numbers, then the pages in file order.

    Parameters
    ----------
    splats : (r,) int64
        Splats of each chunk, and of all chunks below each page.
    first_chunk : (r,) int64
        Number of each chunk, and of the first chunk below each page.
    chunks_below : (r,) int64
        Chunks below each page; 1 for a chunk.
    parent : (r,) int64
        Row of the parent (SPEC 5.4); -1 for none.
    listed_by : (r,) int64
        Row of the page that lists each row; -1 for the root.
    box : (r, 6) float64
        Bounding boxes: minimum, maximum, scene units.
    contribution : (r,) float64
        Stored contributions.
    chunks : int
        Number of chunks; the first page is the row of this number.
    """

    splats: I64
    first_chunk: I64
    chunks_below: I64
    parent: I64
    listed_by: I64
    box: F64
    contribution: F64
    chunks: int

    def __len__(self) -> int:
        return len(self.splats)

    @property
    def budget_splats(self) -> list[int]:
        """Splats by which each row counts in a budget (docs/streaming.md, 11)."""
        found: list[int] = (-(-self.splats // np.maximum(self.chunks_below, 1))).tolist()
        return found

    def with_sums(self, of_chunks: F64) -> F64:
        """Return values of the first chunks, 0 for others, and for pages the sums below them."""
        values = np.pad(of_chunks, (0, self.chunks - len(of_chunks)))
        sums = np.concatenate([[0.0], np.cumsum(values)])
        pages = self.first_chunk[self.chunks :]
        ends = np.minimum(pages + self.chunks_below[self.chunks :], self.chunks)
        return np.concatenate([values, sums[ends] - sums[np.minimum(pages, self.chunks)]])

    def known(self, read: Sequence[int]) -> I64:
        """Return the rows of a client that has read some pages, in file order.

        Parameters
        ----------
        read : sequence of int
            Rows of the pages read.

        Returns
        -------
        (k,) int64
            Chunks listed by the root and by these pages, and the other pages that they list.
        """
        is_known = np.isin(self.listed_by, [-1, *read])
        is_known[list(read)] = False
        is_known &= self.chunks_below > 0
        rows = np.flatnonzero(is_known)
        return rows[np.argsort(self.first_chunk[rows], kind="stable")]


def pages_in_file_order(indices: Sequence[Index]) -> Iterator[tuple[Index, PagePlace]]:
    """Yield the pages that all indices list, each with the index that lists it."""
    for index in indices:
        for place in index.pages():
            yield index, place


def scene_rows(indices: Sequence[Index], parents: I64) -> SceneRows:
    """Return the chunks and pages of the indices of a file.

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.
    parents : (c,) int64
        Parent of each chunk; -1 for none.
    """
    listed = list(pages_in_file_order(indices))
    chunks = len(parents)
    page_rows = {place.path: chunks + k for k, (_, place) in enumerate(listed)}
    lists = [page_rows.get(index.path, -1) for index in indices]
    places = [place for _, place in listed]
    page_parents = [_page_parent(indices, index, place.path[-1]) for index, place in listed]
    tables: list[ChunkTable | PageTable] = [index.tables.chunks for index in indices]
    own = [len(table) for table in tables]
    tables += [index.tables.pages for index in indices]
    return SceneRows(
        np.concatenate([part.splats.astype(np.int64) for part in tables]),
        np.array([*range(chunks), *(place.first_chunk for place in places)], np.int64),
        np.array([*[1] * chunks, *(place.extent.chunks for place in places)], np.int64),
        np.concatenate([parents, np.array(page_parents, np.int64)]),
        np.array(
            [
                *np.repeat(lists, own).tolist(),
                *(page_rows.get(index.path, -1) for index, _ in listed),
            ],
            np.int64,
        ),
        np.concatenate([part.box for part in tables]).astype(np.float64),
        np.concatenate([part.contribution for part in tables]),
        chunks,
    )


def _page_parent(indices: Sequence[Index], listing: Index, row: int) -> int:
    """Return the parent of a page (SPEC 5.4); -1 for none."""
    cell = int(listing.tables.pages.cell[row])
    around = [cell >> k for k in range(cell.bit_length())]
    by_path = {index.path: index for index in indices}
    for depth in range(len(listing.path), -1, -1):
        index = by_path[listing.path[:depth]]
        # Own chunks stand before the pages of their index.
        found = np.flatnonzero(np.isin(index.tables.chunks.cell, around))
        if len(found):
            return index.first_chunk + int(found[-1])
    return -1
