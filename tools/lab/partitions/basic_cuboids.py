"""Basic cuboids: a grid of nearly cubic boxes over a scene, and which views see what in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR, in_picture

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Share of the splats, at each end of each axis, that do not widen the grid: floaters far outside
# would make most cuboids empty. They count in the outermost cuboids.
_OUTSIDE: Final = 0.01
# Steps of the search for the side of a cuboid: more than a float64 has bits.
_HALVINGS: Final = 60


@dataclass(frozen=True, eq=False)
class BasicCuboids:
    """A grid over a scene.

    Parameters
    ----------
    edges : tuple of (n + 1,) float64
        Planes that cut each axis, scene units, ascending; the first and the last are the ends of
        the grid, and splats beyond them belong to the outermost cuboids.
    splats : (i, j, k) int64
        Splats in each cuboid.
    seen : (V, i, j, k) int64
        Of these, how many have their mean in each view's picture and beyond its near plane.
    """

    edges: tuple[F64, F64, F64]
    splats: I64
    seen: I64


def basic_cuboids(means: F64, cameras: Sequence[Camera], cuboids: int) -> BasicCuboids:
    """Lay a grid over splats and count them (SGSS, Zhu et al., MMSys 2025, basic cuboids).

    Parameters
    ----------
    means : (N, 3) float64
        Scene units, finite, at least one row.
    cameras : sequence of Camera
        Views of the scene, in the frame of the means.
    cuboids : int
        How many there are at most, and nearly; SGSS takes 300 to 2,000.

    Raises
    ------
    ValueError
        No splats, or no cuboids.
    """
    if not len(means) or cuboids < 1:
        raise ValueError(f"{len(means)} splats and {cuboids} cuboids, expected at least one each")
    low, high = np.quantile(means, [_OUTSIDE, 1.0 - _OUTSIDE], axis=0)
    shape = _shape(high - low, cuboids)
    edges = [np.linspace(low[axis], high[axis], shape[axis] + 1) for axis in range(3)]
    place = np.stack(
        [np.searchsorted(edges[axis][1:-1], means[:, axis], side="right") for axis in range(3)]
    )
    number = np.ravel_multi_index(tuple(place), shape)
    size = int(np.prod(shape))
    seen = np.zeros((len(cameras), *shape), np.int64)
    for view, camera in enumerate(cameras):
        inside = in_picture(means, camera, NEAR)
        seen[view] = np.bincount(number[inside], minlength=size).reshape(shape)
    counts = np.bincount(number, minlength=size).reshape(shape)
    return BasicCuboids((edges[0], edges[1], edges[2]), counts, seen)


def _shape(size: F64, cuboids: int) -> tuple[int, int, int]:
    """Return how many cuboids there are along each axis: the finest grid of at most so many."""

    def at(side: float) -> NDArray[np.int64]:
        return np.maximum(np.rint(size / side), 1.0).astype(np.int64)

    # The number of cuboids never grows with their side, and is 1 where that is the longest axis.
    enough = max(float(size.max()), 1e-300)
    small = enough / (cuboids + 1)
    for _ in range(_HALVINGS):
        side = 0.5 * (small + enough)
        if at(side).prod() <= cuboids:
            enough = side
        else:
            small = side
    shape = at(enough)
    return int(shape[0]), int(shape[1]), int(shape[2])
