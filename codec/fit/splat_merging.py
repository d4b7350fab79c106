"""Merging of similar neighbouring splats into one splat with the same moments."""

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

# Maximum distance of a pair: Bhattacharyya distance plus weighted colour difference. Measured on a
# captured room reduced from 27,727 to 22,181 splats, PSNR of held-out views at once and after 60
# training steps: 37.9 and 39.1 dB; 35.3 and 38.8 dB with deletion alone. After training, a maximum
# of 0.3 gives few pairs and 38.8 dB; no maximum gives 38.9 dB; pairs among all splats 38.1 dB.
_MAX_DISTANCE: Final = 1.5
_COLOUR_WEIGHT: Final = 2.0
# Share of the splats, those with the smallest deletion errors, that may be merged into another.
_REMOVABLE_SHARE: Final = 0.5
# Number of nearest neighbours that a splat may be merged into.
_NEIGHBOURS: Final = 8
# Range of opacities of merged splats: the smallest alpha that is drawn, and the cap of 3DGS.
_OPACITY_RANGE: Final = (1.0 / 255.0, 0.99)
# Bounds that keep covariance matrices regular: the absolute value of log scales, and the variance
# of an axis relative to the trace.
_MAX_LOG_SCALE: Final = 40.0
_MIN_VARIANCE_SHARE: Final = 1e-9


def covariances(splats: Splats) -> F64:
    """Return the (N, 3, 3) float64 covariances of splats, scene units squared."""
    axes = rotations.matrices(rotations.unit(splats.quats))
    scales = splats.scales.astype(np.float64)
    axes *= np.exp(np.clip(scales, -_MAX_LOG_SCALE, _MAX_LOG_SCALE))[:, None, :]
    covariance: F64 = axes @ axes.transpose(0, 2, 1)
    return covariance


def merge_candidates(splats: Splats, errors: F64, max_pairs: int) -> tuple[I64, I64]:
    """Return disjoint pairs of similar neighbouring splats, most similar first.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    errors : (N,) float64
        Deletion error of each splat. Only the half with the smallest errors may be removed.
    max_pairs : int
        Maximum number of pairs.

    Returns
    -------
    kept, removed : (p,) int64
        Rows of the splats to keep and to remove; no row occurs twice.

    Notes
    -----
    Similarity is the Bhattacharyya distance of the Gaussians plus the difference of their colours.
    """
    # Imported here: decoding needs no scipy.
    from scipy.spatial import cKDTree

    count = len(splats)
    removable = np.sort(np.argsort(errors, kind="stable")[: int(_REMOVABLE_SHARE * count)])
    neighbours = min(_NEIGHBOURS, count - 1)
    if not neighbours or not len(removable):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, found = cKDTree(splats.means).query(splats.means[removable], k=neighbours + 1)
    covariance = covariances(splats)
    colours = C0 * splats.sh0
    distances = np.full(len(removable), np.inf)
    partners = np.full(len(removable), -1, np.int64)
    for column in found.T:
        column_distances = _bhattacharyya(splats.means, covariance, removable, column)
        difference = np.abs(colours[removable] - colours[column]).sum(axis=1)
        column_distances += _COLOUR_WEIGHT * difference
        # With coincident means, a splat need not be its own first neighbour.
        column_distances[column == removable] = np.inf
        nearer = column_distances < distances
        distances[nearer], partners[nearer] = column_distances[nearer], column[nearer]
    used = np.zeros(count, np.bool_)
    pairs: list[tuple[int, int]] = []
    for number in np.argsort(distances, kind="stable").tolist():
        if distances[number] >= _MAX_DISTANCE or len(pairs) == max_pairs:
            break
        kept, removed = int(partners[number]), int(removable[number])
        if not used[kept] and not used[removed]:
            used[kept] = used[removed] = True
            pairs.append((kept, removed))
    rows = np.array(pairs, np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _bhattacharyya(means: F32, covariance: F64, rows: I64, others: I64) -> F64:
    """Return the (n,) Bhattacharyya distances between splats, by pairs of rows."""
    one, other = _regularise(covariance[rows]), _regularise(covariance[others])
    average = (one + other) / 2
    offsets = (means[rows] - means[others]).astype(np.float64)
    solved = np.linalg.solve(average, offsets[:, :, None])[:, :, 0]
    mahalanobis = np.einsum("ni,ni->n", offsets, solved)
    logs = [np.linalg.slogdet(each)[1] for each in (average, one, other)]
    distances: F64 = mahalanobis / 8 + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2]))
    return distances


def _regularise(covariance: F64) -> F64:
    """Return (n, 3, 3) covariances with a small isotropic variance added: none is singular."""
    least = _MIN_VARIANCE_SHARE * np.trace(covariance, axis1=1, axis2=2)
    regular: F64 = covariance + least[:, None, None] * np.eye(3)
    return regular


def merge_pairs(splats: Splats, kept: I64, removed: I64) -> Splats:
    """Return a scene in which the kept splat of each pair stands for both.

    Mean and covariance are those of the mixture of both Gaussians, weighted by opacity times area.
    SH coefficients are weighted means. The opacity preserves the sum of opacity times area.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    kept, removed : (p,) int64
        Pairs from `merge_candidates`.

    Returns
    -------
    Splats
        N splats: the caller deletes the removed ones.
    """
    logits = splats.opacities.astype(np.float64)
    scales = np.clip(splats.scales.astype(np.float64), -_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    areas = np.exp(2.0 / 3.0 * scales.sum(axis=1))
    masses = areas / (1.0 + np.exp(-logits))
    total = masses[kept] + masses[removed]
    weights = masses[kept] / total, masses[removed] / total
    covariance = covariances(splats)

    def mean(values: F32) -> F64:
        wide = values.astype(np.float64)
        by_row = [weight.reshape(-1, *[1] * (values.ndim - 1)) for weight in weights]
        both: F64 = by_row[0] * wide[kept] + by_row[1] * wide[removed]
        return both

    means = mean(splats.means)
    mixture = np.zeros((len(kept), 3, 3))
    for weight, rows in zip(weights, (kept, removed), strict=True):
        offsets = splats.means[rows] - means
        outer = offsets[:, :, None] * offsets[:, None, :]
        mixture += weight[:, None, None] * (covariance[rows] + outer)
    variances, quats = principal_axes(_regularise(mixture))
    scales = 0.5 * np.log(variances)
    opacities = np.clip(total / np.exp(2.0 / 3.0 * scales.sum(axis=1)), *_OPACITY_RANGE)
    values = {name: getattr(splats, name).copy() for name in Gradients.names()}
    merged = {
        "means": means,
        "scales": scales,
        "quats": quats,
        "opacities": np.log(opacities / (1.0 - opacities)),
        "sh0": mean(splats.sh0),
        "shN": mean(splats.shN),
    }
    for name, merged_values in merged.items():
        values[name][kept] = merged_values
    return with_values(splats, values)
