"""Places of cameras as a scene sees them: far ones differ by their direction, not by kilometres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def places_as_seen(positions: F64, means: NDArray[np.floating]) -> F64:
    """Map positions into the unit ball around a scene.

    A position at a distance d from the middle of the scene keeps its direction and gets the
    distance d ÷ (d + r), where half of the centres are nearer to the middle than r.

    Parameters
    ----------
    positions : (n, 3) float64
        Positions, scene units.
    means : (m, 3)
        Finite centres that are drawn evenly from the scene, at least one, scene units.

    Returns
    -------
    (n, 3) float64

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.geometry.places_as_seen import places_as_seen
    >>> means = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    >>> places_as_seen(np.array([[1.0, 0, 0], [99, 0, 0], [999, 0, 0]]), means)[:, 0].tolist()
    [0.5, 0.99, 0.999]
    """
    middle = np.median(means.astype(np.float64), axis=0)
    radius = max(float(np.median(np.linalg.norm(means - middle, axis=1))), 1e-9)
    away = positions - middle
    seen: F64 = away / (np.linalg.norm(away, axis=1, keepdims=True) + radius)
    return seen
