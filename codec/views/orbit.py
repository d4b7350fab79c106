"""Orbits: views of a subject that stands free, from where a viewer's controls turn it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .pose import Pose

F64 = NDArray[np.float64]

# So much of the scene is the subject; the rest may be what a capture left floating around it.
_SUBJECT_SHARE: Final = 0.9
# Distances, in radii of the subject: from where it overflows a picture of 60° to where it is small
# enough to walk around it.
_CLOSEST, _FURTHEST = 1.5, 3.0
# Where it fills the picture without overflowing it.
_FILLING: Final = 2.0
# Sine of the height above the subject that controls start from and are mostly left at.
_LOWEST, _HIGHEST = -0.15, 0.6
# Every other view of an orbit is from where the near plane cuts nothing. The rest, and those of a
# turntable, may be cut by it as a visitor's are that comes close, but not past the middle.
_CUT_SHARE: Final = 0.5

# Three-dimensional low-discrepancy sequence: powers of the inverse of the root of x⁴ = x + 1
# (Roberts 2018).
_ROOT: Final = 1.2207440846057596
_SEQUENCE: Final = np.array([1.0 / _ROOT, 1.0 / _ROOT**2, 1.0 / _ROOT**3])


@dataclass(frozen=True, eq=False)
class Subject:
    """What an orbit turns around.

    Parameters
    ----------
    centre : (3,) float64
        Scene units.
    radius : float
        Of the ball around it that holds nine tenths of the scene.
    reach : float
        Of the ball that holds all but a hundredth.
    """

    centre: F64
    radius: float
    reach: float


def subject_of(means: F64, counts: F64) -> Subject:
    """Return the subject of a scene.

    Parameters
    ----------
    means : (n, 3) float64
        Scene units; at least one.
    counts : (n,) float64
        Splats that each stands for.
    """
    middle = np.array([_quantile(means[:, axis], counts, 0.5) for axis in range(3)])
    far = np.linalg.norm(means - middle, axis=1)
    inner = far <= _quantile(far, counts, _SUBJECT_SHARE)
    centre = counts[inner] @ means[inner] / counts[inner].sum()
    far = np.linalg.norm(means - centre, axis=1)
    return Subject(centre, _quantile(far, counts, _SUBJECT_SHARE), _quantile(far, counts, 0.99))


def turntable(subject: Subject, count: int, down: F64, near_plane: float) -> list[Pose]:
    """Return poses all around a subject, from where it fills the picture, that `orbit` has not.

    Parameters
    ----------
    subject, count, down, near
        As `orbit` takes them.
    """
    return _around(subject, range(-count, 0), down, near_plane, (_FILLING, _FILLING), cut=1)


def orbit(subject: Subject, count: int, down: F64, near_plane: float) -> list[Pose]:
    """Return poses all around a subject, about level and rather from above, that look at it.

    Parameters
    ----------
    subject : Subject
        Its radius above 0.
    count : int
    down : (3,) float64
        Unit vector, or zeros where no direction is known to be down.
    near_plane : float
        Depth up to which nothing is drawn, scene units.

    Returns
    -------
    list of Pose
        Those of any first part spread as evenly as all of them.
    """
    return _around(subject, range(count), down, near_plane, (_CLOSEST, _FURTHEST), cut=2)


def _around(
    subject: Subject,
    rows: range,
    down: F64,
    near_plane: float,
    radii: tuple[float, float],
    *,
    cut: int,
) -> list[Pose]:
    up = -down if down.any() else np.array([0.0, 1.0, 0.0])
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    other = np.cross(up, side)
    poses: list[Pose] = []
    for row in rows:
        height, turn, step = (0.5 + row * _SEQUENCE) % 1.0
        rise = _LOWEST + (_HIGHEST - _LOWEST) * float(height)
        ring, angle = math.sqrt(1.0 - rise * rise), 2.0 * math.pi * float(turn)
        back = rise * up + ring * (math.cos(angle) * side + math.sin(angle) * other)
        distance = subject.radius * radii[0] * (radii[1] / radii[0]) ** float(step)
        clear = near_plane + (subject.reach if row % cut else _CUT_SHARE * subject.radius)
        zoom = max(1.0, clear / distance)
        poses.append(Pose(subject.centre + zoom * distance * back, -back, zoom))
    return poses


def _quantile(values: F64, weights: F64, share: float) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, share * total[-1]))]])
