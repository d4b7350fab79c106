"""Floaters: isolated splats that contribute little to the views."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

NEIGHBOURS: Final = 16
"""Number of nearest splats whose mean distance measures a splat's isolation."""

# Ratio of standard deviation to median absolute deviation of a normal distribution.
_NORMAL_MAD: Final = 1.4826


def neighbour_distances(means: NDArray[np.float32], threads: int = 0) -> F64:
    """Return the mean distance of each splat to its `NEIGHBOURS` nearest splats.

    Parameters
    ----------
    means : (N, 3) float32
        Finite centres, scene units.
    threads : int
        Number of threads; 0 for all cores. The result does not depend on it.

    Returns
    -------
    (N,) float64
        Distances, scene units; 0 in a scene of one splat.
    """
    from scipy.spatial import cKDTree

    others = min(NEIGHBOURS, len(means) - 1)
    if others < 1:
        return np.zeros(len(means))
    points = means.astype(np.float64)
    distances, _ = cKDTree(points).query(points, k=others + 1, workers=threads or -1)
    # The first neighbour is the splat itself, or one at the same position.
    found: F64 = distances[:, 1:].mean(axis=1)
    return found


def floaters(
    means: NDArray[np.float32], contribution: F64, deviations: float, *, threads: int = 0
) -> NDArray[np.bool_]:
    """Return a mask of splats that are isolated and contribute less than the median splat.

    Parameters
    ----------
    means : (N, 3) float32
        Finite centres, scene units.
    contribution : (N,) float64
        Contribution of each splat (`Scores.contribution`).
    deviations : float
        Threshold of isolation, in standard deviations of the log neighbour distance above the
        scene's median. The standard deviation is estimated from the median absolute deviation.
        Logarithms are used because distances in trained scenes span orders of magnitude.
    threads : int
        Number of threads; 0 for all cores. The result does not depend on it.

    Returns
    -------
    (N,) bool

    Notes
    -----
    This is the statistical outlier removal of Rusu et al. (2008). By distance alone it would remove
    the background of captured scenes, which is sparse and visible in every view; therefore the
    contribution counts too.
    """
    if not len(means):
        return np.zeros(0, bool)
    distances = neighbour_distances(means, threads)
    apart = distances > 0
    if not apart.any():
        return apart
    logs = np.log(np.where(apart, distances, 1.0))
    centre = float(np.median(logs[apart]))
    spread = _NORMAL_MAD * float(np.median(np.abs(logs[apart] - centre)))
    isolated = apart & (logs > centre + deviations * spread)
    marked: NDArray[np.bool_] = isolated & (contribution < np.median(contribution))
    return marked
