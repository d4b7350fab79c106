"""Pairs: splats that one splat can stand for, by the moments of both."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import rotations
from cogsplat.codec.geometry.covariance import principal_axes
from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients, with_values

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Measured on a captured room, of whose 27,727 splats 22,181 are left: only deleting them, pictures
# in other views have 35.3 dB at once and 38.8 after 60 steps of training; with the pairs of these
# constants 37.9 and 39.1. Up to a difference of 0.3 in place of 1.5 there are few pairs (38.8 dB);
# with any difference, or with pairs among all splats, there is less (38.9 and 38.1).
_MOST_DIFFERENT: Final = 1.5
_COLOUR_WEIGHT: Final = 2.0
# Splats whose deletion costs more than that of so many of all are not given up.
_GIVEN_UP: Final = 0.5
# Neighbours that a splat may be merged with.
_NEIGHBOURS: Final = 8
# Alphas of merged splats: above what is ever drawn, and as 3DGS caps them.
_ALPHAS: Final = (1.0 / 255.0, 0.99)
# Log scales beyond these count as these, and axes as no thinner than this share of the Gaussian's
# size, squared: matrices stay regular.
_MOST_SCALE: Final = 40.0
_THINNEST: Final = 1e-9


def covariances(splats: Splats) -> F64:
    """Return the (N, 3, 3) float64 covariances of splats, scene units squared."""
    axes = rotations.matrices(rotations.unit(splats.quats))
    scales = splats.scales.astype(np.float64)
    axes *= np.exp(np.clip(scales, -_MOST_SCALE, _MOST_SCALE))[:, None, :]
    spread: F64 = axes @ axes.transpose(0, 2, 1)
    return spread


def merge_candidates(splats: Splats, errors: F64, most: int) -> tuple[I64, I64]:
    """Return pairs of neighbouring splats that look alike, the likest first.

    Parameters
    ----------
    splats : Splats
        N of them.
    errors : (N,) float64
        What the pictures lose without each of them: those that cost least may be given up.
    most : int
        Pairs at most.

    Returns
    -------
    kept, given_up : (p,) int64
        Rows of each pair; every row stands in one pair at most.

    Notes
    -----
    How different two splats are is the Bhattacharyya distance of their Gaussians, and the
    difference of their colours.
    """
    # Imported here: decoding needs no scipy.
    from scipy.spatial import cKDTree

    count = len(splats)
    low = np.sort(np.argsort(errors, kind="stable")[: int(_GIVEN_UP * count)])
    near = min(_NEIGHBOURS, count - 1)
    if not near or not len(low):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, found = cKDTree(splats.means).query(splats.means[low], k=near + 1)
    spread = covariances(splats)
    colours = C0 * splats.sh0
    different = np.full(len(low), np.inf)
    others = np.full(len(low), -1, np.int64)
    for column in found.T:
        off = _different(splats.means, spread, low, column)
        off += _COLOUR_WEIGHT * np.abs(colours[low] - colours[column]).sum(axis=1)
        # Splats in one place may come before the splat itself.
        off[column == low] = np.inf
        nearer = off < different
        different[nearer], others[nearer] = off[nearer], column[nearer]
    taken = np.zeros(count, np.bool_)
    chosen: list[tuple[int, int]] = []
    for number in np.argsort(different, kind="stable").tolist():
        if different[number] >= _MOST_DIFFERENT or len(chosen) == most:
            break
        kept, given_up = int(others[number]), int(low[number])
        if not taken[kept] and not taken[given_up]:
            taken[kept] = taken[given_up] = True
            chosen.append((kept, given_up))
    rows = np.array(chosen, np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _different(means: F32, spread: F64, rows: I64, others: I64) -> F64:
    """Return the (n,) Bhattacharyya distances of Gaussians and their neighbours."""
    one, other = _regular(spread[rows]), _regular(spread[others])
    middle = (one + other) / 2
    off = (means[rows] - means[others]).astype(np.float64)
    apart = np.einsum("ni,ni->n", off, np.linalg.solve(middle, off[:, :, None])[:, :, 0])
    logs = [np.linalg.slogdet(each)[1] for each in (middle, one, other)]
    distances: F64 = apart / 8 + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2]))
    return distances


def _regular(spread: F64) -> F64:
    """Return (n, 3, 3) covariances of which none is singular."""
    least = _THINNEST * np.trace(spread, axis1=1, axis2=2)
    regular: F64 = spread + least[:, None, None] * np.eye(3)
    return regular


def merge_pairs(splats: Splats, kept: I64, given_up: I64) -> Splats:
    """Return a scene in which splats stand for others as well.

    Mean and covariance are those of both Gaussians together, each counted by its opacity and its
    area; SH coefficients are their means; the opacity is what keeps the sum of opacity and area.

    Parameters
    ----------
    splats : Splats
    kept, given_up : (p,) int64
        As `pairs` returns them.

    Returns
    -------
    Splats
        As many as before: those that were given up are still there.
    """
    logits = splats.opacities.astype(np.float64)
    scales = np.clip(splats.scales.astype(np.float64), -_MOST_SCALE, _MOST_SCALE)
    areas = np.exp(2.0 / 3.0 * scales.sum(axis=1))
    masses = areas / (1.0 + np.exp(-logits))
    total = masses[kept] + masses[given_up]
    shares = masses[kept] / total, masses[given_up] / total
    spread = covariances(splats)

    def mean(values: F32) -> F64:
        wide = values.astype(np.float64)
        by_row = [share.reshape(-1, *[1] * (values.ndim - 1)) for share in shares]
        both: F64 = by_row[0] * wide[kept] + by_row[1] * wide[given_up]
        return both

    means = mean(splats.means)
    both = np.zeros((len(kept), 3, 3))
    for share, rows in zip(shares, (kept, given_up), strict=True):
        off = splats.means[rows] - means
        both += share[:, None, None] * (spread[rows] + off[:, :, None] * off[:, None, :])
    variances, quats = principal_axes(_regular(both))
    scales = 0.5 * np.log(variances)
    alphas = np.clip(total / np.exp(2.0 / 3.0 * scales.sum(axis=1)), *_ALPHAS)
    values = {name: getattr(splats, name).copy() for name in Gradients.names()}
    found = {
        "means": means,
        "scales": scales,
        "quats": quats,
        "opacities": np.log(alphas / (1.0 - alphas)),
        "sh0": mean(splats.sh0),
        "shN": mean(splats.shN),
    }
    for name, rows_of in found.items():
        values[name][kept] = rows_of
    return with_values(splats, values)
