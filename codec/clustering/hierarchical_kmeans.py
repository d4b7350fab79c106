"""Palettes: codebooks of tens of thousands of rows, by hierarchical k-means in near-linear time.

Plain k-means compares every vector with every row. Here coarse clusters divide the vectors and the
rows first, and a vector is compared only with the rows of the clusters nearest to its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.threads import ordered_map, thread_count

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Index = NDArray[np.intp]

# Rows of a cluster at most, which bounds the search within it. A cluster with more rows is divided
# into one part per 128 rows, at most 256 parts.
_LEAF_ROWS: Final = 512
_SPLIT: Final = 256
_ROWS_PER_PART: Final = 128
# Levels of division at most. Vectors that hardly divide get fewer rows than requested.
_MAX_DEPTH: Final = 4

# Training vectors of coarse clusters, which need to be small rather than good.
_SPLIT_SAMPLE: Final = 40_000
# Vectors that seeds are drawn from, per row and at least.
_SEED_SAMPLE_PER_ROW: Final = 32
_MIN_SEED_SAMPLE: Final = 8192

# Lloyd iterations inside one cluster, and then over all clusters.
_LOCAL_ITERATIONS: Final = 3
_ROUNDS: Final = 2
# Budget of vector-row comparisons in one iteration over all clusters. It determines the number of
# neighbouring clusters that each vector is compared with, within these limits.
_ROUND_COMPARISONS: Final = 1 << 31
_MIN_NEIGHBOURS: Final = 4
_MAX_NEIGHBOURS: Final = 16

# Vectors per matrix product with the rows, so that the distances stay in the cache.
_BLOCK: Final = 1024


@dataclass(frozen=True)
class _Leaf:
    """Cluster of vectors that is not divided further, with its rows of the palette.

    Parameters
    ----------
    members : (m,) intp
        Numbers of the cluster's vectors.
    centre : (d,) float32
        Mean of the initial rows, which later updates of the rows do not change.
    rows : (r, d) float32
        Palette rows trained on the cluster's vectors.
    """

    members: Index
    centre: F32
    rows: F32


def train_palette(vectors: F32, rows: int, threads: int = 0) -> tuple[F32, NDArray[np.uint32]]:
    """Train a palette on vectors and return it with the palette row of each vector.

    Parameters
    ----------
    vectors : (n, d) float32
        Finite vectors.
    rows : int
        Palette rows at most, at least 1.
    threads : int
        Number of threads; 0 for all cores. The result does not depend on it.

    Returns
    -------
    palette : (C, d) float32
        Palette of C ≤ `rows` rows in the order of first use; every row is used.
    labels : (n,) uint32
        Palette row of each vector: nearly always the nearest row.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.clustering.hierarchical_kmeans import train_palette
    >>> palette, labels = train_palette(np.array([[1], [5], [1]], np.float32), rows=4)
    >>> palette.tolist(), labels.tolist()
    ([[1.0], [5.0]], [0, 1, 0])
    """
    from threadpoolctl import threadpool_limits

    if not len(vectors):
        return np.empty((0, vectors.shape[1]), np.float32), np.empty(0, np.uint32)
    vectors = np.ascontiguousarray(vectors)
    # One BLAS thread: the order of BLAS's sums depends on the number of threads.
    with threadpool_limits(limits=1):
        everything = np.arange(len(vectors))
        leaves = list(_divide(vectors, everything, rows, 0, thread_count(threads)))
        labels = np.empty(len(vectors), np.intp)
        palette = np.empty((0, vectors.shape[1]), np.float32)
        for _ in range(_ROUNDS):
            labels = _assign(vectors, leaves, thread_count(threads))
            palette, used = _means(vectors, labels, sum(len(leaf.rows) for leaf in leaves))
            leaves = _update_rows(leaves, palette, used)
            labels = (np.cumsum(used) - 1)[labels]
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.uint32)
    rank[order] = np.arange(len(order), dtype=np.uint32)
    return palette[order], rank[inverse.reshape(-1)]


def _divide(vectors: F32, members: Index, rows: int, depth: int, threads: int) -> Iterator[_Leaf]:
    """Divide vectors recursively into leaves and train the palette rows of each.

    Parameters
    ----------
    vectors : (n, d) float32
        All vectors.
    members : (m,) intp
        Numbers of the vectors to divide.
    rows : int
        Palette rows for these vectors. At most `_LEAF_ROWS` go to one leaf.
    depth : int
        Number of divisions so far.
    threads : int
        Number of threads of this division; deeper ones run on one.
    """
    if rows <= _LEAF_ROWS or depth == _MAX_DEPTH:
        trained = _train_local(vectors[members], min(rows, _LEAF_ROWS), depth)
        yield _Leaf(members, trained.mean(axis=0), trained)
        return
    parts = min(_SPLIT, -(-rows // _ROWS_PER_PART))
    rng = np.random.default_rng([depth, len(members)])
    sample = members
    if len(members) > _SPLIT_SAMPLE:
        sample = members[np.sort(rng.choice(len(members), _SPLIT_SAMPLE, replace=False))]
    centres = _train_local(vectors[sample], parts, depth)
    labels, errors = _nearest_row_and_error(vectors, members, centres, threads)
    order = np.argsort(labels, kind="stable")
    counts = np.bincount(labels, minlength=len(centres))
    part_errors = np.bincount(labels, errors, len(centres)).astype(np.float64)
    part_rows = _allocate_rows(counts, part_errors, rows)
    groups = np.split(members[order], np.cumsum(counts)[:-1])
    work = [(group, int(n)) for group, n in zip(groups, part_rows, strict=True) if len(group)]

    def divide_part(item: tuple[Index, int]) -> list[_Leaf]:
        return list(_divide(vectors, *item, depth + 1, 1))

    for leaves in ordered_map(divide_part, work, threads):
        yield from leaves


def _allocate_rows(counts: Index, errors: F64, rows: int) -> Index:
    """Divide a number of palette rows among clusters.

    A cluster gets rows in proportion to √(its vectors · its squared error), but no more rows than
    it has vectors.
    """
    weights = np.sqrt(counts * errors)
    shares = np.minimum(counts, 1)
    # Rows in excess of a cluster's vectors are divided among the remaining clusters, repeatedly.
    for _ in range(8):
        left = rows - int(shares.sum())
        open_ = np.where(shares < counts, weights, 0.0)
        if left <= 0 or open_.sum() == 0:
            break
        more = np.floor(open_ / open_.sum() * left).astype(np.intp)
        if not more.any():
            break
        shares = np.minimum(shares + more, counts)
    return shares


def _train_local(vectors: F32, rows: int, seed: int) -> F32:
    """Train the rows of one cluster by k-means; fewer than `rows` if it has fewer vectors."""
    centres = _seeds(vectors, rows, seed)
    if len(centres) == len(vectors):
        return centres
    for _ in range(_LOCAL_ITERATIONS):
        labels = _nearest_row(vectors, centres)
        centres = _means(vectors, labels, len(centres))[0]
    return centres


def _seeds(vectors: F32, rows: int, seed: int) -> F32:
    """Choose initial rows: distant vectors (k-means++, Arthur and Vassilvitskii 2007)."""
    rng = np.random.default_rng([seed, len(vectors), rows])
    sample = max(_SEED_SAMPLE_PER_ROW * rows, _MIN_SEED_SAMPLE)
    if len(vectors) > sample:
        vectors = vectors[rng.choice(len(vectors), sample, replace=False)]
    if len(vectors) <= rows:
        return vectors
    norms = np.square(vectors).sum(axis=1)
    chosen = [int(rng.integers(len(vectors)))]
    distances = np.full(len(vectors), np.inf, np.float32)
    while len(chosen) < rows:
        last = vectors[chosen[-1]]
        latest = norms - 2 * (vectors @ last) + norms[chosen[-1]]
        np.minimum(distances, latest.clip(0), out=distances)
        # Exactly 0: with a rounding error the vector could be drawn again.
        distances[chosen[-1]] = 0
        total = np.cumsum(distances, dtype=np.float64)
        if total[-1] <= 0:
            break
        place = int(np.searchsorted(total, rng.random() * total[-1], side="right"))
        chosen.append(min(place, len(vectors) - 1))
    return vectors[chosen]


def _nearest_row(vectors: F32, rows: F32) -> Index:
    """Return the index of each vector's nearest row by exhaustive search."""
    half_norms = np.square(rows).sum(axis=1) / 2
    transposed = np.ascontiguousarray(rows.T)
    out = np.empty(len(vectors), np.intp)
    for start in range(0, len(vectors), _BLOCK):
        block = vectors[start : start + _BLOCK]
        out[start : start + _BLOCK] = (half_norms - block @ transposed).argmin(axis=1)
    return out


