"""How much more than usual a pose shows of each chunk (docs/streaming.md, 3 to 6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.view_shares import ViewTable

from .boxes import in_pyramid, middle_depths, picture_shares
from .poses import Pose, cross, dot

F64 = NDArray[np.float64]

LEAST_RATIO: Final = 1.0 / 512.0
"""Ratio of a chunk that a pose shows nothing of: it comes when all that is seen is there."""

# Tangent of half the angle that viewpoints are taken to see in both directions.
_TABLE_TANGENT: Final = 1.0
# Half a turn counts as much as 0.6 times the spread of the viewpoints.
_TURN: Final = 0.3
# What keeps the weight of a viewpoint finite.
_NEAREST: Final = 0.01
# Shares of contribution below this count as this.
_LEAST_USUAL: Final = 1e-12
_NEAREST_DEPTH: Final = 0.2
# SGSS (Zhu et al., MMSys 2025): sparser boxes have low priority, whatever they show. The paper does
# not state what keeps its distance from 0.
_SPARSE: Final = 10.0
_EPSILON: Final = 1e-6

PoseRatios = Callable[[Pose], F64]
"""Ratios of all chunks for a pose, (c,) float64."""


def total(values: F64) -> float:
    """Return a sum, from the first value on."""
    return float(np.cumsum(values)[-1]) if len(values) else 0.0


def along(ratios: PoseRatios, path: Sequence[tuple[Pose, float]]) -> F64:
    """Return the sum of a path's ratios, each times its weight, from the first pose on."""
    pose, weight = path[0]
    out = ratios(pose) * weight
    for pose, weight in path[1:]:
        out = out + ratios(pose) * weight
    return out


def over_usual(shown: F64, contribution: F64) -> F64:
    """Return shares of what is shown over shares of what chunks contribute (docs/streaming.md, 4).

    Parameters
    ----------
    shown : (c,) float64
        What a picture shows of each chunk, in any unit, at least 0.
    contribution : (c,) float64
        As `by_boxes` takes it.

    Returns
    -------
    (c,) float64
        At least `LEAST_RATIO`; 1 for all where nothing is shown or nothing contributes.
    """
    everything, whole = total(shown), total(contribution)
    if not everything > 0.0 or not whole > 0.0:
        return np.ones(len(shown))
    usual = np.maximum(contribution / whole, _LEAST_USUAL)
    return np.maximum(shown / everything / usual, LEAST_RATIO)


def by_boxes(boxes: F64, contribution: F64) -> PoseRatios:
    """Return ratios by boxes alone: contribution over the square of the depth, where they show.

    Parameters
    ----------
    boxes : (c, 6) float64
    contribution : (c,) float64
        Of each chunk, as the file has it.
    """

    def ratios(pose: Pose) -> F64:
        depth = np.maximum(middle_depths(boxes, pose), _NEAREST_DEPTH)
        seen = picture_shares(boxes, pose) > 0.0
        return over_usual(np.where(seen, contribution / (depth * depth), 0.0), contribution)

    return ratios


def by_view_table(table: ViewTable, boxes: F64, contribution: F64) -> PoseRatios:
    """Return ratios by what the viewpoints near a pose show (docs/streaming.md, 4).

    Parameters
    ----------
    table : ViewTable
    boxes, contribution
        As `by_boxes` takes them.
    """
    viewpoints = _viewpoints(table)
    shares = [table.shares[view] for view in range(len(viewpoints))]
    # What a viewpoint shows of a chunk is no more than its box takes, whatever angle was seen.
    taken = [
        np.maximum(picture_shares(boxes, view), share)
        for view, share in zip(viewpoints, shares, strict=True)
    ]
    spread = _spread([view.position for view in viewpoints])
    usual = contribution / (total(contribution) or 1.0)

    def ratios(pose: Pose) -> F64:
        shown, most = np.zeros(len(boxes)), np.zeros(len(boxes))
        for view, share, box in zip(viewpoints, shares, taken, strict=True):
            weight = _weight(pose, view, spread)
            shown = shown + share * weight
            most = most + box * weight
        # Of chunks that no viewpoint looks at, what they contribute on average.
        filled = np.where(most > 0.0, shown / np.where(most > 0.0, most, 1.0), usual)
        return over_usual(picture_shares(boxes, pose) * filled, contribution)

    return ratios


def by_sgss(boxes: F64, splats: F64) -> PoseRatios:
    """Return SGSS' priorities PW in the place of ratios; 0 for what its test finds not visible.

    Parameters
    ----------
    boxes : (c, 6) float64
    splats : (c,) float64
        Splats of each chunk.
    """
    size = np.maximum(boxes[:, 3:] - boxes[:, :3], 1e-9)
    density = splats / (size[:, 0] * size[:, 1] * size[:, 2])

    def ratios(pose: Pose) -> F64:
        depth = np.maximum(middle_depths(boxes, pose), 0.0) + _EPSILON
        priority = density * picture_shares(boxes, pose) / depth
        low = np.where(density < _SPARSE, density * _EPSILON, priority)
        return np.where(in_pyramid(boxes, pose), low, 0.0)

    return ratios


def counted_splats(splats: NDArray[np.int64], ratios: F64) -> NDArray[np.int64]:
    """Return as how many splats each chunk counts when a picture is compensated (section 10).

    Parameters
    ----------
    splats : (c,) int64
        Splats of each chunk.
    ratios : (c,) float64
        Of the pose of the picture.

    Returns
    -------
    (c,) int64
        1 to what the chunk has: fewer where the pose shows less of it than pictures usually do.
    """
    counts: NDArray[np.int64] = np.floor(splats * np.minimum(ratios, 1.0)).astype(np.int64)
    return np.maximum(counts, 1)


def _viewpoints(table: ViewTable) -> list[Pose]:
    """Return the viewpoints of a table as poses: upright or not does not matter."""
    poses = []
    for position, direction in zip(table.positions, table.directions, strict=True):
        forward = direction.astype(np.float64)
        forward = forward / np.sqrt(dot(forward, forward))
        # The axis that is most across, the first of several.
        axis = np.zeros(3)
        axis[int(np.argmin(np.abs(forward)))] = 1.0
        right = cross(axis, forward)
        right = right / np.sqrt(dot(right, right))
        rotation = np.stack([right, cross(forward, right), forward])
        poses.append(Pose(position.astype(np.float64), rotation, _TABLE_TANGENT, _TABLE_TANGENT))
    return poses


def _spread(positions: Sequence[F64]) -> float:
    """Return the root mean square distance of positions from their mean."""
    count = float(len(positions))
    middle = np.array([total(np.array([p[axis] for p in positions])) / count for axis in range(3)])
    squares = np.array([dot(p - middle, p - middle) for p in positions])
    return max(float(np.sqrt(total(squares) / count)), 1e-9)


def _weight(pose: Pose, view: Pose, spread: float) -> float:
    """Return how much a viewpoint says about a pose."""
    away = pose.position - view.position
    turned = 1.0 - dot(pose.rotation[2], view.rotation[2])
    near = 1.0 / (float(np.sqrt(dot(away, away))) / spread + _TURN * turned + _NEAREST)
    return (near * near) * (near * near)
