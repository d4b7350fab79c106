"""Visibility ratios: a chunk's share of the current picture over its average share.

Specified in docs/streaming.md, sections 4 to 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.view_shares import ViewTable

from .box_projections import (
    centre_depths,
    centres,
    intersects_frustum,
    panorama_coverage,
    screen_coverage,
    squared_radii,
)
from .poses import Pose

F64 = NDArray[np.float64]

MIN_RATIO: Final = 1.0 / 512.0
"""Lower bound of ratios: invisible chunks are fetched after visible ones, but are fetched."""

MIN_AVERAGE_SHARE: Final = 1e-12
"""Lower bound of a chunk's share of the total contribution; avoids division by 0."""

# Added to the difference of a viewpoint, so that its weight stays finite.
_LEAST_DIFFERENCE: Final = 0.01
# Weight of the average of the scored views: that of a viewpoint whose difference is 0.5.
_AVERAGE_WEIGHT: Final = 8.0
# Lower bound of half the diagonal of a box, scene units.
_MIN_RADIUS: Final = 1e-9
# Lower bound of depths, the near plane of 3DGS, scene units.
_MIN_DEPTH: Final = 0.2
# SGSS (Zhu et al., MMSys 2025): boxes of lower density always have low priority, splats per cubic
# scene unit. The paper does not state the constant that keeps its distance from 0.
_MIN_DENSITY: Final = 10.0
_EPSILON: Final = 1e-6

PoseValues = Callable[[Pose], F64]
"""Function from a pose to a number for each chunk, (c,) float64: visibility, or its ratio."""


def ordered_sum(values: F64) -> float:
    """Return the sum of values, added from the first to the last (docs/streaming.md, 1)."""
    return float(np.cumsum(values)[-1]) if len(values) else 0.0


def weighted_ratios(ratios: PoseValues, poses: Sequence[tuple[Pose, float]]) -> F64:
    """Return the weighted sum of the ratios at several poses (docs/streaming.md, 7).

    Parameters
    ----------
    ratios : PoseValues
    poses : sequence of (Pose, float)
        Poses with their weights (`poses.predicted_poses`); added in this order.

    Returns
    -------
    (c,) float64
    """
    pose, weight = poses[0]
    out = ratios(pose) * weight
    for pose, weight in poses[1:]:
        out = out + ratios(pose) * weight
    return out


def visibility_ratios(visibility: F64, contribution: F64) -> F64:
    """Divide each chunk's share of the visibility by its share of the contribution (section 4).

    Parameters
    ----------
    visibility : (c,) float64
        Visibility of each chunk in one picture, any unit, at least 0.
    contribution : (c,) float64
        Stored contribution of each chunk; only proportions matter.

    Returns
    -------
    (c,) float64
        At least `MIN_RATIO`; 1 for all chunks if either input sums to 0.
    """
    return ratios_of_sums(
        visibility, contribution, ordered_sum(visibility), ordered_sum(contribution)
    )


def ratios_of_sums(
    visibility: F64, contribution: F64, total_visibility: float, total_contribution: float
) -> F64:
    """Return ratios for known sums of visibility and contribution (docs/streaming.md, 4)."""
    if not total_visibility > 0.0 or not total_contribution > 0.0:
        return np.ones(len(visibility))
    average = np.maximum(contribution / total_contribution, MIN_AVERAGE_SHARE)
    return np.maximum(visibility / total_visibility / average, MIN_RATIO)


def ratios_from_boxes(boxes: F64, contribution: F64) -> PoseValues:
    """Return the ratio function of one index without a view table (`visibility_of_boxes`)."""
    visibility = visibility_of_boxes(boxes, contribution)
    return lambda pose: visibility_ratios(visibility(pose), contribution)


def ratios_from_view_table(table: ViewTable, boxes: F64, contribution: F64) -> PoseValues:
    """Return the ratio function of one index with a view table (`visibility_of_view_table`)."""
    visibility = visibility_of_view_table(table, boxes, contribution)
    return lambda pose: visibility_ratios(visibility(pose), contribution)


