"""Codebooks of vectors by weighted k-means, independent of the number of threads."""

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

# Vectors per block of the nearest-row search. The distances of a block to 4096 rows take 4 MiB and
# stay in the cache; that is 1.7 times as fast as blocks of 2048.
_BLOCK: Final = 256

# Relative weight below which vectors are ignored: scikit-learn's float32 weights would be 0.
_MIN_WEIGHT: Final = 1e-30


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of codebook training.

    Parameters
    ----------
    iterations : int
        Lloyd iterations at most.
    samples : int
        Maximum number of training vectors, drawn half by weight and half uniformly; bounds the time
        for large scenes.
    seed : int
        Seed of all random choices.
    """

    iterations: int = 12
    samples: int = 120_000
    seed: int = 1


def train(
    vectors: F32,
    weights: F64,
    rows: int,
    config: TrainingConfig | None = None,
) -> F32:
    """Train the codebook of weighted vectors.

    Parameters
    ----------
    vectors : (n, d) float32
        Vectors with magnitudes below 1e15: distances are summed in float32.
    weights : (n,) float64
        Cost of a squared error of each vector, finite and not negative. If all are zero, all
        vectors count equally.
    rows : int
        Codebook rows at most; fewer if fewer distinct vectors have weight.
    config : TrainingConfig, optional
        Settings; None for the defaults.

    Returns
    -------
    (C, d) float32
        Codebook of C ≤ `rows` distinct rows in ascending order. Each row is the nearest of at least
        one training vector.

    Notes
    -----
    scikit-learn's Lloyd iterations, seeded by k-means++ on a sample. They run on one BLAS and
    OpenMP thread, because the centres would depend on the number of threads.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.clustering.kmeans import train
    >>> vectors = np.array([[0, 0], [0, 1], [9, 9], [9, 9]], np.float32)
    >>> train(vectors, np.ones(4), rows=2).tolist()
    [[0.0, 0.5], [9.0, 9.0]]
    """
    # Importing scikit-learn takes a second, and only encoders need it.
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    config = config or TrainingConfig()
    rng = np.random.default_rng(config.seed)
    vectors, weights = _sample(vectors, weights, config.samples, rng)
    if len(vectors) <= rows:
        return np.unique(vectors, axis=0)
    with threadpool_limits(limits=1):
        centres = _seeds(vectors, weights, rows, config.seed, rng)
        model = KMeans(
            len(centres),
            init=np.ascontiguousarray(centres),
            n_init=1,
            max_iter=config.iterations,
            tol=0,
            random_state=config.seed,
            algorithm="lloyd",
        )
        _ignore_duplicate_rows(lambda: model.fit(vectors, sample_weight=weights))
    used = np.unique(model.labels_)
    return np.unique(model.cluster_centers_[used].astype(np.float32), axis=0)


def _seeds(vectors: F32, weights: F64, rows: int, seed: int, rng: np.random.Generator) -> F32:
    """Choose initial codebook rows by k-means++ among a weighted sample of the vectors."""
    from sklearn.cluster import kmeans_plusplus

    # Seeding time is proportional to rows times vectors; a sample of eight times the rows gives
    # equally good seeds.
    seeds = min(len(vectors), max(8 * rows, 4096))
    chosen = rng.choice(len(vectors), seeds, replace=False, p=weights / weights.sum())
    centres, _ = kmeans_plusplus(
        vectors[chosen], rows, sample_weight=weights[chosen], random_state=seed, n_local_trials=1
    )
    found: F32 = centres
    return found


def _ignore_duplicate_rows(work: Callable[[], object]) -> None:
    """Run `work` without its warning of duplicate rows, which `train` drops itself."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        work()


def _sample(vectors: F32, weights: F64, samples: int, rng: np.random.Generator) -> tuple[F32, F64]:
    """Return a random sample of at most `samples` vectors, with weights that keep sums unbiased."""
    top = float(weights.max(initial=0.0))
    weights = weights / top if top > 0 else np.ones(len(vectors))
    keep = np.flatnonzero(weights >= _MIN_WEIGHT)
    if len(keep) <= samples:
        return vectors[keep], weights[keep]
    # Half by weight, half uniformly: heavy vectors shape most rows, light vectors still get a few.
    share = weights[keep] / weights[keep].sum()
    probability = 0.5 * share + 0.5 / len(keep)
    chosen = np.sort(rng.choice(len(keep), samples, replace=False, p=probability))
    rows = keep[chosen]
    return vectors[rows], weights[rows] / probability[chosen]


def nearest(vectors: F32, rows: F32, threads: int = 0) -> tuple[U32, F64]:
    """Return each vector's nearest row and its squared distance.

    Parameters
    ----------
    vectors : (n, d) float32
        Vectors to look up.
    rows : (C, d) float32
        Codebook.
    threads : int
        Number of threads; 0 for all cores. The result does not depend on it.

    Returns
    -------
    indices : (n,) uint32
        Number of the nearest row.
    errors : (n,) float64
        Squared distance to that row.
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
        # The expanded square used above suffers from cancellation.
        difference = block.astype(np.float64) - rows[best]
        errors[start : start + _BLOCK] = np.square(difference).sum(axis=1)

    with threadpool_limits(limits=1):
        for _ in ordered_map(search, range(0, len(vectors), _BLOCK), num_threads):
            pass
    return indices, errors
