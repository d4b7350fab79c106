"""Shading: the colours that splats show to a camera, from their SH coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry import sh
from cogsplat.codec.splats import Splats, sh_coefficients

from .jit import kernel
from .projection import Footprints

_ZERO = np.float32(0.0)

sh_terms = kernel(sh.terms)
"""`sh.terms`, compiled for kernels."""


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
    """Fill the colours of indexed splats seen from `position`, with `higher` bases above DC."""
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


@kernel
def _rank(
    index: NDArray[np.int32],
    rows: NDArray[np.int32],
    ranks: NDArray[np.int32],
    ascending: NDArray[np.int32],
) -> None:
    """List the visible rows in ascending order, and each one's place in that list.

    Parameters
    ----------
    index : (M,) int32
        Places in `rows` of the visible splats, in any order.
    rows : (n,) int32
        Ascending rows of the scene.
    ranks : (n,) int32
        Below 0; filled at the visible splats with their place in `ascending`.
    ascending : (M,) int32
        Filled with the visible rows.
    """
    for place in range(len(index)):
        ranks[index[place]] = 0
    count = 0
    for i in range(len(rows)):
        if ranks[i] == 0:
            ranks[i] = count
            ascending[count] = rows[i]
            count += 1


@kernel
def _reorder(
    index: NDArray[np.int32],
    ranks: NDArray[np.int32],
    shaded: NDArray[np.float32],
    colours: NDArray[np.float32],
) -> None:
    """Copy colours from ascending rows (`_rank`) to the order of the index."""
    for place in range(len(index)):
        rank = ranks[index[place]]
        for channel in range(3):
            colours[place, channel] = shaded[rank, channel]


def row_colours(
    splats: Splats, rows: NDArray[np.int32], camera: Camera, sh_degree: int | None = None
) -> NDArray[np.float32]:
    """Return the colours that some splats show to a camera, clamped at 0.

    Parameters
    ----------
    splats : Splats
    rows : (n,) int32
        In any order.
    camera : Camera
        In the frame of the means.
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
    rows: NDArray[np.int32],
    camera: Camera,
    footprints: Footprints,
    sh_degree: int | None = None,
) -> NDArray[np.float32]:
    """Return the colours of footprints in the order of the footprints, clamped at 0.

    The same as `row_colours` of ``rows[footprints.index]``. SH coefficients are most of a scene's
    bytes: read in ascending rows instead of nearest first, a million splats are shaded in a seventh
    of the time.

    Parameters
    ----------
    splats : Splats
    rows : (n,) int32
        Ascending rows of the scene: the splats that were projected.
    camera : Camera
        In the frame of the means.
    footprints : Footprints
        M of them; their `index` holds places in `rows`.
    sh_degree : int or None
        Highest SH degree used; None for the scene's own.

    Returns
    -------
    (M, 3) float32
    """
    ranks = np.full(len(rows), -1, np.int32)
    ascending = np.empty(len(footprints), np.int32)
    _rank(footprints.index, rows, ranks, ascending)
    colours = np.empty((len(footprints), 3), np.float32)
    shaded = row_colours(splats, ascending, camera, sh_degree)
    _reorder(footprints.index, ranks, shaded, colours)
    return colours
