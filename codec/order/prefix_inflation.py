"""Prefix inflation: splats of a prefix made larger and more opaque, so that they leave no holes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

# The inflation that suits prefixes of a captured room and of two objects, by the number of their
# splats over the scene's `effective_splats`; the optimum is flat. A prefix that holds nearly all of
# the effective splats, in a good order, has no holes left.
_PARTS: Final = (0.0034, 0.0085, 0.017, 0.034, 0.085, 0.17, 0.34, 0.6, 0.85, 1.27)
_SCALES: Final = (0.47, 0.44, 0.42, 0.37, 0.28, 0.19, 0.12, 0.06, 0.02, 0.0)
_OPACITIES: Final = (2.2, 2.2, 2.2, 2.0, 1.7, 1.3, 0.9, 0.4, 0.15, 0.0)

# Share of the contribution that effective splats hold.
_EFFECTIVE_SHARE: Final = 0.95


@dataclass(frozen=True)
class Inflation:
    """How much larger and more opaque the splats of a prefix are drawn.

    Parameters
    ----------
    scales : float
        Added to the log scales, all three.
    opacities : float
        Added to the opacities' logits.
    """

    scales: float
    opacities: float


def effective_splats(contribution: NDArray[np.float64]) -> int:
    """Return the effective count of splats: how many of the largest hold 95 % of the contribution.

    Parameters
    ----------
    contribution : (N,) float64

    Returns
    -------
    int
        At least 1; N where nothing contributes.
    """
    running = np.cumsum(np.sort(contribution)[::-1])
    if not len(running) or not running[-1] > 0.0:
        return max(len(running), 1)
    return int(np.searchsorted(running, _EFFECTIVE_SHARE * running[-1])) + 1


def typical(part: float) -> Inflation:
    """Return the usual inflation of a prefix.

    Parameters
    ----------
    part : float
        Splats of the prefix over the scene's `effective_splats`.

    Returns
    -------
    Inflation
        Falls with `part`; none where the prefix has 1.27 times the effective splats or more.
    """
    at = np.log(max(part, _PARTS[0]))
    known = np.log(_PARTS)
    return Inflation(float(np.interp(at, known, _SCALES)), float(np.interp(at, known, _OPACITIES)))


def inflate(splats: Splats, by: Inflation) -> Splats:
    """Return splats with the inflation added to their log scales and opacity logits."""
    scales: NDArray[np.float32] = splats.scales + np.float32(by.scales)
    return replace(splats, scales=scales, opacities=splats.opacities + np.float32(by.opacities))
