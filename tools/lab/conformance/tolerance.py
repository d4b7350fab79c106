"""Tolerances of a viewer's arrays (SPEC 8.6), and of pictures (SPEC B.4)."""

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
# SPEC B.4.
PICTURE_VALUE: Final = 2.0**-10
PICTURE_RMS: Final = 1 / 80


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


def picture_fault(given: F32, exact: F32, *, is_viewer: bool) -> str:
    """Compare a picture with that of the vectors; return its fault, or "".

    Parameters
    ----------
    given, exact : (height, width, 3) float32
        Picture of the renderer under test, and the expected one.
    is_viewer : bool
        Whether the tolerance of viewers applies.
    """
    if is_viewer:
        error = np.clip(given, 0, 1).astype(np.float64) - np.clip(exact, 0, 1)
        rms = float(np.sqrt(np.square(error).mean()))
        return "" if rms <= PICTURE_RMS else f"a picture with an RMS error of {rms:.4f}"
    error = np.abs(given.astype(np.float64) - exact)
    if (error <= PICTURE_VALUE).all():
        return ""
    y, x, channel = (int(n) for n in np.argwhere(~(error <= PICTURE_VALUE))[0])
    return (
        f"{float(given[y, x, channel])!r} at x {x}, y {y}, channel {channel}, where the picture "
        f"has {float(exact[y, x, channel])!r}; {int((~(error <= PICTURE_VALUE)).sum())} of "
        f"{error.size} values differ"
    )
