"""Farthest-first choice: some of many points, spread as evenly as they allow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def farthest_first(points: NDArray[np.float64], count: int, first: int = 0) -> list[int]:
    """Choose points, each as far as possible from all points that are chosen before it.

    Parameters
    ----------
    points : (n, d) float64
        Points to choose from.
    count : int
        Number of points at most.
    first : int
        Row of the first point.

    Returns
    -------
    list of int
        Different rows in the order of choice; of equally far points, the earlier row comes first.

    Notes
    -----
    Gonzalez, Clustering to minimize the maximum intercluster distance (1985).

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.farthest_first import farthest_first
    >>> farthest_first(np.array([[0.0], [1.0], [5.0], [3.0]]), 3)
    [0, 2, 3]
    """
    chosen: list[int] = []
    nearest = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        row = int(nearest.argmax()) if chosen else first
        chosen.append(row)
        nearest = np.minimum(nearest, np.linalg.norm(points - points[row], axis=1))
        nearest[row] = -1.0
    return chosen
