"""Projection of bounding boxes: screen coverage, depth, frustum test (docs/streaming.md, 3, 6)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .poses import Pose

F64 = NDArray[np.float64]

# Near plane of 3DGS (`in_frustum`): splats with a smaller depth are not drawn. Scene units.
_NEAR: Final = 0.2

# Corners of a box that an edge connects; bit k of a corner is set on the far side of axis k.
_EDGES: Final = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


def _camera_space(pose: Pose, x: F64, y: F64, z: F64) -> tuple[F64, F64, F64]:
    """Transform points to camera space; each sum adds its terms from left to right."""
    dx, dy, dz = x - pose.position[0], y - pose.position[1], z - pose.position[2]
    right, down, forward = (row[0] * dx + row[1] * dy + row[2] * dz for row in pose.rotation)
    return right, down, forward


def _corners(boxes: F64, pose: Pose) -> tuple[F64, F64, F64]:
    """Return camera-space x (right), y (down) and z (forward) of box corners, (8, c) each."""
    x, y, z = (boxes[:, [axis, axis + 3]] for axis in range(3))
    parts = [_camera_space(pose, x[:, i & 1], y[:, i >> 1 & 1], z[:, i >> 2]) for i in range(8)]
    right, down, forward = (np.stack(part) for part in zip(*parts, strict=True))
    return right, down, forward


def screen_coverage(boxes: F64, pose: Pose) -> F64:
    """Return the share of the picture within the rectangle around each projected box.

    Parameters
    ----------
    boxes : (c, 6) float64
        Minimum then maximum corner, scene units.
    pose : Pose

    Returns
    -------
    (c,) float64
        0 to 1; 0 for boxes behind the camera or outside the frustum.
    """
    corners = _corners(boxes, pose)
    forward = corners[2]
    is_ahead = forward > _NEAR
    # Where an edge passes the near plane, the part of the box that is ahead of it has a corner.
    start, end = _EDGES.T
    passes = is_ahead[start] != is_ahead[end]
    along = (_NEAR - forward[start]) / np.where(passes, forward[end] - forward[start], 1.0)
    share: F64 = np.where(is_ahead.any(axis=0), 1.0, 0.0)
    for across, tan in ((corners[0], pose.tan_x), (corners[1], pose.tan_y)):
        tangents = np.concatenate(
            [
                across / np.maximum(forward, _NEAR),
                (across[start] + (across[end] - across[start]) * along) / _NEAR,
            ]
        )
        counts = np.concatenate([is_ahead, passes])
        low = np.where(counts, tangents, np.inf).min(axis=0)
        high = np.where(counts, tangents, -np.inf).max(axis=0)
        # A box that is not ahead has infinite ones, and a share of 0.
        width = np.minimum(high, tan) - np.maximum(low, -tan)
        share *= np.maximum(width / (2.0 * tan), 0.0)
    return share


def panorama_coverage(boxes: F64, position: F64) -> F64:
    """Return the mean of the coverages of boxes in the six pictures of a panorama.

    It is the mean of `screen_coverage` of poses at the position that look along each axis in both
    directions with tangents of 1, to the bit. Boxes are parallel to these pictures, so that no
    corner needs to be transformed.

    Parameters
    ----------
    boxes : (c, 6) float64
        Minimum then maximum corner, scene units.
    position : (3,) float64

    Returns
    -------
    (c,) float64
        0 to 1.
    """
    low, high = boxes[:, :3] - position, boxes[:, 3:] - position
    total = np.zeros(len(boxes))
    for axis in range(3):
        for near, far in ((low[:, axis], high[:, axis]), (-high[:, axis], -low[:, axis])):
            is_ahead = far > _NEAR
            nearest, furthest = np.maximum(near, _NEAR), np.where(is_ahead, far, 1.0)
            share = np.where(is_ahead, 1.0, 0.0)
            for across in (axis - 2, axis - 1):
                start, end = low[:, across], high[:, across]
                least = start / np.where(start < 0.0, nearest, furthest)
                largest = end / np.where(end > 0.0, nearest, furthest)
                width = np.minimum(largest, 1.0) - np.maximum(least, -1.0)
                share *= np.maximum(width / 2.0, 0.0)
            total += share
    return total / 6.0


def centres(boxes: F64) -> F64:
    """Return the centre of each box, (c, 3) float64."""
    return 0.5 * (boxes[:, :3] + boxes[:, 3:])


def squared_radii(boxes: F64) -> F64:
    """Return the square of half the diagonal of each box, (c,) float64."""
    x, y, z = (boxes[:, 3:] - boxes[:, :3]).T
    squares: F64 = 0.25 * (x * x + y * y + z * z)
    return squares


def centre_depths(boxes: F64, pose: Pose) -> F64:
    """Return the camera-space depth of each box centre, (c,) float64, scene units."""
    x, y, z = centres(boxes).T
    depth: F64 = _camera_space(pose, x, y, z)[2]
    return depth


def intersects_frustum(boxes: F64, pose: Pose) -> NDArray[np.bool_]:
    """Apply the frustum test of SGSS (Zhu et al., MMSys 2025) to boxes, (c,) bool.

    Box and view pyramid are projected onto the three coordinate planes of camera space. A box
    passes if its polygon intersects that of the pyramid in all three planes. The pyramid ends at
    the depth of the box's farthest corner.
    """
    right, down, forward = _corners(boxes, pose)
    far = np.maximum(forward.max(axis=0), _NEAR)
    half_width, half_height, zero = pose.tan_x * far, pose.tan_y * far, np.zeros_like(far)
    apex = (zero, zero)
    top_view = [apex, (half_width, far), (-half_width, far)]
    side_view = [apex, (half_height, far), (-half_height, far)]
    front_view = [
        (half_width, half_height),
        (half_width, -half_height),
        (-half_width, -half_height),
        (-half_width, half_height),
    ]
    return (
        _intersects((right, forward), top_view)
        & _intersects((down, forward), side_view)
        & _intersects((right, down), front_view)
    )


def _intersects(box: tuple[F64, F64], polygon: list[tuple[F64, F64]]) -> NDArray[np.bool_]:
    """Test projected boxes for intersection with a convex polygon (separating axis theorem)."""
    x, y = box
    # The edges of a projected box have three directions: from corner 0 to corners 1, 2 and 4.
    edges = [(x[i] - x[0], y[i] - y[0]) for i in (1, 2, 4)]
    edges += [
        (b[0] - a[0], b[1] - a[1]) for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)
    ]
    intersects = np.ones(x.shape[1], np.bool_)
    for dx, dy in edges:
        of_box = dx * y - dy * x
        of_polygon = np.stack([dx * point[1] - dy * point[0] for point in polygon])
        intersects &= of_box.max(axis=0) >= of_polygon.min(axis=0)
        intersects &= of_polygon.max(axis=0) >= of_box.min(axis=0)
    return intersects