def _nearest_row_and_error(
    vectors: F32, members: Index, rows: F32, threads: int
) -> tuple[Index, F64]:
    """Return the nearest row of each vector of `members`, and its squared distance."""

    def search(start: int) -> tuple[Index, F64]:
        block = vectors[members[start : start + 16 * _BLOCK]]
        best = _nearest_row(block, rows)
        return best, np.square(block - rows[best]).sum(axis=1, dtype=np.float64)

    found = list(ordered_map(search, range(0, len(members), 16 * _BLOCK), threads))
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


def _means(vectors: F32, labels: Index, count: int) -> tuple[F32, NDArray[np.bool_]]:
    """Return the mean vector of each used label and a mask of the used labels.

    Labels are 0 to `count` - 1; a label is used if at least one vector has it.
    """
    order = np.argsort(labels, kind="stable")
    counts = np.bincount(labels, minlength=count)
    used = counts > 0
    starts = (np.cumsum(counts) - counts)[used]
    means = np.empty((len(starts), vectors.shape[1]), np.float32)
    # Column by column: a float64 copy of all vectors would be the largest array in use.
    for column in range(vectors.shape[1]):
        values = vectors[order, column].astype(np.float64)
        means[:, column] = np.add.reduceat(values, starts) / counts[used]
    return means, used


