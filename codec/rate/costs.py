"""What an error of each stored value costs the picture: sensitivities as squared error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

# Squared error of the picture per squared step and energy, relative to a change of colour.
# Measured by perturbing trained scenes of three kinds (a captured room, a cleaned object, a
# figure) one attribute at a time; they agree within a factor of three, steps within 1.7.
SH0_BASIS: Final = 0.28209479177387814  # Y_00: sh0 to colour
SH0_COST: Final = SH0_BASIS**2
OPACITY_COST: Final = 0.02
SCALE_FACTOR_COST: Final = 0.2
SCALE_COST: Final = 0.06
ROTATION_COST: Final = 0.48  # per squared step of a quaternion component, half the angle
MEAN_COST: Final = 0.04  # per squared step relative to the splat's mean deviation

# Squared radians per squared value of swing or twist, the mean over swings of up to 90°.
_ROTATION_VALUE_COST: Final = 2.5


# One view in so many is taken to show a splat as the view does that shows it best. The scoring
# views are a sample: what one of them shows by chance, many of a visitor's views may show. At 32,
# three scenes of thin and of hollow objects lose up to 1.3 % of their bytes at equal mean PSNR, a
# trained one gains 0.3 %, and of a captured room's splats 1.5 % count more than their mean.
_VIEWS_PER_BEST: Final = 32


def shown_energy(scores: Scores) -> F64:
    """Return (N,) energies that visitors' views may have: of splats that few views show, more.

    The mean over the scoring views says nothing of the view that an error spoils most: a splat
    counts at least a fixed share of its `Scores.largest_energy`.
    """
    return np.maximum(scores.energy, scores.largest_energy / _VIEWS_PER_BEST)


def floor_energy(scores: Scores, rows: NDArray[np.int64] | None = None) -> F64:
    """Return (N,) energies of which none is zero, or (n,) of some rows as if there were no others.

    They are those of `shown_energy`. A splat that no scoring view shows at all may still be seen by
    a visitor: it counts as much as the faintest hundredth of those that were.
    """
    energy = scores.energy if rows is None else scores.energy[rows]
    seen = energy[energy > 0]
    if len(seen) == 0:
        return np.ones_like(energy)
    shown = shown_energy(scores)
    return np.maximum(shown if rows is None else shown[rows], np.quantile(seen, 0.01))


@dataclass(frozen=True, eq=False)
class Costs:
    """Squared error of the picture per squared error of a stored value, splat by splat.

    Parameters
    ----------
    energy : (n,) float64
        Of colour.
    mean : (n,) float64
        Of a coordinate, per squared scene unit.
    opacity : (n,) float64
        Of the logit.
    scale_long, scale_middle, scale_thin : (n,) float64
        Of the three scale differences: of all log scales, of the two shorter, of the shortest.
    swing, twist : (n,) float64
        Of the values that rotations are stored as (SPEC 6.11): both of swing, and twist.
    basis_mean : (n, K-1) float64
        `Scores.basis_mean`.
    """

    energy: F64
    mean: F64
    opacity: F64
    scale_long: F64
    scale_middle: F64
    scale_thin: F64
    swing: F64
    twist: F64
    basis_mean: F64

    def take(self, rows: NDArray[np.int64] | slice) -> Costs:
        """Return the costs of some rows."""
        return Costs(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def levelled(self) -> Costs:
        """Return the same costs for every row: their means, from which equal steps follow."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        level = {name: np.full_like(x, x.mean()) for name, x in values.items() if x.ndim == 1}
        return replace(self, **level)


# Coarsest steps worth writing. What no scoring view weighs may still come into a visitor's: such
# splats stay where they are and about as large, as dark and as clear as they were.
COARSEST_COLOUR: Final = 0.15
"""Coarsest step of a colour, of 0 to 1."""
_OPACITY_LIMIT: Final = 1.0
_SCALE_LIMITS: Final = (0.35, 0.5, 0.7)  # long, middle, thin; log
_MEAN_LIMIT: Final = 1.0  # deviations
# A rotation is off by at most its step, radians: swing and twist are tangents of half an angle. Of
# an axis of length L and a shortest of length t, a tilt δ adds (L² - t²)·δ² to the squared
# thickness of the surface that the splat lies in: at most t², or the square of this share of L
# where that is more. Views that show a surface from its edge are few, and no derivative says what
# tilts of many splats that lie behind each other do there: all make it thicker. At the nominal
# quality of 40 dB the worst of 24 views of a flat card is 2.4 dB below their mean with this limit,
# 8.7 dB without, in as many bytes.
_TILT_SHARE: Final = 0.3

# Least cost of each value relative to its splat's energy. Sensitivities hold for small errors
# only: what happens to match its surroundings now would show once it moved.
_MEAN_FLOOR: Final = 1e-3  # per squared deviation
_OPACITY_FLOOR: Final = 1e-3
_SCALE_FLOOR: Final = 3e-3
_ROTATION_FLOOR: Final = 3e-3

# Sensitivities are raised with their energy by no more than this: beyond it, the view that shows a
# splat best shows a pixel or two of it.
_MOST_RISE: Final = 1e3

# What renders of three trained scenes at 35 to 45 dB found the real costs to be, relative to the
# sensitivities: steps are coarse there, and errors of one value partly hide another's.
_OPACITY_WEIGHT: Final = 1.3
_MIDDLE_WEIGHT: Final = 2.0
_THIN_WEIGHT: Final = 1.5
_ROTATION_WEIGHT: Final = 1.7
SH0_WEIGHT: Final = 0.6


