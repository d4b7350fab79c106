"""Splats made larger and more opaque, so that few of them leave no holes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

# What prefixes of a captured room and of two objects need, by how many splats they have for each of
# those that carry most of the contribution (`effective_splats`); the optimum is flat. By the time a
# good order has brought most of these, no holes are left.
_PARTS: Final = (0.0034, 0.0085, 0.017, 0.034, 0.085, 0.17, 0.34, 0.6, 0.85, 1.27)
_CARRIED: Final = 0.95
_SCALES: Final = (0.47, 0.44, 0.42, 0.37, 0.28, 0.19, 0.12, 0.06, 0.02, 0.0)
_OPACITIES: Final = (2.2, 2.2, 2.2, 2.0, 1.7, 1.3, 0.9, 0.4, 0.15, 0.0)


@dataclass(frozen=True)
class Inflation:
    """What is added to the splats of a prefix.

    Parameters
    ----------
    scales : float
        To the logarithms of all three standard deviations.
    opacities : float
        To the logits.
    """

    scales: float
    opacities: float


def effective_splats(contribution: NDArray[np.float64]) -> int:
    """Return how many splats, the largest first, carry 95 % of a scene's contribution.

    Parameters
    ----------
    contribution : (N,) float64

    Returns
    -------
    int
        At least 1; N where nothing contributes.
    """
    carried = np.cumsum(np.sort(contribution)[::-1])
    if not len(carried) or not carried[-1] > 0.0:
        return max(len(carried), 1)
    return int(np.searchsorted(carried, _CARRIED * carried[-1])) + 1


def typical(part: float) -> Inflation:
    """Return the usual inflation of a prefix with `part` times the `effective_splats`."""
    at = np.log(max(part, _PARTS[0]))
    known = np.log(_PARTS)
    return Inflation(float(np.interp(at, known, _SCALES)), float(np.interp(at, known, _OPACITIES)))


def inflate(splats: Splats, by: Inflation) -> Splats:
    """Return splats with something added to their scales and opacities."""
    scales: NDArray[np.float32] = splats.scales + np.float32(by.scales)
    return replace(splats, scales=scales, opacities=splats.opacities + np.float32(by.opacities))
