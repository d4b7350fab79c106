"""Tolerances of a viewer's arrays against exact decoding (SPEC 8.6)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

# SPEC 8.6, table of tolerances.
MEANS_RELATIVE: Final = 2.0**-10
MEANS_SIGMAS: Final = 0.125
SCALES: Final = 0.05
QUAT_ANGLE: Final = 0.02
OPACITY_UNIT: Final = 1 / 128
SH0: Final = 0.02
SHN: Final = 0.04


def beyond_tolerance(name: str, given: F32, exact: F32, rows: dict[str, F32]) -> NDArray[np.bool_]:
    """Mark the values of one array whose error exceeds the tolerance of SPEC 8.6.

    Parameters
    ----------
    name : str
        ``means``, ``scales``, ``quats``, ``opacities``, ``sh0`` or ``shN``.
    given, exact : (n, ...) float32
        Values of the viewer under test, and of an exact decoder.
    rows : dict of str to array
        All exact arrays by name; the tolerance of means depends on the scales.

    Returns
    -------
    (n, ...) bool
        True for values beyond the tolerance.
    """
    wide, true = given.astype(np.float64), exact.astype(np.float64)
    if name == "quats":
        # The angle between two rotations is twice that between their quaternions.
        cosine = np.abs((wide * true).sum(axis=1)) / np.maximum(np.linalg.norm(wide, axis=1), 1e-9)
        far = 2 * np.arccos(np.minimum(cosine, 1.0)) > QUAT_ANGLE
        return np.array(np.repeat(far[:, None], 4, axis=1), np.bool_)
    if name == "opacities":
        with np.errstate(over="ignore"):
            error = np.abs(1 / (1 + np.exp(-wide)) - 1 / (1 + np.exp(-true)))
        return np.array(~(error <= OPACITY_UNIT), np.bool_)
    error = np.abs(wide - true)
    if name == "means":
        sigma = np.exp(rows["scales"].astype(np.float64).min(axis=1))[:, None]
        allowed = np.maximum(MEANS_RELATIVE * np.abs(true), MEANS_SIGMAS * sigma)
        return np.array(~(error <= allowed), np.bool_)
    return np.array(~(error <= {"scales": SCALES, "sh0": SH0, "shN": SHN}[name]), np.bool_)
