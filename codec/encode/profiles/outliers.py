"""Limits of scales and SH coefficients that the profiles for viewing quantise."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

F32 = NDArray[np.float32]

MAX_COEFFICIENT: Final = 1e4
"""Limit of SH coefficients, either sign. One such splat saturates a pixel at the least alpha; an
outlier would coarsen the steps of all values on its grid."""

MAX_LOG_SCALE: Final = 40.0
"""Limit of log scales, either sign: deviations of 4e-18 and 2e17 scene units."""


def clip_coefficients(values: F32) -> F32:
    """Clip SH coefficients to ±`MAX_COEFFICIENT`.

    Parameters
    ----------
    values : float32 array
        Coefficients; returned without a copy if all are within the limit.
    """
    return _clip(values, MAX_COEFFICIENT)


def clip_outliers(splats: Splats) -> Splats:
    """Clip the scales of a scene to ±`MAX_LOG_SCALE` and its SH to ±`MAX_COEFFICIENT`.

    Parameters
    ----------
    splats : Splats
        Scene to clip.
    """
    return replace(
        splats,
        scales=_clip(splats.scales, MAX_LOG_SCALE),
        sh0=clip_coefficients(splats.sh0),
        shN=clip_coefficients(splats.shN),
    )


def _clip(values: F32, limit: float) -> F32:
    """Clip values to a limit of either sign, without a copy where none exceeds it."""
    # Check first: hardly any scene has outliers, and a copy of shN is large.
    if -float(values.min(initial=0)) > limit or float(values.max(initial=0)) > limit:
        return np.clip(values, -limit, limit)
    return values
