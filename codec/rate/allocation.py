"""λ from the nominal quality, and the quantisation steps of equal λ that follow from costs."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores

from .costs import COARSEST_COLOUR, shown_energy

F64 = NDArray[np.float64]

# What shares the error of a nominal quality: the attributes of a splat, and more than one splat in
# every pixel. So that nominal and measured PSNR agree for a trained room at 40 dB.
_SHARES: Final = 24.5


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

    Notes
    -----
    Reverse water-filling (Cover and Thomas, Elements of Information Theory, section 10.3.3): a
    splat's error grows with λ until its steps are the coarsest, and no further. What its steps are
    finer for than its mean energy asks (`costs.shown_energy`) lowers its error in the mean.
    """
    aim = 12 * 10 ** (-quality_db / 10) / _SHARES
    seen = scores.energy > 0
    if not seen.any():
        return float(aim)
    shown = shown_energy(scores)[seen]
    order = np.argsort(shown, kind="stable")
    shown, energy = shown[order], scores.energy[seen][order]
    # From this λ on the steps of a splat are the coarsest; up to it its error is `share` times λ.
    ends = COARSEST_COLOUR**2 * shown
    share = energy / shown
    coarsest = np.cumsum(share * ends)
    growing = np.cumsum(share[::-1])[::-1] - share
    errors = coarsest + growing * ends
    row = int(np.searchsorted(errors, aim))
    if row == len(errors):
        # Not even the coarsest steps lose so much. λ grows on, for the values that have no limit.
        return float(ends[-1] + (aim - errors[-1]) / len(errors))
    before = coarsest[row - 1] if row else 0.0
    # Rounding must not carry it past the end of the row.
    return float(min((aim - before) / (growing[row] + share[row]), ends[row]))


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
