"""K-means of few rows over vectors of few dimensions, the same for any number of threads."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_ROUNDS: Final = 12

# Vectors that rows are trained on at most: every so many-th, in the order given.
_SAMPLE: Final = 4096

# Rows begin at the vector that is further than this share of all from the rows before it. The very
# furthest are strays.
_FAR: Final = 0.97


def train(vectors: F64, rows: int) -> F64:
    """Return codebook rows for vectors, each counting the same.

    Parameters
    ----------
    vectors : (n, d) float64
        At least one.
    rows : int
        At least one.

    Returns
    -------
    (rows, d) float64
        The first begins at zero; a row that no vector is nearest to stays where it began.
    """
    sample = vectors[:: max(1, len(vectors) // _SAMPLE)]
    # Begin with rows far from one another.
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
    """Return the number of the nearest row of a codebook for each vector, the first of equals.

    Parameters
    ----------
    vectors : (n, d) float64
    book : (rows, d) float64

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
