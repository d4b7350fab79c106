"""Codebooks: weighted k-means without dead rows, the same rows for any number of threads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.threads import ordered_map, thread_count

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U32 = NDArray[np.uint32]

# Vectors per block of the nearest-row search: its distances to 4096 rows take 4 MiB and stay in
# the cache, which is 1.7 times as fast as blocks of 2048.
_BLOCK: Final = 256

# Vectors of less than this share of the largest weight are left out: scikit-learn weighs in
# float32, where less is nothing.
_LEAST_WEIGHT: Final = 1e-30


@dataclass(frozen=True)
class TrainingConfig:
    """How codebooks are trained.

    Parameters
    ----------
    iterations : int
        Lloyd iterations at most.
    samples : int
        Vectors trained on at most, so that the time does not grow with the scene; drawn by weight.
    seed : int
    """

    iterations: int = 12
    samples: int = 120_000
    seed: int = 1


def train(vectors: F32, weights: F64, rows: int, config: TrainingConfig | None = None) -> F32:
    """Return codebook rows for weighted vectors.

    Parameters
    ----------
    vectors : (n, d) float32
        Magnitudes below 1e15: distances are summed in float32.
    weights : (n,) float64
        What a squared error of each costs, finite and not negative; all count the same where all
        are zero.
    rows : int
        Most rows; fewer come back where fewer distinct vectors carry weight.
    config : TrainingConfig, optional

    Returns
    -------
    (C, d) float32
        C ≤ `rows`, every row used by at least one training vector; ascending, none twice.

    Notes
    -----
    scikit-learn's Lloyd k-means under one BLAS and OpenMP thread: its centres differ with the
    number of threads. Seeded by k-means++ on a sample, refilled where rows died.
    """
    # scikit-learn costs a second to import and is needed by encoders only.
    from sklearn.cluster import KMeans, kmeans_plusplus
    from threadpoolctl import threadpool_limits

    config = config or TrainingConfig()
    rng = np.random.default_rng(config.seed)
    vectors, weights = _sample(vectors, weights, config.samples, rng)
    if len(vectors) <= rows:
        return np.unique(vectors, axis=0)
    with threadpool_limits(limits=1):
        # Seeding is quadratic in rows times vectors: a sample a few times the rows is as good.
        seeds = min(len(vectors), max(8 * rows, 4096))
        chosen = rng.choice(len(vectors), seeds, replace=False, p=weights / weights.sum())
        centres, _ = kmeans_plusplus(
            vectors[chosen],
            rows,
            sample_weight=weights[chosen],
            random_state=config.seed,
            n_local_trials=1,
        )
        model = KMeans(
            len(centres),
            init=np.ascontiguousarray(centres),
            n_init=1,
            max_iter=config.iterations,
            tol=0,
            random_state=config.seed,
            algorithm="lloyd",
        )
        _without_warnings(lambda: model.fit(vectors, sample_weight=weights))
    used = np.unique(model.labels_)
    return np.unique(model.cluster_centers_[used].astype(np.float32), axis=0)


def _without_warnings(work: Callable[[], object]) -> None:
    """Run `work`; of duplicate vectors scikit-learn warns, and the caller drops their rows."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        work()


def _sample(vectors: F32, weights: F64, samples: int, rng: np.random.Generator) -> tuple[F32, F64]:
    top = float(weights.max(initial=0.0))
    weights = weights / top if top > 0 else np.ones(len(vectors))
    keep = np.flatnonzero(weights >= _LEAST_WEIGHT)
    if len(keep) <= samples:
        return vectors[keep], weights[keep]
    # Half by weight, half evenly: heavy vectors shape the rows, light ones still have some.
    share = weights[keep] / weights[keep].sum()
    probability = 0.5 * share + 0.5 / len(keep)
    chosen = np.sort(rng.choice(len(keep), samples, replace=False, p=probability))
    rows = keep[chosen]
    return vectors[rows], weights[rows] / probability[chosen]


def nearest(vectors: F32, rows: F32, threads: int = 0) -> tuple[U32, F64]:
    """Return the index of and the squared distance to the nearest row of each vector.

    Parameters
    ----------
    vectors : (n, d) float32
    rows : (C, d) float32
    threads : int
        0 for all cores; the result does not depend on it.

    Returns
    -------
    indices : (n,) uint32
    errors : (n,) float64
    """
    from threadpoolctl import threadpool_limits

    num_threads = thread_count(threads)
    indices = np.empty(len(vectors), np.uint32)
    errors = np.empty(len(vectors), np.float64)
    norms = np.square(rows).sum(axis=1)
    transposed = np.ascontiguousarray(rows.T)

    def search(start: int) -> None:
        block = vectors[start : start + _BLOCK]
        best = (norms - 2 * (block @ transposed)).argmin(axis=1)
        indices[start : start + _BLOCK] = best
        # The distance itself, not the expanded square, which cancels.
        difference = block.astype(np.float64) - rows[best]
        errors[start : start + _BLOCK] = np.square(difference).sum(axis=1)

    with threadpool_limits(limits=1):
        for _ in ordered_map(search, range(0, len(vectors), _BLOCK), num_threads):
            pass
    return indices, errors
