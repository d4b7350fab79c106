"""Camera poses and their extrapolation (docs/streaming.md, 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]

LOOKAHEAD: Final = ((0.0, 1.0), (0.5, 0.5), (1.0, 0.25))
"""Seconds ahead and weight of each predicted pose (docs/streaming.md, 2)."""

# Longest extrapolation, as a multiple of the observed time.
_MAX_EXTRAPOLATION: Final = 4.0

# Vectors that are not longer than this are treated as zero.
_MIN_LENGTH: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Pose:
    """Position, orientation and field of view of a camera.

    Parameters
    ----------
    position : (3,) float64
        Camera centre in world space, scene units.
    rotation : (3, 3) float64
        World to camera; the rows are right, down and forward.
    tan_x, tan_y : float
        Tangents of the half field of view, horizontal and vertical, above 0.
    """

    position: F64
    rotation: F64
    tan_x: float
    tan_y: float

    @classmethod
    def from_camera(cls, camera: Camera) -> Self:
        """Return the pose of a camera; an off-centre principal point widens the field of view."""
        half_width = max(camera.cx, camera.width - camera.cx)
        half_height = max(camera.cy, camera.height - camera.cy)
        return cls(
            np.asarray(camera.position, np.float64),
            camera.rotation,
            half_width / camera.fx,
            half_height / camera.fy,
        )


def extrapolate(now: Pose, before: Pose, elapsed: float, ahead: float) -> Pose:
    """Extrapolate the camera motion linearly.

    Parameters
    ----------
    now : Pose
        Current pose.
    before : Pose
        Pose `elapsed` seconds ago.
    elapsed : float
        Time between the two poses, s; `now` is returned if it is 0.
    ahead : float
        Time to extrapolate by, s.
    """
    if not elapsed > 0.0 or not ahead > 0.0:
        return now
    factor = min(ahead / elapsed, _MAX_EXTRAPOLATION)
    position = now.position + (now.position - before.position) * factor
    moved = now.rotation + (now.rotation - before.rotation) * factor
    rotation = _orthonormal(moved)
    return Pose(position, now.rotation if rotation is None else rotation, now.tan_x, now.tan_y)


def predicted_poses(now: Pose, before: Pose, elapsed: float) -> list[tuple[Pose, float]]:
    """Return the current pose and the extrapolated ones with their weights (`LOOKAHEAD`).

    Parameters
    ----------
    now : Pose
        Current pose.
    before : Pose
        Pose `elapsed` seconds ago.
    elapsed : float
        Time between the two poses, s.
    """
    return [(extrapolate(now, before, elapsed, seconds), weight) for seconds, weight in LOOKAHEAD]


def _orthonormal(matrix: F64) -> F64 | None:
    """Orthonormalise a matrix, keeping the direction of its forward row; None if degenerate."""
    forward = _unit(matrix[2])
    if forward is None:
        return None
    right = _unit(matrix[0] - forward * dot(matrix[0], forward))
    if right is None:
        return None
    return np.stack([right, cross(forward, right), forward])


def dot(a: F64, b: F64) -> float:
    """Return the scalar product of 3-vectors, summed from the first component on."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: F64, b: F64) -> F64:
    """Return the cross product of 3-vectors."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _unit(vector: F64) -> F64 | None:
    """Normalise a vector; None if its length is at most `_MIN_LENGTH`."""
    length = float(np.sqrt(dot(vector, vector)))
    return vector / length if length > _MIN_LENGTH else None