def _assign(vectors: F32, leaves: list[_Leaf], threads: int) -> Index:
    """Return each vector's nearest row among the rows of its own and neighbouring leaves."""
    sizes = np.array([len(leaf.rows) for leaf in leaves])
    bases = np.cumsum(sizes) - sizes
    centres = np.stack([leaf.centre for leaf in leaves])
    # A leaf without used rows is excluded as a neighbour.
    centres[sizes == 0] = np.inf
    comparisons = len(vectors) * int(sizes.sum()) / len(leaves)
    neighbours = int(_ROUND_COMPARISONS / comparisons)
    neighbours = min(max(neighbours, _MIN_NEIGHBOURS), _MAX_NEIGHBOURS, len(leaves))
    labels = np.empty(len(vectors), np.intp)

    def search(index: int) -> Index:
        distances = np.square(centres - leaves[index].centre).sum(axis=1)
        near = np.argsort(distances, kind="stable")[:neighbours]
        rows = np.concatenate([leaves[k].rows for k in near])
        names = np.concatenate([np.arange(bases[k], bases[k] + sizes[k]) for k in near])
        found: Index = names[_nearest_row(vectors[leaves[index].members], rows)]
        return found

    results = ordered_map(search, range(len(leaves)), threads)
    for leaf, found in zip(leaves, results, strict=True):
        labels[leaf.members] = found
    return labels


def _update_rows(leaves: list[_Leaf], palette: F32, used: NDArray[np.bool_]) -> list[_Leaf]:
    """Return leaves with the rows of a new palette.

    Parameters
    ----------
    leaves : list of _Leaf
        Leaves with their previous rows.
    palette : (C, d) float32
        New rows, leaf by leaf; unused rows are missing.
    used : (r,) bool
        Mask of the previous rows, leaf by leaf, that are in the new palette.
    """
    updated, base, start = [], 0, 0
    for leaf in leaves:
        stop = start + int(used[base : base + len(leaf.rows)].sum())
        updated.append(replace(leaf, rows=palette[start:stop]))
        base, start = base + len(leaf.rows), stop
    return updated
