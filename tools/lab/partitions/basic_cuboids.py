"""Basic cuboids of SGSS: a grid of nearly cubic boxes with splat counts per view."""

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

# Share of the splats excluded from the grid's extent at each end of each axis: distant floaters
# would leave most cuboids empty. They are counted in the outermost cuboids.
_OUTLIER_SHARE: Final = 0.01
# Bisection steps for the side of a cuboid: more than the bits of a float64.
_BISECTION_STEPS: Final = 60


@dataclass(frozen=True, eq=False)
class BasicCuboids:
    """Grid of cuboids over a scene, with splat counts.

    Parameters
    ----------
    edges : tuple of (n + 1,) float64
        Grid planes of each axis, scene units, ascending. Splats beyond the first and last plane
        belong to the outermost cuboids.
    splats : (i, j, k) int64
        Number of splats in each cuboid.
    visible : (V, i, j, k) int64
        Number of splats in each cuboid whose mean lies in the frustum of each view.
    """

    edges: tuple[F64, F64, F64]
    splats: I64
    visible: I64


def basic_cuboids(means: F64, cameras: Sequence[Camera], cuboids: int) -> BasicCuboids:
    """Build the grid of basic cuboids over a scene (SGSS, Zhu et al., MMSys 2025).

    Parameters
    ----------
    means : (N, 3) float64
        Splat positions, scene units, finite, at least one row.
    cameras : sequence of Camera
        Views of the scene, in the frame of the means.
    cuboids : int
        Number of cuboids at most; the grid has nearly as many. SGSS uses 300 to 2,000.

    Raises
    ------
    ValueError
        There are no splats, or `cuboids` is below 1.
    """
    if not len(means) or cuboids < 1:
        raise ValueError(f"{len(means)} splats and {cuboids} cuboids, expected at least one each")
    low, high = np.quantile(means, [_OUTLIER_SHARE, 1.0 - _OUTLIER_SHARE], axis=0)
    shape = _shape(high - low, cuboids)
    edges = [np.linspace(low[axis], high[axis], shape[axis] + 1) for axis in range(3)]
    cell = np.stack(
        [np.searchsorted(edges[axis][1:-1], means[:, axis], side="right") for axis in range(3)]
    )
    number = np.ravel_multi_index(tuple(cell), shape)
    size = int(np.prod(shape))
    visible = np.zeros((len(cameras), *shape), np.int64)
    for view, camera in enumerate(cameras):
        inside = in_picture(means, camera, NEAR)
        visible[view] = np.bincount(number[inside], minlength=size).reshape(shape)
    counts = np.bincount(number, minlength=size).reshape(shape)
    return BasicCuboids((edges[0], edges[1], edges[2]), counts, visible)


def _shape(size: F64, cuboids: int) -> tuple[int, int, int]:
    """Return the number of cuboids along each axis of the finest grid within a limit."""

    def shape_at(side: float) -> NDArray[np.int64]:
        return np.maximum(np.rint(size / side), 1.0).astype(np.int64)

    # The number of cuboids never grows with their side, and is 1 for the longest axis as side.
    large = max(float(size.max()), 1e-300)
    small = large / (cuboids + 1)
    for _ in range(_BISECTION_STEPS):
        side = 0.5 * (small + large)
        if shape_at(side).prod() <= cuboids:
            large = side
        else:
            small = side
    shape = shape_at(large)
    return int(shape[0]), int(shape[1]), int(shape[2])
