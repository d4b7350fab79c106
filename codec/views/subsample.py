"""Subsamples: a scene thinned to a few thousand splats that still close its surfaces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

MAX_LOG_SCALE: Final = 40.0
"""Log scales are clipped to ± this, so that squared distances stay finite."""

# Share of a subsample reserved for the scene's largest splats: few, but they cover large surfaces.
_LARGEST_SHARE: Final = 0.125
# Window, in splats along the spatial order, over which sizes are averaged. A single splat may be a
# needle or a speck; the mean of its neighbourhood shows how close the capturing cameras were.
_NEIGHBOURS: Final = 33


@dataclass(frozen=True, eq=False)
class Subsample:
    """A scene thinned to M splats.

    Parameters
    ----------
    splats : Splats
        M splats of SH degree 0, in `spatial_order`.
    counts : (M,) float64
        Number of the scene's splats that each splat stands for.
    sizes : (M,) float64
        Typical size of the scene's splats around each splat, scene units: the geometric mean, over
        33 neighbours, of the two larger standard deviations.
    """

    splats: Splats
    counts: F64
    sizes: F64

    def __len__(self) -> int:
        return len(self.splats)


def subsample(splats: Splats, max_splats: int) -> Subsample:
    """Thin a scene to at most `max_splats` splats.

    Parameters
    ----------
    splats : Splats
        Splats with finite values only; at least one.
    max_splats : int
        Splats of the subsample at most; at least 8 if the scene has more.

    Returns
    -------
    Subsample
        The largest splats, an eighth of `max_splats`, unchanged; and every k-th of the other splats
        along `spatial_order`, enlarged to k times its area.
    """
    bare = splats.without_extras().with_sh_degree(0)
    bare = bare.take(spatial_order(bare.means))
    log_sizes = _log_sizes(bare.scales)
    local = _moving_mean(log_sizes)
    n = len(bare)
    if n <= max_splats:
        return Subsample(bare, np.ones(n), np.exp(local))
    num_largest = int(max_splats * _LARGEST_SHARE)
    by_size = np.argsort(-log_sizes, kind="stable")
    rest = np.sort(by_size[num_largest:])
    num_rest = max_splats - num_largest
    picked = rest[np.arange(num_rest) * len(rest) // num_rest]
    counts = np.ones(n)
    counts[picked] = len(rest) / num_rest
    rows = np.sort(np.concatenate([by_size[:num_largest], picked]))
    thin, counts = bare.take(rows), counts[rows]
    widening = 0.5 * np.log(counts).astype(np.float32)
    thin = replace(thin, scales=thin.scales + widening[:, None])
    return Subsample(thin, counts, np.exp(local[rows]))


def _log_sizes(scales: NDArray[np.float32]) -> F64:
    """Return the mean of the two larger log scales of each splat: (N,)."""
    ordered = np.sort(scales.astype(np.float64), axis=1)
    sizes: F64 = np.clip(0.5 * (ordered[:, 1] + ordered[:, 2]), -MAX_LOG_SCALE, MAX_LOG_SCALE)
    return sizes


def _moving_mean(values: F64) -> F64:
    """Return the moving mean over `_NEIGHBOURS` values, fewer at both ends: (N,)."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    place = np.arange(len(values))
    first = np.maximum(place - _NEIGHBOURS // 2, 0)
    last = np.minimum(place + _NEIGHBOURS // 2 + 1, len(values))
    means: F64 = (total[last] - total[first]) / (last - first)
    return means
