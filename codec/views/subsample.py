"""Subsamples: a few thousand splats that stand for a scene, its surfaces still closed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

MAX_LOG_SCALE: Final = 40.0
"""Log scales are taken as within ± this, so that squares of distances stay finite."""

# Share of a subsample that the scene's largest splats may take. They are few and cover the large
# surfaces.
_LARGEST_SHARE: Final = 0.125
# Splats along the spatial order, the middle one included, over which the size is averaged. A single
# splat may be a needle or a speck; the mean of its neighbourhood tells how close the capture was.
_NEIGHBOURS: Final = 33


@dataclass(frozen=True, eq=False)
class Subsample:
    """A scene thinned to M splats.

    Parameters
    ----------
    splats : Splats
        M splats of SH degree 0, in `spatial_order`.
    counts : (M,) float64
        How many of the scene's splats each stands for.
    sizes : (M,) float64
        Typical size of the scene's splats around each, scene units: the geometric mean, over 33
        neighbours, of the two larger standard deviations.
    """

    splats: Splats
    counts: F64
    sizes: F64

    def __len__(self) -> int:
        return len(self.splats)


def subsample(splats: Splats, most: int) -> Subsample:
    """Thin a scene to at most `most` splats.

    Parameters
    ----------
    splats : Splats
        At least one row, all finite.
    most : int
        At least 8 where the scene has more splats.

    Returns
    -------
    Subsample
        The largest splats, an eighth of `most`, unchanged. Of the others every k-th along
        `spatial_order`, enlarged to k times its area. The same for the same scene.
    """
    bare = splats.without_extras().with_sh_degree(0)
    bare = bare.take(spatial_order(bare.means))
    log_sizes = _log_sizes(bare.scales)
    local = _moving_mean(log_sizes)
    n = len(bare)
    if n <= most:
        return Subsample(bare, np.ones(n), np.exp(local))
    num_largest = int(most * _LARGEST_SHARE)
    by_size = np.argsort(-log_sizes, kind="stable")
    rest = np.sort(by_size[num_largest:])
    num_rest = most - num_largest
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
    """Return means over windows of `_NEIGHBOURS`, which are shorter at both ends: (N,)."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    place = np.arange(len(values))
    first = np.maximum(place - _NEIGHBOURS // 2, 0)
    last = np.minimum(place + _NEIGHBOURS // 2 + 1, len(values))
    means: F64 = (total[last] - total[first]) / (last - first)
    return means
