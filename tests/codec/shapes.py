"""Scenes of equal round splats: surfaces of spheres and boxes."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats, empty


def balls(points: NDArray[np.float64], size: float) -> Splats:
    """Return round, nearly opaque splats."""
    splats = empty(0, len(points))
    splats.means[:] = points
    splats.scales[:] = math.log(size)
    splats.opacities[:] = 4.0
    return splats


def sphere(radius: float, n: int = 1500, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Splats:
    points = np.random.default_rng(1).normal(size=(n, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return balls(points + np.asarray(centre), radius * math.sqrt(4.0 * math.pi / n))


def box(half: Sequence[float], n: int, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Splats:
    """Return the walls of a box, splats as dense on all of them."""
    rng = np.random.default_rng(2)
    sides = np.asarray(half, float)
    areas = np.repeat(np.prod(sides) / sides, 2)
    points = rng.uniform(-1.0, 1.0, (n, 3))
    walls = rng.choice(6, n, p=areas / areas.sum())
    points[np.arange(n), walls // 2] = np.where(walls % 2, 1.0, -1.0)
    size = 0.8 * math.sqrt(4.0 * areas.sum() / n)
    return balls(points * sides + np.asarray(centre), size)
