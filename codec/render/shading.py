"""Shading: colours of splats seen from a camera, from their SH coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry import sh
from cogsplat.codec.splats import Splats, sh_coefficients

from .jit import inner_kernel, kernel
from .projection import Footprints

_ZERO = np.float32(0.0)

sh_terms = inner_kernel(sh.terms)
"""`sh.terms`, compiled for kernels."""


@called_with(
    "int32[::1], float32[:, ::1], float32[:, ::1], float32[:, :, ::1], float64[::1], int64, "
    "float32[:, ::1]"
)
@kernel
def _shade(
    index: NDArray[np.int32],
    means: NDArray[np.float32],
    sh0: NDArray[np.float32],
    shN: NDArray[np.float32],
    position: NDArray[np.float64],
    higher: int,
    colours: NDArray[np.float32],
) -> None:
    """Write the colours of indexed splats seen from `position`, with `higher` bases above DC."""
    for row in range(len(index)):
        i = index[row]
        red = np.float32(sh.C0) * sh0[i, 0]
        green = np.float32(sh.C0) * sh0[i, 1]
        blue = np.float32(sh.C0) * sh0[i, 2]
        if higher > 0:
            x = means[i, 0] - position[0]
            y = means[i, 1] - position[1]
            z = means[i, 2] - position[2]
            inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
            values = sh_terms(x * inverse, y * inverse, z * inverse)
            for k in range(higher):
                value = np.float32(values[k])
                red += value * shN[i, k, 0]
                green += value * shN[i, k, 1]
                blue += value * shN[i, k, 2]
        offset = np.float32(sh.COLOUR_OFFSET)
        colours[row, 0] = max(red + offset, _ZERO)
        colours[row, 1] = max(green + offset, _ZERO)
        colours[row, 2] = max(blue + offset, _ZERO)


def row_colours(
    splats: Splats, rows: NDArray[np.int32], camera: Camera, sh_degree: int | None = None
) -> NDArray[np.float32]:
    """Return the colours of the splats `rows` seen from a camera, clamped at 0.

    Parameters
    ----------
    splats : Splats
        Scene with the splats.
    rows : (n,) int32
        Rows of the splats, in any order.
    camera : Camera
        Camera in the frame of the means.
    sh_degree : int or None
        Highest SH degree used; None for the scene's own.

    Returns
    -------
    (n, 3) float32
    """
    colours = np.empty((len(rows), 3), np.float32)
    higher = splats.shN.shape[1]
    if sh_degree is not None:
        higher = min(higher, sh_coefficients(sh_degree) - 1)
    _shade(rows, splats.means, splats.sh0, splats.shN, camera.position, higher, colours)
    return colours


def footprint_colours(
    splats: Splats,
    camera: Camera,
    footprints: Footprints,
    *,
    rows: NDArray[np.int32] | None = None,
    sh_degree: int | None = None,
) -> NDArray[np.float32]:
    """Return the colours of footprints, in their order, clamped at 0.

    The result equals `row_colours` of the footprints' rows. SH coefficients are most of a scene's
    bytes: reading them by ascending rows instead of nearest first shades a million splats in a
    seventh of the time.

    Parameters
    ----------
    splats : Splats
        Scene that was projected.
    camera : Camera
        Camera in the frame of the means.
    footprints : Footprints
        Footprints of M splats.
    rows : (n,) int32, optional
        Ascending rows of the scene that were projected, if not all; `Footprints.index` then holds
        positions in `rows`.
    sh_degree : int or None
        Highest SH degree used; None for the scene's own.

    Returns
    -------
    (M, 3) float32
    """
    visible = footprints.sorted_rows()
    if rows is not None:
        visible = rows[visible]
    return row_colours(splats, visible, camera, sh_degree).take(footprints.order, axis=0)
