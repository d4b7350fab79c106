"""Prefix inflation: larger and more opaque splats, so that a prefix leaves no holes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

# Best inflation of prefixes, measured on a captured room and two objects, by the number of their
# splats over the scene's `effective_splats`; the optimum is flat. In a good order, a prefix with
# nearly all effective splats has no holes.
_RELATIVE_SIZES: Final = (0.0034, 0.0085, 0.017, 0.034, 0.085, 0.17, 0.34, 0.6, 0.85, 1.27)
_SCALES: Final = (0.47, 0.44, 0.42, 0.37, 0.28, 0.19, 0.12, 0.06, 0.02, 0.0)
_OPACITIES: Final = (2.2, 2.2, 2.2, 2.0, 1.7, 1.3, 0.9, 0.4, 0.15, 0.0)

# Share of the contribution that effective splats hold.
_EFFECTIVE_SHARE: Final = 0.95


@dataclass(frozen=True)
class Inflation:
    """Offsets that make the splats of a prefix larger and more opaque.

    Parameters
    ----------
    scales : float
        Offset of all three log scales.
    opacities : float
        Offset of the opacity logits.
    """

    scales: float
    opacities: float


def effective_splats(contribution: NDArray[np.float64]) -> int:
    """Return the smallest number of splats that together hold 95 % of the contribution.

    Parameters
    ----------
    contribution : (N,) float64
        Contribution of each splat.

    Returns
    -------
    int
        Number of splats, at least 1; N if no splat contributes.
    """
    running = np.cumsum(np.sort(contribution)[::-1])
    if not len(running) or not running[-1] > 0.0:
        return max(len(running), 1)
    return int(np.searchsorted(running, _EFFECTIVE_SHARE * running[-1])) + 1


def best_inflation(relative_size: float) -> Inflation:
    """Return the offsets of log scales and opacities that best close the holes of a prefix.

    They are interpolated between offsets measured on three scenes.

    Parameters
    ----------
    relative_size : float
        Splats of the prefix divided by the scene's `effective_splats`; may exceed 1.

    Returns
    -------
    Inflation
        Offsets, largest for short prefixes; zero at a relative size of 1.27 or more.
    """
    at = np.log(max(relative_size, _RELATIVE_SIZES[0]))
    known = np.log(_RELATIVE_SIZES)
    return Inflation(float(np.interp(at, known, _SCALES)), float(np.interp(at, known, _OPACITIES)))


def inflate(splats: Splats, inflation: Inflation) -> Splats:
    """Return splats with the offsets added to their log scales and opacity logits."""
    scales: NDArray[np.float32] = splats.scales + np.float32(inflation.scales)
    opacities = splats.opacities + np.float32(inflation.opacities)
    return replace(splats, scales=scales, opacities=opacities)
