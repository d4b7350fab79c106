"""Low-discrepancy sequences, whose first n points cover a range evenly for every n."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# Multiples of these steps, modulo 1, cover the unit interval, square and cube evenly. In d
# dimensions the steps are powers of 1/x, where x^(d+1) = x + 1 (Roberts 2018, "The unreasonable
# effectiveness of quasirandom sequences"). x is the golden ratio (d = 1), the plastic number
# (d = 2) or 1.2207 (d = 3).
STEP_1D: Final = (math.sqrt(5.0) - 1.0) / 2.0
_PLASTIC: Final = 1.3247179572447460
_ROOT_3D: Final = 1.2207440846057596
STEPS_2D: Final = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])
STEPS_3D: Final = np.array([1.0 / _ROOT_3D, 1.0 / _ROOT_3D**2, 1.0 / _ROOT_3D**3])

# The smaller part of a full turn cut by the golden ratio, radians.
_GOLDEN_ANGLE: Final = math.pi * (3.0 - math.sqrt(5.0))


def sequence(numbers: NDArray[np.integer], steps: F64) -> F64:
    """Return points of a low-discrepancy sequence.

    Parameters
    ----------
    numbers : (n,) integer
        Numbers of the points, possibly negative. Points of consecutive numbers cover the unit
        square or cube evenly.
    steps : (d,) float64
        `STEPS_2D` for the square, `STEPS_3D` for the cube.

    Returns
    -------
    (n, d) float64
        Points in [0, 1).

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.views.low_discrepancy import STEPS_2D, sequence
    >>> sequence(np.arange(3), STEPS_2D).round(2).tolist()
    [[0.5, 0.5], [0.25, 0.07], [0.01, 0.64]]
    """
    points: F64 = (0.5 + numbers[:, None] * steps) % 1.0
    return points


def even_directions(count: int) -> F64:
    """Return unit vectors spread evenly over the sphere: a Fibonacci lattice.

    Parameters
    ----------
    count : int
        Number of directions, at least 1.

    Returns
    -------
    (count, 3) float64
        Unit vectors by descending y.
    """
    k = np.arange(count)
    y = 1.0 - (2.0 * k + 1.0) / count
    ring = np.sqrt(1.0 - y * y)
    return np.stack([ring * np.cos(_GOLDEN_ANGLE * k), y, ring * np.sin(_GOLDEN_ANGLE * k)], axis=1)