def costs(splats: Splats, scores: Scores, energy: F64 | None = None) -> Costs:
    """Return what errors cost, from the sensitivities of a scoring pass or from energies alone.

    Parameters
    ----------
    splats : Splats
    scores : Scores
        Without sensitivities the constants of this module stand in for them.
    energy : (n,) float64, optional
        `floor_energy` of the whole scene at these splats; None where these are the whole scene.
    """
    if energy is None:
        energy = floor_energy(scores)
    order = np.argsort(splats.scales, axis=1, kind="stable")
    sizes = np.take_along_axis(splats.scales, order, axis=1).astype(np.float64)
    basis_mean = scores.basis_mean[:, : splats.shN.shape[1]].astype(np.float64)
    estimated = _estimated(energy, sizes, basis_mean)
    found = scores.sensitivities
    if found is None:
        return estimated
    # Where the energy was raised, so are the sensitivities that go with it.
    rise = np.divide(
        shown_energy(scores), scores.energy, out=np.ones_like(energy), where=scores.energy > 0
    )
    rise = np.minimum(rise, _MOST_RISE)
    thin = np.exp(-2 * np.clip(sizes[:, 0], -40, 40))
    by_size = np.take_along_axis(found.scales, order, axis=1) * rise[:, None]
    by_axis = np.take_along_axis(found.rotations, order, axis=1) * rise[:, None]
    reach = np.minimum(thin, 20 * np.exp(-2 * np.clip(sizes.mean(axis=1), -40, 40)))
    swung = _ROTATION_VALUE_COST * 0.5 * (by_axis[:, 0] + by_axis[:, 1])
    # Swing and twist are tangents of half an angle: twice the sensitivity of a radian or more.
    measured = Costs(
        energy=energy,
        mean=np.maximum(rise * found.means.mean(axis=1), _MEAN_FLOOR * energy * reach),
        opacity=_OPACITY_WEIGHT * np.maximum(rise * found.opacities, _OPACITY_FLOOR * energy),
        scale_long=np.maximum(by_size.sum(axis=1), _SCALE_FLOOR * energy),
        scale_middle=_MIDDLE_WEIGHT
        * np.maximum(by_size[:, 0] + by_size[:, 1], _SCALE_FLOOR * energy),
        scale_thin=_THIN_WEIGHT * np.maximum(by_size[:, 0], _SCALE_FLOOR * energy),
        swing=_ROTATION_WEIGHT * np.maximum(swung, _ROTATION_FLOOR * energy),
        twist=_ROTATION_WEIGHT
        * np.maximum(_ROTATION_VALUE_COST * by_axis[:, 2], _ROTATION_FLOOR * energy),
        basis_mean=basis_mean,
    )
    # Sensitivities are measured in some of the views only: of what these do not show, no
    # sensitivity says that errors cost nothing.
    unmeasured = (found.opacities + found.means.sum(axis=1) <= 0.0) & (shown_energy(scores) > 0.0)
    return Costs(
        *(
            np.where(unmeasured, getattr(estimated, name), getattr(measured, name))
            if getattr(measured, name).ndim == 1
            else getattr(measured, name)
            for name in Costs.__dataclass_fields__
        )
    )


def _estimated(energy: F64, sizes: F64, basis_mean: F64) -> Costs:
    """Return what errors usually cost splats of some energies, by the constants of this module.

    Parameters
    ----------
    energy : (n,) float64
    sizes : (n, 3) float64
        Log scales, the smallest first.
    basis_mean : (n, K-1) float64
    """
    mean_size = np.exp(-2 * np.clip(sizes.mean(axis=1), -40, 40))
    flat = np.square(np.clip(1 - np.exp(2 * (sizes[:, 0] - sizes[:, 2])), 0, 1))
    return Costs(
        energy=energy,
        mean=MEAN_COST * energy * mean_size,
        opacity=OPACITY_COST * energy,
        scale_long=3 * SCALE_COST * energy,
        scale_middle=2 * SCALE_COST * energy,
        scale_thin=SCALE_COST * energy,
        swing=ROTATION_COST * energy * np.maximum(flat, 0.05),
        twist=0.5 * ROTATION_COST * energy * np.maximum(flat, 0.05),
        basis_mean=basis_mean,
    )


def limited(found: Costs, scales: NDArray[np.float32], lagrangian: float) -> Costs:
    """Return costs that give no step beyond the coarsest worth writing.

    Parameters
    ----------
    found : Costs
    scales : (n, 3) float32
        Log.
    lagrangian : float
    """
    size = np.exp(np.clip(scales.astype(np.float64).mean(axis=1), -40, 40))
    long, middle, thin = (lagrangian / limit**2 for limit in _SCALE_LIMITS)
    sizes = np.clip(np.sort(scales.astype(np.float64), axis=1), -40, 40)
    # Of the longest axis, which swings, and of the middle one, which a twist tilts.
    swung, twisted = (
        lagrangian * (1 - flat) / np.maximum(flat, _TILT_SHARE**2)
        for flat in (np.exp(2 * (sizes[:, 0] - sizes[:, axis])) for axis in (2, 1))
    )
    return replace(
        found,
        energy=limited_energy(found.energy, lagrangian),
        mean=np.maximum(found.mean, lagrangian / np.square(_MEAN_LIMIT * size)),
        opacity=np.maximum(found.opacity, lagrangian / _OPACITY_LIMIT**2),
        scale_long=np.maximum(found.scale_long, long),
        scale_middle=np.maximum(found.scale_middle, middle),
        scale_thin=np.maximum(found.scale_thin, thin),
        swing=np.maximum(found.swing, swung),
        twist=np.maximum(found.twist, twisted),
    )


def limited_energy(energy: F64, lagrangian: float) -> F64:
    """Return energies that give no step of colour beyond the coarsest worth writing."""
    return np.maximum(energy, lagrangian / COARSEST_COLOUR**2)
