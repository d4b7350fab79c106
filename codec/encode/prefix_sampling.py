"""Choose prefixes of a scene to measure, and interpolate the measured values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def choose_prefixes(chunk_splats: Sequence[int], most: int) -> I64:
    """Choose the prefixes to measure when measuring each would take too long.

    Parameters
    ----------
    chunk_splats : sequence of int
        Splats of each chunk, at least 1 each.
    most : int
        Number of prefixes at most, at least 2.

    Returns
    -------
    (m,) int64
        Number of chunks of each prefix, ascending from 1 to all; empty for a scene without chunks.

    Notes
    -----
    Prefixes are spaced evenly by the square root of their length: render time is proportional to
    the length, and quality rises fastest for short ones. Measured on two captured scenes: 8 such
    prefixes, 3 times the scene's splats in total, interpolate PSNR as well as 10 evenly spaced ones
    of 5 times its splats (0.3 dB off on average).
    """
    ends = np.cumsum(np.asarray(chunk_splats, np.int64))
    if len(ends) <= most:
        return np.arange(1, len(ends) + 1)
    roots = np.sqrt(ends.astype(np.float64))
    wanted = np.linspace(roots[0], roots[-1], most)
    right = np.clip(np.searchsorted(roots, wanted), 1, len(ends) - 1)
    is_left = wanted - roots[right - 1] <= roots[right] - wanted
    return np.unique(np.where(is_left, right, right + 1))


def interpolate_prefixes(chunk_splats: Sequence[int], measured: I64, values: F64) -> F64:
    """Interpolate a value of all prefixes from measured prefixes.

    Parameters
    ----------
    chunk_splats : sequence of int
        Splats of each chunk, at least 1 each.
    measured : (m,) int64
        Number of chunks of each measured prefix, ascending.
    values : (m,) float64
        Measured values, such as PSNR.

    Returns
    -------
    (c,) float64
        Values of the prefixes of 1, 2, … c chunks, linear in the logarithm of the splat count
        between measured ones.
    """
    if not len(measured):
        return np.zeros(0)
    at = np.log(np.cumsum(np.asarray(chunk_splats, np.float64)))
    return np.interp(at, at[measured - 1], values)
