"""How coarse every chunk may be: steps of equal slope from the energies of its splats."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .score import Scores

F64 = NDArray[np.float64]

# Squared error of the picture per squared step and energy, relative to a change of colour.
# Measured by perturbing trained scenes of three kinds (a captured room, a cleaned object, a
# figure) one attribute at a time; they agree within a factor of three, steps within 1.7.
COLOUR_COST: Final = 1.0
SH0_COST: Final = 0.28209479177387814**2  # Y_00 squared: sh0 to colour
OPACITY_COST: Final = 0.02
SCALE_FACTOR_COST: Final = 0.2
SCALE_COST: Final = 0.06
ROTATION_COST: Final = 0.48  # per squared step of a quaternion component, half the angle
MEAN_COST: Final = 0.04  # per squared step relative to the splat's mean deviation

# Attributes that share the error of a nominal quality.
_SHARES: Final = 8


def slope(scores: Scores, quality_db: float) -> float:
    """Return the squared colour step times energy that a nominal quality allows.

    Parameters
    ----------
    scores : Scores
    quality_db : float
        PSNR aimed at, dB. Nominal: what comes out depends on the scene.

    Returns
    -------
    float
        λ, so that a step Δ with ``cost · energy · Δ² = λ`` spends the same error on every bit.
    """
    seen = max(int((scores.energy > 0).sum()), 1)
    return float(12 * 10 ** (-quality_db / 10) / (_SHARES * seen))


def floor_energy(scores: Scores) -> F64:
    """Return (N,) energies of which none is zero.

    A splat that no scoring view shows may still be seen by a visitor: it counts as much as the
    faintest hundredth of those that were.
    """
    seen = scores.energy[scores.energy > 0]
    if len(seen) == 0:
        return np.ones_like(scores.energy)
    return np.maximum(scores.energy, np.quantile(seen, 0.01))


def step(slope_value: float, cost: float, energy: F64) -> float:
    """Return the step of a chunk: λ over the cost and the mean energy of its splats."""
    return float(np.sqrt(slope_value / (cost * energy.mean())))


def mean_step(slope_value: float, energy: F64, scales: NDArray[np.float32]) -> float:
    """Return the step of a chunk's means, scene units: relative to its splats' sizes.

    Parameters
    ----------
    slope_value : float
    energy : (n,) float64
    scales : (n, 3) float32
        Log.
    """
    # exp(-2·mean log): a small splat moved by the same step changes more of its pixels.
    inverse_size = np.exp(-2 * np.clip(scales.astype(np.float64).mean(axis=1), -40, 40))
    return float(np.sqrt(slope_value / (MEAN_COST * (energy * inverse_size).mean())))