def visibility_of_boxes(boxes: F64, contribution: F64) -> PoseValues:
    """Return the visibility function for an index without a view table (docs/streaming.md, 5).

    Visibility is in the unit of contributions; `IndexRatios` converts it to shares of a picture.
    A box in the frustum has contribution × (μ + ρ) ÷ (depth² + ρ): ρ is its squared half diagonal,
    μ the median of ρ.

    Parameters
    ----------
    boxes : (c, 6) float64
        Bounding box of each chunk: minimum, maximum, scene units.
    contribution : (c,) float64
        Stored contribution of each chunk.
    """
    radii = squared_radii(boxes)
    usual = np.sort(radii)[(len(radii) - 1) // 2] if len(radii) else 0.0

    def visibility(pose: Pose) -> F64:
        depth = np.maximum(centre_depths(boxes, pose), _MIN_DEPTH)
        is_visible = screen_coverage(boxes, pose) > 0.0
        return np.where(is_visible, contribution * (usual + radii) / (depth * depth + radii), 0.0)

    return visibility


def visibility_of_view_table(table: ViewTable, boxes: F64, contribution: F64) -> PoseValues:
    """Return the visibility function that interpolates a view table (docs/streaming.md, 4).

    Visibility is an estimated share of the picture. A viewpoint counts the more, the less it
    differs from the pose: by their distance ÷ the sum of their distances from the box. One more
    viewpoint has the average of the scored views, for chunks that no viewpoint near the pose sees.

    Parameters
    ----------
    table : ViewTable
    boxes : (c, 6) float64
        Bounding box of each chunk: minimum, maximum, scene units.
    contribution : (c,) float64
        Stored contribution of each chunk.
    """
    positions = table.positions.astype(np.float64)
    shares = table.shares.astype(np.float64)
    # A box covers at least the share that its chunk has.
    coverages = np.maximum([panorama_coverage(boxes, position) for position in positions], shares)
    seen = ordered_sum(np.array([ordered_sum(row) for row in shares])) / len(positions)
    average = contribution * (seen / (ordered_sum(contribution) or 1.0))
    covered = np.maximum(np.cumsum(coverages, axis=0)[-1] / len(positions), average)
    shares, coverages = np.vstack([shares, average]), np.vstack([coverages, covered])
    # Their roots: a viewpoint at the box would otherwise outweigh those that see it from the side
    # of the pose.
    extents = np.sqrt(coverages)
    shown = shares / np.where(extents > 0.0, extents, 1.0)
    middles = centres(boxes)
    radii = np.maximum(np.sqrt(squared_radii(boxes)), _MIN_RADIUS)
    reach = np.stack([_distances(position, middles) + radii for position in positions])

    def visibility(pose: Pose) -> F64:
        found = screen_coverage(boxes, pose)
        # The visibility of the others is 0.
        chunks = np.flatnonzero(found > 0.0)
        moved = _distances(pose.position, positions)[:, None]
        away = _distances(pose.position, middles[chunks])
        closeness = 1.0 / (moved / (away + reach[:, chunks]) + _LEAST_DIFFERENCE)
        weights = closeness * closeness * closeness
        weights = np.vstack([weights, np.full(len(chunks), _AVERAGE_WEIGHT)])
        # Sums over the viewpoints from the first to the last (docs/streaming.md, 1).
        visible, covered = (
            np.cumsum(of[:, chunks] * weights, axis=0)[-1] for of in (shown, extents)
        )
        found[chunks] = found[chunks] * (visible / np.where(covered > 0.0, covered, 1.0))
        return found

    return visibility


def sgss_priorities(boxes: F64, splats: F64) -> PoseValues:
    """Return the function for SGSS' priorities PW, used in place of ratios (docs/streaming.md, 6).

    Parameters
    ----------
    boxes : (c, 6) float64
        Bounding box of each chunk: minimum, maximum, scene units.
    splats : (c,) float64
        Splat count of each chunk.
    """
    size = np.maximum(boxes[:, 3:] - boxes[:, :3], 1e-9)
    density = splats / (size[:, 0] * size[:, 1] * size[:, 2])

    def ratios(pose: Pose) -> F64:
        depth = np.maximum(centre_depths(boxes, pose), 0.0) + _EPSILON
        priority = density * screen_coverage(boxes, pose) / depth
        priority = np.where(density < _MIN_DENSITY, density * _EPSILON, priority)
        return np.where(intersects_frustum(boxes, pose), priority, 0.0)

    return ratios


def visible_splat_counts(splats: NDArray[np.int64], ratios: F64) -> NDArray[np.int64]:
    """Reduce the splat counts of chunks that show little, for compensation (section 10).

    Parameters
    ----------
    splats : (c,) int64
        Splat count of each chunk.
    ratios : (c,) float64
        Visibility ratios at the pose of the picture.

    Returns
    -------
    (c,) int64
        Up to the chunk's splat count; reduced where the ratio is below 1, to 0 for chunks that
        hardly show.
    """
    counts: NDArray[np.int64] = np.floor(splats * np.minimum(ratios * ratios, 1.0)).astype(np.int64)
    return counts


def _distances(point: F64, points: F64) -> F64:
    """Return the distances of (v, 3) points from one, (v,)."""
    away = point - points
    squares = away * away
    distances: F64 = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
    return distances
