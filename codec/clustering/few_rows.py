"""K-means for codebooks of few rows and dimensions, independent of the number of threads."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_ROUNDS: Final = 12

# Approximate number of training vectors; larger sets are thinned to every n-th vector.
_SAMPLE: Final = 4096

# A row starts at the vector at this quantile of the distance from the rows before it. The most
# distant vectors are outliers.
_FAR: Final = 0.97


def train(vectors: F64, rows: int) -> F64:
    """Train a codebook on unweighted vectors by Lloyd iterations.

    Parameters
    ----------
    vectors : (n, d) float64
        Vectors, at least one.
    rows : int
        Number of codebook rows, at least one.

    Returns
    -------
    (rows, d) float64
        Codebook. The first row is initialised with zeros, the others with distant vectors. A row
        that is nearest to no vector stays unchanged in that iteration.
    """
    sample = vectors[:: max(1, len(vectors) // _SAMPLE)]
    # Start with distant rows.
    centres = [np.zeros(vectors.shape[1])]
    distance = np.full(len(sample), np.inf)
    for _ in range(rows - 1):
        distance = np.minimum(distance, ((sample - centres[-1]) ** 2).sum(axis=1))
        far = np.argsort(distance, kind="stable")[int(_FAR * (len(distance) - 1))]
        centres.append(sample[far])
    book = np.array(centres)
    for _ in range(_ROUNDS):
        labels = nearest(sample, book)
        counts = np.bincount(labels, minlength=rows)
        for axis in range(vectors.shape[1]):
            sums = np.bincount(labels, sample[:, axis], minlength=rows)
            book[:, axis] = np.where(counts > 0, sums / np.maximum(counts, 1), book[:, axis])
    return book


def nearest(vectors: F64, book: F64) -> I64:
    """Return the number of the nearest codebook row of each vector; ties go to the first row.

    Parameters
    ----------
    vectors : (n, d) float64
        Vectors to look up.
    book : (rows, d) float64
        Codebook.

    Returns
    -------
    (n,) int64
    """
    least = np.full(len(vectors), np.inf)
    labels = np.zeros(len(vectors), np.int64)
    for row, centre in enumerate(book):
        distance = ((vectors - centre) ** 2).sum(axis=1)
        closer = distance < least
        least[closer] = distance[closer]
        labels[closer] = row
    return labels
