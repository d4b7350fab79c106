"""λ from the nominal quality, and the quantisation steps of equal λ that follow from costs."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores

F64 = NDArray[np.float64]

# What shares the error of a nominal quality: the attributes of a splat, and more than one splat in
# every pixel. So that nominal and measured PSNR agree for a trained room at 35 to 47 dB; objects on
# black come out 3 dB above to 3 dB below.
_SHARES: Final = 22


def lagrangian(scores: Scores, quality_db: float) -> float:
    """Return λ, the cost times squared step of every stored value, of a nominal quality.

    Parameters
    ----------
    scores : Scores
    quality_db : float
        PSNR aimed at, dB. Nominal: what comes out depends on the scene.

    Returns
    -------
    float
        With steps Δ of ``cost · Δ² = λ`` one more bit of any value removes the same error.
    """
    seen = max(int((scores.energy > 0).sum()), 1)
    return float(12 * 10 ** (-quality_db / 10) / (_SHARES * seen))


# What renders of trained scenes found the cost of shN to be, relative to its energy.
_SHN_WEIGHT: Final = 0.7


# The cost of what no view shows may be 0, which allows any step; the format ends at 2^32
# (SPEC 6.14).
_COARSEST_STEP: Final = 2.0**30


def equal_step(lagrangian: float, cost: F64) -> float:
    """Return one step for values of these costs, (n,) float64: λ over their mean."""
    return min(float(np.sqrt(lagrangian / cost.mean())), _COARSEST_STEP)


def own_steps(lagrangian: float, cost: F64) -> F64:
    """Return a step for each value of these costs, (n,) float64."""
    steps: F64 = np.sqrt(lagrangian / cost)
    return steps


def shn_step(lagrangian: float, energy: F64) -> float:
    """Return the step of a chunk's coordinates on the basis of shN, from (n,) energies."""
    return equal_step(lagrangian, _SHN_WEIGHT * energy)
