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
    screen_coverage,
    squared_radii,
)
from .poses import Pose, cross, dot

F64 = NDArray[np.float64]

MIN_RATIO: Final = 1.0 / 512.0
"""Lower bound of ratios: invisible chunks are fetched after visible ones, but are fetched."""

MIN_AVERAGE_SHARE: Final = 1e-12
"""Lower bound of a chunk's share of the total contribution; avoids division by 0."""

# Tangent of the half field of view that is assumed for viewpoints of the table, both axes.
_VIEWPOINT_TANGENT: Final = 1.0
# Weight of rotation: half a turn counts 0.6, a viewpoint opposite the pose up to 1.
_ROTATION_WEIGHT: Final = 0.3
# Added to the difference of a viewpoint, so that its weight stays finite.
_LEAST_DIFFERENCE: Final = 0.01
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
        Stored contribution of each chunk (mean over the training views).

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

    Visibility is an estimated share of the picture. A viewpoint counts the more, the nearer it is
    to the pose as seen from the chunk (their distance ÷ the sum of their distances from it), and
    the more alike they look.

    Parameters
    ----------
    table : ViewTable
    boxes : (c, 6) float64
        Bounding box of each chunk: minimum, maximum, scene units.
    contribution : (c,) float64
        Stored contribution of each chunk.
    """
    viewpoints = _viewpoints(table)
    shares = table.shares.astype(np.float64)
    # A box covers at least the share that a viewpoint shows, whatever its field of view was.
    coverages = np.maximum([screen_coverage(boxes, view) for view in viewpoints], shares)
    # Their roots: a viewpoint at the box would otherwise outweigh those that see it from the side
    # of the pose.
    extents = np.sqrt(coverages)
    shown = shares / np.where(extents > 0.0, extents, 1.0)
    positions = np.stack([view.position for view in viewpoints])
    forwards = np.stack([view.rotation[2] for view in viewpoints])
    middles = centres(boxes)
    radii = np.maximum(np.sqrt(squared_radii(boxes)), _MIN_RADIUS)
    reach = np.stack([_distances(position, middles) + radii for position in positions])
    average = contribution / (ordered_sum(contribution) or 1.0)

    def visibility(pose: Pose) -> F64:
        found = screen_coverage(boxes, pose)
        # The visibility of the others is 0.
        chunks = np.flatnonzero(found > 0.0)
        moved = _distances(pose.position, positions)[:, None]
        turned = 1.0 - _dots(pose.rotation[2:], forwards)[:, None]
        away = _distances(pose.position, middles[chunks])
        closeness = 1.0 / (
            moved / (away + reach[:, chunks]) + _ROTATION_WEIGHT * turned + _LEAST_DIFFERENCE
        )
        weights = closeness * closeness * closeness
        # Sums over the viewpoints from the first to the last (docs/streaming.md, 1).
        visible, covered = (
            np.cumsum(of[:, chunks] * weights, axis=0)[-1] for of in (shown, extents)
        )
        # Chunks outside the frustum of every viewpoint fall back to their average contribution.
        filled = np.where(
            covered > 0.0, visible / np.where(covered > 0.0, covered, 1.0), average[chunks]
        )
        found[chunks] = found[chunks] * filled
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
    """Scale the splat counts of chunks by their visibility, for compensation (section 10).

    Parameters
    ----------
    splats : (c,) int64
        Splat count of each chunk.
    ratios : (c,) float64
        Visibility ratios at the pose of the picture.

    Returns
    -------
    (c,) int64
        From 1 to the chunk's splat count; reduced where the ratio is below 1.
    """
    counts: NDArray[np.int64] = np.floor(splats * np.minimum(ratios, 1.0)).astype(np.int64)
    return np.maximum(counts, 1)


def _viewpoints(table: ViewTable) -> list[Pose]:
    """Convert the viewpoints of a view table to poses; their roll is arbitrary."""
    poses = []
    for position, direction in zip(table.positions, table.directions, strict=True):
        forward = direction.astype(np.float64)
        forward = forward / np.sqrt(dot(forward, forward))
        # The axis most perpendicular to the view direction; the first of several.
        axis = np.zeros(3)
        axis[int(np.argmin(np.abs(forward)))] = 1.0
        right = cross(axis, forward)
        right = right / np.sqrt(dot(right, right))
        rotation = np.stack([right, cross(forward, right), forward])
        poses.append(
            Pose(position.astype(np.float64), rotation, _VIEWPOINT_TANGENT, _VIEWPOINT_TANGENT)
        )
    return poses


def _distances(point: F64, points: F64) -> F64:
    """Return the distances of (v, 3) points from one, (v,)."""
    away = point - points
    return np.sqrt(_dots(away, away))


def _dots(one: F64, other: F64) -> F64:
    """Return the dot products of (v, 3) vectors; each adds its terms from left to right."""
    terms = one * other
    dots: F64 = terms[:, 0] + terms[:, 1] + terms[:, 2]
    return dots
