"""What a pose shows of boxes: how much of its picture, how deep (docs/streaming.md, 3 and 6)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .poses import Pose

F64 = NDArray[np.float64]

# 3DGS, in_frustum: means nearer than this are not drawn. Scene units.
_NEAR: Final = 0.2


def _local(pose: Pose, x: F64, y: F64, z: F64) -> tuple[F64, F64, F64]:
    """Return points in the pose's space, every sum from the first term on."""
    dx, dy, dz = x - pose.position[0], y - pose.position[1], z - pose.position[2]
    right, down, forward = (row[0] * dx + row[1] * dy + row[2] * dz for row in pose.rotation)
    return right, down, forward


def _corners(boxes: F64, pose: Pose) -> tuple[F64, F64, F64]:
    """Return right, down and forward of the eight corners of boxes, (8, c) each."""
    x, y, z = (boxes[:, [axis, axis + 3]] for axis in range(3))
    parts = [_local(pose, x[:, i & 1], y[:, i >> 1 & 1], z[:, i >> 2]) for i in range(8)]
    right, down, forward = (np.stack(part) for part in zip(*parts, strict=True))
    return right, down, forward


def picture_shares(boxes: F64, pose: Pose) -> F64:
    """Return the share of the picture that the rectangle around each box takes.

    Parameters
    ----------
    boxes : (c, 6) float64
        Minimum then maximum corner.
    pose : Pose

    Returns
    -------
    (c,) float64
        0 to 1; 0 for boxes behind the eye or beside the picture.
    """
    right, down, forward = _corners(boxes, pose)
    share: F64 = (forward.max(axis=0) > _NEAR).astype(np.float64)
    depth = np.maximum(forward, _NEAR)
    for across, tan in ((right, pose.tan_x), (down, pose.tan_y)):
        tangents = across / depth
        low = np.maximum(tangents.min(axis=0), -tan)
        high = np.minimum(tangents.max(axis=0), tan)
        share = share * np.maximum((high - low) / (2.0 * tan), 0.0)
    return share


def middle_depths(boxes: F64, pose: Pose) -> F64:
    """Return how deep the middle of each box lies, (c,) float64, scene units."""
    middle = 0.5 * (boxes[:, :3] + boxes[:, 3:])
    depth: F64 = _local(pose, middle[:, 0], middle[:, 1], middle[:, 2])[2]
    return depth


def in_pyramid(boxes: F64, pose: Pose) -> NDArray[np.bool_]:
    """Mark boxes that SGSS' test finds visible, (c,) bool.

    Box and pyramid of view are projected onto the planes of the pose's axes; a box is visible
    where the two polygons meet in all three (Zhu et al., MMSys 2025). The pyramid ends behind the
    farthest corner of the box.
    """
    right, down, forward = _corners(boxes, pose)
    far = np.maximum(forward.max(axis=0), _NEAR)
    wide, high, zero = pose.tan_x * far, pose.tan_y * far, np.zeros_like(far)
    apex = (zero, zero)
    from_above = [apex, (wide, far), (-wide, far)]
    from_aside = [apex, (high, far), (-high, far)]
    from_front = [(wide, high), (wide, -high), (-wide, -high), (-wide, high)]
    return (
        _meet((right, forward), from_above)
        & _meet((down, forward), from_aside)
        & _meet((right, down), from_front)
    )


def _meet(box: tuple[F64, F64], polygon: list[tuple[F64, F64]]) -> NDArray[np.bool_]:
    """Mark boxes whose projection meets a convex polygon: no edge of either separates them."""
    x, y = box
    # Edges of a projected box run as its three axes do: from corner 0 to corners 1, 2 and 4.
    edges = [(x[i] - x[0], y[i] - y[0]) for i in (1, 2, 4)]
    edges += [
        (b[0] - a[0], b[1] - a[1]) for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)
    ]
    meets = np.ones(x.shape[1], np.bool_)
    for along, up in edges:
        of_box = along * y - up * x
        of_polygon = np.stack([along * point[1] - up * point[0] for point in polygon])
        meets &= of_box.max(axis=0) >= of_polygon.min(axis=0)
        meets &= of_polygon.max(axis=0) >= of_box.min(axis=0)
    return meets
