"""Tree of the chunks of a scene cut into cells: which chunks one index of the file lists.

The root lists the first chunks, which show the whole scene coarsely. All others are below pages,
those inside one cell below one page, so that a client at one place of a city reads few pages.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

I64 = NDArray[np.int64]

ROOT_CHUNKS: Final = 64
"""Maximum number of chunks that the root lists: with 32 pages they take 14 of its 16 KiB."""

_ROOT_PAGES: Final = 32
"""Pages that the root lists at most."""

# Chunks and pages that a page lists at most: about 20 KB. Root and two levels of pages then list
# 298,000 chunks, so that three requests lead to each. Larger files have pages of 37 KB, which list
# 792,000 chunks in this way: 10^9 splats of a city in parts have 470,000, in cells of uneven sizes.
_PAGE: Final = (96, 96)
_LARGE_PAGE: Final = (192, 128)

# Levels of pages (SPEC 5.6).
_DEPTH: Final = 3


@dataclass(frozen=True, eq=False)
class ChunkTree:
    """Chunks that an index lists, and the trees of its pages.

    Parameters
    ----------
    chunks : (c,) int64
        Positions of the chunks of the index in the order given.
    pages : tuple of ChunkTree
        Trees of the pages, depth first by cell.
    """

    chunks: I64
    pages: tuple[ChunkTree, ...] = ()

    def order(self) -> I64:
        """Return the positions of all chunks in the order of the file: depth first (SPEC 5.4)."""
        return np.concatenate([self.chunks, *(page.order() for page in self.pages)])


def chunk_tree(cells: NDArray[np.integer], parts: NDArray[np.integer] | None = None) -> ChunkTree:
    """Distribute chunks over the root and pages that follow the cells.

    Each index lists the first chunks of what is below it. The others are grouped by cells: the
    largest cell is halved until all have few enough chunks for one page, or there are enough pages.

    Parameters
    ----------
    cells : (c,) integer
        Cell number of each chunk, at least 1, in the order in which pictures need the chunks.
    parts : (c,) integer, optional
        Number of the part of the scene that each chunk belongs to, of parts that share no cell.
        Chunks of several parts are below one page only where there are too many pages otherwise.

    Returns
    -------
    ChunkTree
        Tree of the root. Where the chunks stand in its order already, that is the order given.

    Examples
    --------
    >>> from cogsplat.codec.partition.chunk_tree import chunk_tree
    >>> cells = np.concatenate([np.ones(64, np.int64), np.tile([2, 3], 80)])
    >>> tree = chunk_tree(cells)
    >>> len(tree.chunks), [len(page.chunks) for page in tree.pages]
    (64, [80, 80])
    """
    numbers = cells.astype(np.int64)
    of_parts = np.zeros(len(cells), np.int64) if parts is None else parts.astype(np.int64)
    own, pages = _PAGE
    if len(cells) > ROOT_CHUNKS + _ROOT_PAGES * own * (1 + pages):
        own, pages = _LARGE_PAGE

    def tree(chunks: I64, first: int, most_pages: int, depth: int) -> ChunkTree:
        """Return the tree of some chunks, whose index lists at most `first` of the chunks."""
        if len(chunks) <= first or not depth:
            return ChunkTree(chunks)
        groups = _groups(chunks[first:], numbers, of_parts, most_pages, own)
        below = tuple(tree(group, own, pages, depth - 1) for group in groups)
        return ChunkTree(chunks[:first], below)

    return tree(np.arange(len(numbers)), ROOT_CHUNKS, _ROOT_PAGES, _DEPTH)


def _groups(chunks: I64, cells: I64, parts: I64, most: int, largest: int) -> list[I64]:
    """Return the chunks in at most `most` groups, each inside one cell, depth first by cell.

    Groups of more than `largest` chunks, or of several parts, are halved while there are fewer.
    """

    def excess(group: I64) -> int:
        """Return the size of a group that is to be halved, else 0."""
        is_mixed = len(group) and (parts[group] != parts[group[0]]).any()
        return len(group) if is_mixed or len(group) > largest else 0

    groups = [chunks]
    sizes = [excess(chunks)]
    while len(groups) < most and max(sizes):
        place = sizes.index(max(sizes))
        halves = _halves(groups[place], cells)
        groups[place : place + 1] = halves
        sizes[place : place + 1] = map(excess, halves) if len(halves) == 2 else [0]
    return groups


def _halves(chunks: I64, cells: I64) -> list[I64]:
    """Split chunks by the two halves of their common cell; one group if a chunk fills that cell."""
    own = cells[chunks]
    around = common_cell(own)
    if (own == around).any():
        return [chunks]
    depth = around.bit_length()
    is_high = np.array([cell >> (cell.bit_length() - depth - 1) & 1 for cell in own.tolist()], bool)
    return [chunks[~is_high], chunks[is_high]]


def common_cell(cells: NDArray[np.integer]) -> int:
    """Return the smallest cell that contains all given cells; 0 without cells, or with a cell 0.

    Examples
    --------
    >>> from cogsplat.codec.partition.chunk_tree import common_cell
    >>> common_cell(np.array([8, 9, 5]))
    2
    """
    numbers = np.unique(cells).tolist()
    if not numbers or not numbers[0]:
        return 0
    around: int = numbers[0]
    for cell in numbers[1:]:
        size = min(around.bit_length(), cell.bit_length())
        around >>= around.bit_length() - size
        cell >>= cell.bit_length() - size
        around >>= (around ^ cell).bit_length()
    return around
