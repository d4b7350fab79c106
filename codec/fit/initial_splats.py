"""Initial splats: one for each point of a structure-from-motion model."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients

# Neighbours whose mean distance is the initial size (Kerbl et al. 2023, section 5.1).
_NEIGHBOURS: Final = 3
# Initial opacity and minimum size, as in the code of Kerbl et al.
_OPACITY: Final = 0.1
_MIN_SIZE: Final = math.sqrt(1e-7)


def splats_from_points(
    positions: NDArray[np.float64],
    colours: NDArray[np.uint8],
    *,
    sh_degree: int = MAX_SH_DEGREE,
) -> Splats:
    """Initialise splats from points as 3DGS does (Kerbl et al. 2023, section 5.1).

    Parameters
    ----------
    positions : (P, 3) float64
        Finite positions, scene units.
    colours : (P, 3) uint8
        RGB, display-referred.
    sh_degree : int
        SH degree of the splats; coefficients above degree 0 are 0.

    Returns
    -------
    Splats
        P isotropic splats of opacity 0.1; the size is the mean distance to the 3 nearest points.
        Positions outside the range of float32 give invalid rows (`Splats.invalid_rows`).

    Raises
    ------
    ValueError
        `positions` is empty.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.fit.initial_splats import splats_from_points
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    >>> splats = splats_from_points(corners, np.full((4, 3), 255, np.uint8))
    >>> float(np.exp(splats.scales[0, 0]).round(3)), splats.sh_degree
    (1.0, 3)
    """
    from scipy.spatial import KDTree

    count = len(positions)
    if not count:
        raise ValueError("no points, expected at least one")
    nearest = min(_NEIGHBOURS, count - 1)
    distances = np.ones((count, 1))
    if nearest:
        # The first neighbour, left out here, is the point itself.
        with np.errstate(over="ignore"):
            distances, _ = KDTree(positions).query(positions, k=np.arange(2, nearest + 2))
    sizes = np.maximum(distances.mean(axis=1), _MIN_SIZE)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1.0
    with np.errstate(over="ignore"):
        means = positions.astype(np.float32)
    coefficients = (colours.astype(np.float64) / 255 - COLOUR_OFFSET) / C0
    return Splats(
        means=means,
        scales=np.repeat(np.log(sizes)[:, None], 3, axis=1).astype(np.float32),
        quats=quats,
        opacities=np.full(count, math.log(_OPACITY / (1 - _OPACITY)), np.float32),
        sh0=coefficients.astype(np.float32),
        shN=np.zeros((count, sh_coefficients(sh_degree) - 1, 3), np.float32),
    )
