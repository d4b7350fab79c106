"""Orbits: camera poses all around an isolated object, within reach of a viewer's orbit controls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .low_discrepancy import STEPS_3D, sequence
from .pose import Pose, level_axes

F64 = NDArray[np.float64]

# Share of the scene's splats that counts as the object; the rest may be floaters around it.
_OBJECT_SHARE: Final = 0.9
# Orbit: closest and furthest camera distance, in radii of the object. At 1.5 radii the object
# overflows a picture of 60°, at 3 it is small.
_CLOSEST, _FURTHEST = 1.5, 3.0
# Turntable: closest and furthest camera distance, in radii of the ball that holds 99 % of the
# scene. At 1.2 radii the ball slightly overflows the picture, at 2.2 it is small.
_WHOLE_CLOSEST, _WHOLE_FURTHEST = 1.2, 2.2
# Orbit: range of the sine of the cameras' elevation. Viewers start about level and look from above
# more often than from below.
_ELEVATIONS = (-0.15, 0.6)
# Turntable: range of the sine of the elevation, as far as orbit controls turn. A viewer may look
# into open objects from above.
_WHOLE_ELEVATIONS = (-0.3, 0.9)
# At every other orbit pose the near plane lies in front of the object. At the rest it may cut the
# object, as it does for a viewer at close range, up to this share of the radius in front of the
# centre. A turntable never cuts the object: an object cut open shows its inside, and that error
# depends on the near plane, not on the file.
_CUT_SHARE: Final = 0.5


@dataclass(frozen=True, eq=False)
class OrbitTarget:
    """Target of an orbit: a centre and the radii of two balls around it.

    Parameters
    ----------
    centre : (3,) float64
        Centre in the frame of the means, scene units.
    radius : float
        Radius of the ball that holds 90 % of the splats, scene units.
    reach : float
        Radius of the ball that holds 99 % of the splats, scene units.
    """

    centre: F64
    radius: float
    reach: float


def orbit_target(means: F64, counts: F64) -> OrbitTarget:
    """Return the orbit target of a scene, centred on the bulk of its splats.

    Parameters
    ----------
    means : (n, 3) float64
        Positions of splats, scene units; at least one.
    counts : (n,) float64
        Number of the scene's splats that each row stands for.
    """
    middle = np.array([_quantile(means[:, axis], counts, 0.5) for axis in range(3)])
    far = np.linalg.norm(means - middle, axis=1)
    inner = far <= _quantile(far, counts, _OBJECT_SHARE)
    centre = counts[inner] @ means[inner] / counts[inner].sum()
    far = np.linalg.norm(means - centre, axis=1)
    return OrbitTarget(centre, _quantile(far, counts, _OBJECT_SHARE), _quantile(far, counts, 0.99))


def bounding_box(means: F64, counts: F64) -> F64:
    """Return the bounding box of a scene without the outermost 1 % of its splats at each side.

    Parameters
    ----------
    means : (n, 3) float64
        Positions of splats, scene units; at least one.
    counts : (n,) float64
        Number of the scene's splats that each row stands for.

    Returns
    -------
    (2, 3) float64
        Lowest and highest corner, scene units.
    """
    corners = [
        [_quantile(means[:, axis], counts, share) for axis in range(3)] for share in (0.01, 0.99)
    ]
    return np.array(corners)


def bounding_ball(means: F64, counts: F64) -> OrbitTarget:
    """Return an orbit target that holds 99 % of a scene, thin parts far out included.

    Its centre is the centre of the scene's `bounding_box`. The centre of `orbit_target` is
    off-centre for an object whose detail is at one end.

    Parameters
    ----------
    means : (n, 3) float64
        Positions of splats, scene units; at least one.
    counts : (n,) float64
        Number of the scene's splats that each row stands for.
    """
    centre = bounding_box(means, counts).mean(axis=0)
    reach = _quantile(np.linalg.norm(means - centre, axis=1), counts, 0.99)
    return OrbitTarget(centre, reach, reach)


def turntable(target: OrbitTarget, count: int, down: F64, near_plane: float) -> list[Pose]:
    """Return poses all around an object that each show the whole object.

    Parameters
    ----------
    target : OrbitTarget
        Result of `bounding_ball`.
    count, down, near_plane
        See `orbit`.

    Returns
    -------
    list of Pose
        Poses for testing; none is a pose of `orbit`.
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
        Target with a radius above 0.
    count : int
        Number of poses.
    down : (3,) float64
        Unit vector; zeros if no direction is known to be down.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.

    Returns
    -------
    list of Pose
        Poses that look at the centre. For every n, the first n cover the directions evenly.
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
    """Return orbit poses for numbers of the low-discrepancy sequence.

    Parameters
    ----------
    target : OrbitTarget
    numbers : (n,) int64
        Numbers of the points in the low-discrepancy sequence.
    down : (3,) float64
        Unit vector; zeros if no direction is known to be down.
    clear : (n,) float64
        Minimum distance of each camera from the centre, scene units. A camera moved back to it
        zooms in by the same factor.
    radii : (float, float)
        Closest and furthest distance, in radii of the target.
    elevations : (float, float)
        Range of the sine of the elevation.
    """
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
    """Return the weighted quantile of values: the smallest with `share` of the weights up to it."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, share * total[-1]))]])
