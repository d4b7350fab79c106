"""Positions mapped into the unit ball around a scene: directions are kept, distances shrink."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# Lower bound of the median distance of the centres, scene units.
_MIN_RADIUS: Final = 1e-9


def into_unit_ball(positions: F64, means: NDArray[np.floating]) -> F64:
    """Map positions into the unit ball, whose middle is the middle of a scene.

    The middle of a scene has the median of its centres on each axis, and r is the median distance
    of the centres from it. A position at a distance d from the middle keeps its direction, and its
    distance becomes d ÷ (d + r). So two cameras are close to each other if they see the scene from
    close positions, or from afar in the same direction.

    Parameters
    ----------
    positions : (n, 3) float64
        Positions, finite, scene units.
    means : (m, 3)
        Finite centres of splats, at least one, scene units; a random sample is enough.

    Returns
    -------
    (n, 3) float64
        Mapped positions, relative to the middle, of lengths from 0 to below 1; no unit.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.geometry.unit_ball import into_unit_ball
    >>> means = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    >>> into_unit_ball(np.array([[1.0, 0, 0], [99, 0, 0], [999, 0, 0]]), means)[:, 0].tolist()
    [0.5, 0.99, 0.999]
    """
    middle = np.median(means.astype(np.float64), axis=0)
    radius = max(float(np.median(np.linalg.norm(means - middle, axis=1))), _MIN_RADIUS)
    away = positions - middle
    mapped: F64 = away / (np.linalg.norm(away, axis=1, keepdims=True) + radius)
    return mapped
