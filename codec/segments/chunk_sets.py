"""Sets of chunks that include all parents: the chunks of a client with view-dependent order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

I64 = NDArray[np.int64]


def has_all_parents(chunks: Sequence[int], parents: I64) -> bool:
    """Return whether a set of chunks includes the parent of each chunk.

    Parameters
    ----------
    chunks : sequence of int
        Chunk numbers of the set, ascending.
    parents : (c,) int64
        Parent of each chunk of the file; -1 for none (SPEC 5.4).
    """
    held = set(chunks)
    return all(int(parents[chunk]) in held or parents[chunk] < 0 for chunk in chunks)


def equivalent_prefixes(chunks: Sequence[int], parents: I64, chunk_splats: I64) -> I64:
    """Return the prefix length at which each chunk of a set is compensated (SPEC 8.5).

    A set of chunks need not be a prefix. Compensation of a chunk depends on how many splats of its
    subtree, the chunk and its descendants, are present. Each chunk is therefore compensated as in
    the longest prefix that has no more splats of its subtree than the set.

    Parameters
    ----------
    chunks : sequence of int
        Chunk numbers of the set, ascending, including all parents.
    parents : (c,) int64
        Parent of each chunk of the file; -1 for none.
    chunk_splats : (c,) int64
        Number of splats in each chunk of the file.

    Returns
    -------
    (k,) int64
        Number of chunks in the prefix of each chunk, at most up to the last chunk of the set. If
        the set is the first n chunks, n for all.

    Examples
    --------
    Chunk 0 has the children 1 and 2, chunk 1 the child 3, chunk 2 the child 4; 2 and 4 are missing.

    >>> import numpy as np
    >>> from cogsplat.codec.segments.chunk_sets import equivalent_prefixes
    >>> above = np.array([-1, 0, 0, 1, 2])
    >>> equivalent_prefixes([0, 1, 3], above, np.full(5, 10)).tolist()
    [3, 4, 4]
    """
    end = chunks[-1] + 1 if len(chunks) else 0
    lines = _ancestor_lines(end, parents)
    held = np.zeros(end, np.int64)
    for chunk in chunks:
        for above in lines[chunk]:
            held[above] += chunk_splats[chunk]
    passed = np.zeros(end, np.int64)
    found = np.full(end, end, np.int64)
    for chunk in range(end):
        for above in lines[chunk]:
            passed[above] += chunk_splats[chunk]
            if passed[above] > held[above] and found[above] == end:
                found[above] = chunk
    return found[np.asarray(chunks, np.int64)]


def descendant_parts(
    chunks: Sequence[int], parents: I64, chunk_splats: I64, first: int
) -> NDArray[np.float64]:
    """Return the share that a set has of each chunk's later descendants (SPEC 8.5).

    Parameters
    ----------
    chunks : sequence of int
        Chunk numbers of the set, ascending, including all parents.
    parents, chunk_splats
        See `equivalent_prefixes`.
    first : int
        Number of first chunks that do not count.

    Returns
    -------
    (k,) float64
        Splats of the descendants in the set less those among the first chunks, divided by those of
        all descendants less those; 1 where the set has all descendants.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.segments.chunk_sets import descendant_parts
    >>> above = np.array([-1, 0, 0, 1, 2])
    >>> descendant_parts([0, 1, 3], above, np.full(5, 10), 1).tolist()
    [0.5, 1.0, 1.0]
    """
    every = np.arange(len(parents))
    held = descendant_splats(np.isin(every, np.asarray(chunks, np.int64)), parents, chunk_splats)
    before = descendant_splats(every < first, parents, chunk_splats)
    whole = descendant_splats(every >= 0, parents, chunk_splats)
    parts = (held - before) / np.maximum(whole - before, 1)
    shares: NDArray[np.float64] = np.where(held == whole, 1.0, parts)
    return shares[np.asarray(chunks, np.int64)]


def descendant_splats(counts_in: NDArray[np.bool_], parents: I64, chunk_splats: I64) -> I64:
    """Return the number of splats of each chunk and its descendants together.

    Parameters
    ----------
    counts_in : (c,) bool
        Whether each chunk counts; the splats of others are left out.
    parents, chunk_splats
        See `equivalent_prefixes`.

    Returns
    -------
    (c,) int64

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.segments.chunk_sets import descendant_splats
    >>> descendant_splats(np.array([True, True, False]), np.array([-1, 0, 0]), np.full(3, 5))
    array([10,  5,  0])
    """
    sums = np.where(counts_in, chunk_splats, 0).astype(np.int64)
    for chunk in range(len(parents) - 1, 0, -1):
        if parents[chunk] >= 0:
            sums[parents[chunk]] += sums[chunk]
    return sums


def _ancestor_lines(chunks: int, parents: I64) -> list[tuple[int, ...]]:
    """Return the numbers of each chunk and all its ancestors, for the first `chunks` chunks."""
    lines: list[tuple[int, ...]] = []
    for chunk in range(chunks):
        above = int(parents[chunk])
        lines.append((chunk,) if above < 0 else (chunk, *lines[above]))
    return lines
