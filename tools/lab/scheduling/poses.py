"""Poses that a visitor looks from, and where these will soon be (docs/streaming.md, 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]

AHEAD: Final = ((0.0, 1.0), (0.5, 0.5), (1.0, 0.25))
"""Seconds ahead that count, and how much: docs/streaming.md, 2."""

# Nobody goes on for longer than so many times the time that was observed.
_MOST_EXTRAPOLATED: Final = 4.0

# A shorter vector has no direction.
_SHORTEST: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a visitor is and what part of space the picture shows.

    Parameters
    ----------
    position : (3,) float64
        In the space of the means.
    rotation : (3, 3) float64
        World to camera; its rows are right, down and forward.
    tan_x, tan_y : float
        Half of the picture's width and height at a distance of 1, above 0.
    """

    position: F64
    rotation: F64
    tan_x: float
    tan_y: float

    @classmethod
    def of_camera(cls, camera: Camera) -> Self:
        """Return the pose of a camera; the wider half counts where the middle is off."""
        half_width = max(camera.cx, camera.width - camera.cx)
        half_height = max(camera.cy, camera.height - camera.cy)
        return cls(
            np.asarray(camera.position, np.float64),
            camera.rotation,
            half_width / camera.fx,
            half_height / camera.fy,
        )


def predicted(now: Pose, before: Pose, elapsed: float, ahead: float) -> Pose:
    """Return the pose of a visitor who goes on as before.

    Parameters
    ----------
    now : Pose
    before : Pose
        Of `elapsed` seconds ago.
    elapsed, ahead : float
        Seconds. Where nothing elapsed, the pose stays.
    """
    if not elapsed > 0.0 or not ahead > 0.0:
        return now
    times = min(ahead / elapsed, _MOST_EXTRAPOLATED)
    position = now.position + (now.position - before.position) * times
    turned = now.rotation + (now.rotation - before.rotation) * times
    rotation = _orthonormal(turned)
    return Pose(position, now.rotation if rotation is None else rotation, now.tan_x, now.tan_y)


def path(now: Pose, before: Pose, elapsed: float) -> list[tuple[Pose, float]]:
    """Return the pose of now and those soon to come, each with how much it counts (`AHEAD`)."""
    return [(predicted(now, before, elapsed, seconds), weight) for seconds, weight in AHEAD]


def _orthonormal(turned: F64) -> F64 | None:
    """Return the rotation of forward as it is and right across it; None where it has none."""
    forward = _unit(turned[2])
    if forward is None:
        return None
    right = _unit(turned[0] - forward * dot(turned[0], forward))
    if right is None:
        return None
    return np.stack([right, cross(forward, right), forward])


def dot(a: F64, b: F64) -> float:
    """Return a scalar product, summed from the first component on."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: F64, b: F64) -> F64:
    """Return a cross product."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _unit(vector: F64) -> F64 | None:
    length = float(np.sqrt(dot(vector, vector)))
    return vector / length if length > _SHORTEST else None
