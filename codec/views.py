"""Sets of views: held out for judging, roaming off the capture path, or a shell made from none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .cameras import Camera
from .errors import DataError
from .splats import Splats

# 3DGS, in_frustum; the same as `projection.NEAR`, which needs a compiler to import.
_NEAR = 0.2

# Roam views: the share of the median visible depth to move back by, and the turn.
STEP_BACK = 0.3
TURN_DEG = 20.0

# The shell. Half the opacity of a scene lies within its inner radius, nine tenths within its outer.
_INNER_SHARE, _OUTER_SHARE = 0.5, 0.9
# A scene encloses the viewer where the outer radius is this many times the inner: 1.65 for a
# normal cloud, 1.34 for a uniform ball; captures of a subject before a background are well above.
_ENCLOSING = 2.5
# Cameras stand off by this many radii, which gives a field of view of 47 degrees.
_STAND_OFF = 2.5
# Field of view of the cameras that look out, degrees.
_OUTWARD_FOV_DEG = 75.0
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


def hold_out(cameras: Sequence[Camera], every: int) -> tuple[list[Camera], list[Camera]]:
    """Split cameras into those to score on and those to judge by.

    Parameters
    ----------
    cameras : sequence of Camera
        In file order.
    every : int
        Cameras with ``index % every == 0`` are held out; 0 holds out none.

    Returns
    -------
    train, held : list of Camera

    Raises
    ------
    ValueError
        A negative `every`.
    """
    if every < 0:
        raise ValueError(f"every {every}, expected 0 (none) or more")
    if every == 0:
        return list(cameras), []
    train = [camera for index, camera in enumerate(cameras) if index % every]
    return train, list(cameras[::every])


def visible_depth(splats: Splats, camera: Camera) -> float:
    """Return the median camera-space z of the means that project into the image.

    Parameters
    ----------
    splats : Splats
        Every mean counts once, whatever its opacity and whatever hides it.
    camera : Camera
        Means nearer than 0.2 (`projection.NEAR`) do not count.

    Returns
    -------
    float
        Scene units; 0 where no mean projects into the image.
    """
    with np.errstate(all="ignore"):  # means behind the camera, or not finite, fail the tests below
        local = splats.means @ camera.rotation.T + camera.translation
        z = local[:, 2]
        x = camera.fx * local[:, 0] / z + camera.cx
        y = camera.fy * local[:, 1] / z + camera.cy
        inside = (z > _NEAR) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return float(np.median(z[inside])) if inside.any() else 0.0


def roam(splats: Splats, cameras: Sequence[Camera]) -> list[Camera]:
    """Return views off the capture path: every camera moved back, and every camera turned.

    Parameters
    ----------
    splats : Splats
        Gives the depths.
    cameras : sequence of Camera
        In the frame of the means.

    Returns
    -------
    list of Camera
        Two for each: moved back along its own z axis by 30 % of its `visible_depth`, and, where it
        stood, turned about its own y axis by 20°, to the right for cameras of even index and to
        the left for odd.
    """
    views: list[Camera] = []
    for index, camera in enumerate(cameras):
        depth = visible_depth(splats, camera)
        moved = camera.translation + np.array([0.0, 0.0, STEP_BACK * depth])
        views.append(replace(camera, translation=moved, name=f"{camera.name}-back"))
        angle = math.radians(TURN_DEG if index % 2 == 0 else -TURN_DEG)
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        views.append(
            replace(
                camera,
                rotation=turn @ camera.rotation,
                translation=turn @ camera.translation,
                name=f"{camera.name}-turned",
            )
        )
    return views


def jitter(splats: Splats, cameras: Sequence[Camera]) -> list[Camera]:
    """Return the copies of scoring cameras that are scored too: the rule of `roam`."""
    return roam(splats, cameras)


def shell(splats: Splats, count: int = 48, size: int = 400) -> list[Camera]:
    """Return virtual views around a scene that came without cameras.

    Parameters
    ----------
    splats : Splats
        Rows whose means or scales are not finite are left out.
    count : int
        Number of views.
    size : int
        Width and height of each, px.

    Returns
    -------
    list of Camera
        Looking at the opacity-weighted median of the means from evenly spread directions, in turn
        from a close and from a far sphere; in a scene that encloses its centre every third view
        looks out from near the centre instead. The same scene gives the same views.

    Raises
    ------
    DataError
        ``empty-scene``: no splat with any opacity.
    ValueError
        `count` or `size` below 1.
    """
    if count < 1 or size < 1:
        raise ValueError(f"{count} views of {size} px, expected at least 1 of each")
    with np.errstate(over="ignore"):
        weights = 1.0 / (1.0 + np.exp(-splats.opacities.astype(np.float64)))
    usable = np.isfinite(splats.means).all(axis=1) & np.isfinite(splats.scales).all(axis=1)
    usable &= weights > 0.0
    if not usable.any():
        raise DataError(
            "empty-scene", f"none of {len(splats)} splats has any opacity, expected at least 1"
        )
    means, weights = splats.means[usable].astype(np.float64), weights[usable]
    centre = np.array([_quantile(means[:, axis], weights, 0.5) for axis in range(3)])
    distances = np.linalg.norm(means - centre, axis=1)
    inner = _quantile(distances, weights, _INNER_SHARE)
    outer = _quantile(distances, weights, _OUTER_SHARE)
    # A scene of one point still has an extent.
    scale = float(np.median(splats.scales[usable].max(axis=1)))
    least = math.exp(min(max(scale, math.log(1e-6)), math.log(1e6)))
    outer = max(outer, least)
    inner = max(inner, least, 0.1 * outer)
    encloses = outer > _ENCLOSING * inner

    views: list[Camera] = []
    directions = _directions(count)
    for index, direction in enumerate(directions):
        name = f"shell-{index:03d}"
        if encloses and index % 3 == 2:
            focal = 0.5 * size / math.tan(math.radians(0.5 * _OUTWARD_FOV_DEG))
            position = centre - 0.25 * inner * direction
            views.append(_looking(position, direction, focal, size, name))
            continue
        radius = outer if index % 2 else inner
        # In small scenes the near plane, which is absolute, must stay clear of the splats.
        distance = max(_STAND_OFF * radius, radius + 2.0 * _NEAR)
        focal = 0.5 * size * math.sqrt(distance**2 - radius**2) / radius
        views.append(_looking(centre + distance * direction, -direction, focal, size, name))
    return views


def _directions(count: int) -> NDArray[np.float64]:
    """Spread `count` unit vectors evenly: a Fibonacci lattice on the sphere."""
    k = np.arange(count)
    y = 1.0 - (2.0 * k + 1.0) / count
    ring = np.sqrt(1.0 - y * y)
    return np.stack([ring * np.cos(_GOLDEN_ANGLE * k), y, ring * np.sin(_GOLDEN_ANGLE * k)], axis=1)


def _looking(
    position: NDArray[np.float64],
    forward: NDArray[np.float64],
    focal: float,
    size: int,
    name: str,
) -> Camera:
    """Build a square camera, its y axis as near to the world's as it goes."""
    down = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(
        width=size,
        height=size,
        fx=focal,
        fy=focal,
        cx=0.5 * size,
        cy=0.5 * size,
        rotation=rotation,
        translation=-rotation @ position,
        name=name,
    )


def _quantile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Return the smallest value below which at least `share` of the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    place = int(np.searchsorted(total, share * total[-1]))
    return float(values[order[min(place, len(values) - 1)]])
