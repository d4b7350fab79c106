"""Rate allocation: λ from the nominal quality, and quantisation steps of equal λ."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores

from .costs import coarsest_colour, robust_energy

F64 = NDArray[np.float64]

# Independent errors that add up in one pixel: several attributes of several splats. Set so that
# nominal and measured PSNR agree for a trained room at 40 dB.
_ERRORS_PER_PIXEL: Final = 24.5


def lagrangian(scores: Scores, quality_db: float) -> float:
    """Return the Lagrangian λ for a nominal quality.

    Parameters
    ----------
    scores : Scores
        Energies of all splats of the scene.
    quality_db : float
        Nominal PSNR, dB. The measured PSNR differs from it by scene.

    Returns
    -------
    float
        λ. With steps Δ that satisfy ``cost · Δ² = λ``, one more bit of any value removes the same
        error.

    Notes
    -----
    Reverse water-filling (Cover and Thomas, Elements of Information Theory, section 10.3.3): a
    splat's error grows with λ until its steps reach the coarsest step, then stays constant. Steps
    follow from `costs.robust_energy`; where it exceeds a splat's mean energy, steps are finer and
    the mean error is smaller.
    """
    aim = 12 * 10 ** (-quality_db / 10) / _ERRORS_PER_PIXEL
    seen = scores.energy > 0
    if not seen.any():
        return float(aim)
    shown = robust_energy(scores)[seen]
    order = np.argsort(shown, kind="stable")
    shown, energy = shown[order], scores.energy[seen][order]
    # Up to λ = `ends` a splat's error is `share` times λ; beyond, its steps are the coarsest.
    ends = coarsest_colour(scores) ** 2 * shown
    share = energy / shown
    coarsest = np.cumsum(share * ends)
    growing = np.cumsum(share[::-1])[::-1] - share
    errors = coarsest + growing * ends
    row = int(np.searchsorted(errors, aim))
    if row == len(errors):
        # Even the coarsest steps lose less than `aim`. λ still grows: some values have no limit.
        return float(ends[-1] + (aim - errors[-1]) / len(errors))
    before = coarsest[row - 1] if row else 0.0
    # Rounding must not carry λ past the end of the row.
    return float(min((aim - before) / (growing[row] + share[row]), ends[row]))


# Cost of shN relative to its energy, measured in renders of trained scenes.
_SHN_WEIGHT: Final = 0.7


# Splats that no view shows may cost 0, which allows any step; the format's limit is 2^32
# (SPEC 6.14).
_COARSEST_STEP: Final = 2.0**30


def equal_step(lagrangian: float, cost: F64) -> float:
    """Return the common step of values with (n,) float64 costs: √(λ / mean cost)."""
    return min(float(np.sqrt(lagrangian / cost.mean())), _COARSEST_STEP)


def step_per_value(lagrangian: float, cost: F64) -> F64:
    """Return the step of each value, (n,) float64, from the value's cost: √(λ / cost)."""
    steps: F64 = np.sqrt(lagrangian / cost)
    return steps


def bit_price(lagrangian: float) -> float:
    """Return the error that one bit removes from a value quantised at λ."""
    # A value of step Δ has an error of cost · Δ²/12 = λ/12, and a bit more quarters it.
    return float(2 * np.log(2) * lagrangian / 12)


def shn_cost(energy: F64) -> F64:
    """Return the squared picture error per squared error of a coordinate of shN, (n,) float64."""
    return _SHN_WEIGHT * energy


def shn_step(lagrangian: float, energy: F64) -> float:
    """Return the step of a chunk's shN coordinates from its splats' energies, (n,) float64."""
    return equal_step(lagrangian, shn_cost(energy))
