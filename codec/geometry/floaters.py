"""Floaters: splats that lie apart from all others and that the views hardly need."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

NEIGHBOURS: Final = 16
"""Nearest splats whose mean distance says how far apart a splat lies."""

# The median absolute deviation of a normal distribution, times this, is its standard deviation.
_NORMAL_MAD: Final = 1.4826


def neighbour_distances(means: NDArray[np.float32], threads: int = 0) -> F64:
    """Return the mean distance of each splat to its `NEIGHBOURS` nearest, or to all if fewer.

    Parameters
    ----------
    means : (N, 3) float32
        Centres, finite, scene units.
    threads : int
        0 for all cores. The result does not depend on it.

    Returns
    -------
    (N,) float64
        Scene units; zero where there is one splat only.
    """
    from scipy.spatial import cKDTree

    others = min(NEIGHBOURS, len(means) - 1)
    if others < 1:
        return np.zeros(len(means))
    points = means.astype(np.float64)
    distances, _ = cKDTree(points).query(points, k=others + 1, workers=threads or -1)
    # The nearest is the splat itself, or one in the same place.
    found: F64 = distances[:, 1:].mean(axis=1)
    return found


def floaters(
    means: NDArray[np.float32], contribution: F64, deviations: float, *, threads: int = 0
) -> NDArray[np.bool_]:
    """Mark splats that are isolated and contribute less than the median splat.

    Parameters
    ----------
    means : (N, 3) float32
        Centres, finite, scene units.
    contribution : (N,) float64
        Of each splat to the pictures of the views, as `codec.scoring.contribution` has it.
    deviations : float
        A splat is isolated where the logarithm of its neighbour distance exceeds the scene's
        median by so many standard deviations, these estimated from the median absolute deviation.
        Logarithms, because distances in trained scenes span orders of magnitude.
    threads : int
        0 for all cores. The result does not depend on it.

    Returns
    -------
    (N,) bool

    Notes
    -----
    Distances to nearest neighbours against their distribution over the scene are the statistical
    outlier removal of Rusu et al. (2008). By distance alone it would take the background of
    captured scenes, which is sparse and seen in every view; hence the condition on contribution.
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
