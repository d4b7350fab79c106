"""Up direction of a scene: from its cameras, or from its planes and where its mass rests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

from .subsample import Subsample

F64 = NDArray[np.float64]

# Mean square of the cameras' right axes along the second direction below which all cameras have
# nearly the same heading (about 6° apart). Their right axes then say nothing of the pitch.
_LEAST_SPREAD: Final = 0.01
# Share of the spread of the right axes out of the horizontal plane, relative to that within it,
# above which the cameras roll too much to agree on a horizontal plane.
_MOST_ROLL: Final = 0.4
# Sine of the angle out of the horizontal plane from which on a camera counts less, and rounds of
# reweighting.
_OUTLIER_SINE: Final = 0.03
_ROUNDS: Final = 10
# Length of the mean up axis below which the cameras point up in all directions.
_LEAST_MEAN: Final = 0.2


def up_from_cameras(cameras: Sequence[Camera], usual: F64) -> F64:
    """Return the up direction that cameras agree on.

    People hold cameras level: up is orthogonal to their right axes. Where the right axes do not
    show it, up is the mean of the cameras' up axes.

    Parameters
    ----------
    cameras : sequence of Camera
        At least one.
    usual : (3,) float64
        Unit vector against gravity by the axes of the format, for cameras that contradict each
        other.

    Returns
    -------
    (3,) float64
        Unit vector in the frame of the cameras.
    """
    rights = np.array([camera.rotation[0] for camera in cameras])
    mean = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    fallback = mean / length if length >= _LEAST_MEAN else usual
    weights = np.ones(len(rights))
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh((rights * weights[:, None]).T @ rights / weights.sum())
        found: F64 = vectors[:, 0]
        weights = 1.0 / np.maximum(np.abs(rights @ found), _OUTLIER_SINE)
    if values[1] < _LEAST_SPREAD:
        # One heading: the mean up axis, made orthogonal to the right axis that all share.
        level = fallback - (fallback @ vectors[:, 2]) * vectors[:, 2]
        size = float(np.linalg.norm(level))
        return level / size if size > math.sqrt(_LEAST_SPREAD) else fallback
    if values[0] > _MOST_ROLL * values[1]:
        return fallback
    towards = float(found @ fallback)
    return found if towards >= 0.0 else -found


def up_from_splats(scene: Subsample, core: F64, usual: F64) -> F64:
    """Return the up direction that a scene's splats show."""
    return usual
