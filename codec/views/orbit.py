"""Orbits: camera poses all around an isolated object, as a viewer's orbit controls reach them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .low_discrepancy import STEPS_3D, sequence
from .pose import Pose, level_axes

F64 = NDArray[np.float64]

# This share of the scene is taken to be the object; the rest may be floaters that a capture left
# around it.
_OBJECT_SHARE: Final = 0.9
# Distances of the cameras from the centre, in radii of the object: at 1.5 it overflows a picture of
# 60°, at 3 it is small in it.
_CLOSEST, _FURTHEST = 1.5, 3.0
# Distances of the cameras of a turntable, in radii of the ball that holds all but a hundredth of
# the scene: from where it overflows a picture a little to where it is small in it.
_WHOLE_CLOSEST, _WHOLE_FURTHEST = 1.2, 2.2
# Sine of the elevation of the cameras of an orbit above the object: viewers start about level and
# look rather from above.
_ELEVATIONS = (-0.15, 0.6)
# And of a turntable: as far as orbit controls let a visitor turn, who may look into things from
# above.
_WHOLE_ELEVATIONS = (-0.3, 0.9)
# Every other pose of an orbit stands where the near plane cuts nothing off. At the others it may
# cut the object, as it does for a visitor who comes close, but only up to this share of the radius
# in front of the centre. It cuts nothing off before a turntable: what stands open shows its inside,
# and how bad that looks depends on the plane and not on the file.
_CUT_SHARE: Final = 0.5


@dataclass(frozen=True, eq=False)
class OrbitTarget:
    """The ball that an orbit looks at.

    Parameters
    ----------
    centre : (3,) float64
        In the frame of the means, scene units.
    radius : float
        Of the ball around the centre that holds 90 % of the splats, scene units.
    reach : float
        Of the ball that holds 99 %, scene units.
    """

    centre: F64
    radius: float
    reach: float


def orbit_target(means: F64, counts: F64) -> OrbitTarget:
    """Return the ball that holds most of a scene.

    Parameters
    ----------
    means : (n, 3) float64
        Scene units; at least one.
    counts : (n,) float64
        How many splats each row stands for.

    Returns
    -------
    OrbitTarget
    """
    middle = np.array([_quantile(means[:, axis], counts, 0.5) for axis in range(3)])
    far = np.linalg.norm(means - middle, axis=1)
    inner = far <= _quantile(far, counts, _OBJECT_SHARE)
    centre = counts[inner] @ means[inner] / counts[inner].sum()
    far = np.linalg.norm(means - centre, axis=1)
    return OrbitTarget(centre, _quantile(far, counts, _OBJECT_SHARE), _quantile(far, counts, 0.99))


def bounding_box(means: F64, counts: F64) -> F64:
    """Return the box that leaves out a hundredth of a scene at each of its sides.

    Parameters
    ----------
    means : (n, 3) float64
        Scene units; at least one.
    counts : (n,) float64
        Splats that each stands for.

    Returns
    -------
    (2, 3) float64
        Its lowest and its highest corner, scene units.
    """
    corners = [
        [_quantile(means[:, axis], counts, share) for axis in range(3)] for share in (0.01, 0.99)
    ]
    return np.array(corners)


def bounding_ball(means: F64, counts: F64) -> OrbitTarget:
    """Return the ball that holds all but a hundredth of a scene, thin parts far out included.

    Its centre is that of the box of the scene. The centre of most of the splats, as `orbit_target`
    has it, is off that of an object whose detail is at one end.

    Parameters
    ----------
    means : (n, 3) float64
        Scene units; at least one.
    counts : (n,) float64
        Splats that each stands for.
    """
    centre = bounding_box(means, counts).mean(axis=0)
    reach = _quantile(np.linalg.norm(means - centre, axis=1), counts, 0.99)
    return OrbitTarget(centre, reach, reach)


def turntable(target: OrbitTarget, count: int, down: F64, near_plane: float) -> list[Pose]:
    """Return poses all around an object, from where the whole of it is seen.

    Parameters
    ----------
    target : OrbitTarget
        From `bounding_ball`.
    count, down, near_plane
        As `orbit` takes them.

    Returns
    -------
    list of Pose
        None of them stands where a pose of `orbit` does.
    """
    distances = (_WHOLE_CLOSEST, _WHOLE_FURTHEST)
    numbers = np.arange(-count, 0)
    clear = np.full(count, near_plane + target.reach)
    return _around(target, numbers, down, clear, distances, _WHOLE_ELEVATIONS)


def orbit(target: OrbitTarget, count: int, down: F64, near_plane: float) -> list[Pose]:
    """Return poses all around an object at several distances, about level or from above.

    Parameters
    ----------
    target : OrbitTarget
        Its radius above 0.
    count : int
    down : (3,) float64
        Unit vector, or zeros where no direction is known to be down.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.

    Returns
    -------
    list of Pose
        All look at the centre. The first n of them cover the directions as evenly as all do.
    """
    numbers = np.arange(count)
    clear = near_plane + np.where(numbers % 2, target.reach, _CUT_SHARE * target.radius)
    return _around(target, numbers, down, clear, (_CLOSEST, _FURTHEST), _ELEVATIONS)


def _around(
    target: OrbitTarget,
    numbers: NDArray[np.int64],
    down: F64,
    clear: F64,
    radii: tuple[float, float],
    elevations: tuple[float, float],
) -> list[Pose]:
    """Return the poses of these numbers of the sequence, each at least so far from the centre."""
    up = -down if down.any() else np.array([0.0, 1.0, 0.0])
    side, other = level_axes(up)
    poses: list[Pose] = []
    for least, (height, azimuth, step) in zip(
        clear.tolist(), sequence(numbers, STEPS_3D).tolist(), strict=True
    ):
        rise = elevations[0] + (elevations[1] - elevations[0]) * height
        ring, angle = math.sqrt(1.0 - rise * rise), 2.0 * math.pi * azimuth
        back = rise * up + ring * (math.cos(angle) * side + math.sin(angle) * other)
        distance = target.radius * radii[0] * (radii[1] / radii[0]) ** step
        zoom = max(1.0, least / distance)
        poses.append(Pose(target.centre + zoom * distance * back, -back, zoom))
    return poses


def _quantile(values: F64, weights: F64, share: float) -> float:
    """Return the smallest value up to which `share` of the weights lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, share * total[-1]))]])
