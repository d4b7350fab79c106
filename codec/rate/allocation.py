"""How coarse every chunk may be: steps of equal λ from the energies of its splats."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores

from .costs import (
    MEAN_COST,
)

F64 = NDArray[np.float64]

# What shares the error of a nominal quality: the attributes of a splat, and more than one splat in
# every pixel. So that nominal and measured PSNR agree for a trained room at 35 to 47 dB; objects on
# black come out 3 dB above to 3 dB below.
_SHARES: Final = 22


def lagrangian(scores: Scores, quality_db: float) -> float:
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


def step(lagrangian: float, cost: float, energy: F64) -> float:
    """Return the step of a chunk: λ over the cost and the mean energy of its splats."""
    return float(np.sqrt(lagrangian / (cost * energy.mean())))


def mean_step(lagrangian: float, energy: F64, scales: NDArray[np.float32]) -> float:
    """Return the step of a chunk's means, scene units: relative to its splats' sizes.

    Parameters
    ----------
    lagrangian : float
    energy : (n,) float64
    scales : (n, 3) float32
        Log.
    """
    # exp(-2·mean log): a small splat moved by the same step changes more of its pixels.
    inverse_size = np.exp(-2 * np.clip(scales.astype(np.float64).mean(axis=1), -40, 40))
    return float(np.sqrt(lagrangian / (MEAN_COST * (energy * inverse_size).mean())))


_SHN_WEIGHT: Final = 0.7


# What no view weighs could be as coarse as one likes; the format ends at 2^32 (SPEC 6.14).
_COARSEST_STEP: Final = 2.0**30


def equal_step(lagrangian: float, cost: F64) -> float:
    """Return the step of a chunk whose mean cost is what counts."""
    return min(float(np.sqrt(lagrangian / cost.mean())), _COARSEST_STEP)


def own_steps(lagrangian: float, cost: F64) -> F64:
    """Return the step of every splat."""
    steps: F64 = np.sqrt(lagrangian / cost)
    return steps


def shn_step(lagrangian: float, energy: F64) -> float:
    """Return the step of a chunk's coordinates on the basis of shN."""
    return equal_step(lagrangian, _SHN_WEIGHT * energy)
