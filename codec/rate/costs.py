"""Cost of an error in each stored value: squared error of the picture per squared error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.splats import Splats

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores

F64 = NDArray[np.float64]

# Squared error of the picture per squared step and energy, relative to a change of colour.
# Measured by perturbing trained scenes of three kinds (a captured room, a cleaned object, a
# figure) one attribute at a time; they agree within a factor of three, steps within 1.7.
SH0_COST: Final = C0**2
OPACITY_COST: Final = 0.02
SCALE_COST: Final = 0.06
ROTATION_COST: Final = 0.48  # per squared step of a quaternion component, half the angle
MEAN_COST: Final = 0.04  # per squared step relative to the splat's mean deviation

# Squared radians per squared value of swing or twist, the mean over swings of up to 90°.
_ROTATION_VALUE_COST: Final = 2.5


# The view that shows a splat best counts as one of this many views. Scoring views are a sample:
# a splat that one of them shows by chance may be in many views of a viewer. At 32, three scenes of
# thin or hollow objects take up to 1.3 % fewer bytes at equal mean PSNR, a trained scene 0.3 %
# more, and 1.5 % of a captured room's splats count more than their mean.
_VIEWS_PER_BEST: Final = 32


def robust_energy(scores: Scores) -> F64:
    """Return each splat's mean energy, raised to at least 1/32 of its largest energy in one view.

    The mean over the scoring views ignores the view in which an error is most visible.

    Returns
    -------
    (N,) float64
    """
    return np.maximum(scores.energy, scores.largest_energy / _VIEWS_PER_BEST)


def positive_energy(scores: Scores, rows: NDArray[np.int64] | None = None) -> F64:
    """Return `robust_energy` with zeros replaced: the energy of every splat is positive.

    A viewer may see a splat that no scoring view shows. Its energy is the 1 % quantile of the
    positive energies.

    Parameters
    ----------
    scores : Scores
        Scores of the whole scene.
    rows : (n,) int64, optional
        Rows of the splats to return; the quantile is of these rows too. None for all splats.

    Returns
    -------
    (N,) or (n,) float64
    """
    energy = scores.energy if rows is None else scores.energy[rows]
    seen = energy[energy > 0]
    if len(seen) == 0:
        return np.ones_like(energy)
    shown = robust_energy(scores)
    return np.maximum(shown if rows is None else shown[rows], np.quantile(seen, 0.01))


@dataclass(frozen=True, eq=False)
class Costs:
    """Costs of each splat's stored values: squared error of the picture per squared error.

    Parameters
    ----------
    energy : (n,) float64
        Cost of the splat's colour.
    mean : (n,) float64
        Cost of a coordinate of the mean, per squared scene unit.
    opacity : (n,) float64
        Cost of the opacity logit.
    scale_long, scale_middle, scale_thin : (n,) float64
        Costs of the three stored scale differences. The first changes all three log scales, the
        second the two smaller ones, the third the smallest.
    swing, twist : (n,) float64
        Costs of the stored rotation values (SPEC 6.11): of each of the two values of swing, and of
        twist.
    basis_mean : (n, K-1) float64
        Mean SH bases of each splat's views (`Scores.basis_mean`); no cost.
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
        """Return the costs of the splats `rows`."""
        return Costs(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def equalise(self) -> Costs:
        """Return costs with each per-splat cost set to its mean, so that all splats share steps."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        level = {name: np.full_like(x, x.mean()) for name, x in values.items() if x.ndim == 1}
        return replace(self, **level)


# Coarsest steps. A viewer may see splats that no scoring view shows: with these steps such splats
# roughly keep their position, size, colour and opacity.
COARSEST_COLOUR: Final = 0.15
"""Coarsest step of a colour, where colours range from 0 to 1."""
SPARSE_COARSEST_COLOUR: Final = 0.05
"""Coarsest step of a colour where the given cameras show too little in common (`Scores.sparse`).

Other viewpoints show splats that hardly count in the scored views: a grey car of a city was green
at 0.15 and brown at 0.08 (docs/ablations.md, "Scoring large scenes").
"""
_OPACITY_LIMIT: Final = 1.0
_SCALE_LIMITS: Final = (0.35, 0.5, 0.7)  # long, middle, thin; log
_MEAN_LIMIT: Final = 1.0  # standard deviations
# A rotation is off by at most its step, radians: swing and twist are tangents of half an angle.
# Let L be an axis and t the shortest axis. A tilt δ adds (L² - t²)·δ² to the squared thickness of
# the surface in which the splat lies. The limit allows t², or (0.3·L)² if that is larger.
# Derivatives do not predict this error: few views show a surface from its edge, and there the
# tilts of many overlapping splats all make it thicker. At a nominal 40 dB the worst of 24 views
# of a flat card is 2.4 dB below their mean with this limit and 8.7 dB without it, at equal bytes.
_TILT_SHARE: Final = 0.3

# Minimum cost of each value relative to its splat's energy. Sensitivities hold for small errors
# only: a splat that matches its surroundings becomes visible once it moves far enough.
_MEAN_FLOOR: Final = 1e-3  # per squared deviation
_OPACITY_FLOOR: Final = 1e-3
_SCALE_FLOOR: Final = 3e-3
_ROTATION_FLOOR: Final = 3e-3

# Limit of `robust_energy` over mean energy when sensitivities are scaled by that ratio. Beyond it,
# even the best view shows only a pixel or two of the splat.
_MAX_RISE: Final = 1e3

# Costs relative to sensitivities, measured in renders of three trained scenes at 35 to 45 dB:
# steps are coarse there, and the error of one value partly hides that of another.
_OPACITY_WEIGHT: Final = 1.3
_MIDDLE_WEIGHT: Final = 2.0
_THIN_WEIGHT: Final = 1.5
_ROTATION_WEIGHT: Final = 1.7
SH0_WEIGHT: Final = 0.6


def costs(splats: Splats, scores: Scores, energy: F64 | None = None) -> Costs:
    """Return the error costs of splats, measured by sensitivities or estimated from energies.

    Parameters
    ----------
    splats : Splats
        Splats to compute costs of.
    scores : Scores
        Scores of `splats`. Without sensitivities each cost is the energy times a typical factor.
    energy : (n,) float64, optional
        Energy of each splat, from `positive_energy` of the whole scene. None computes it from
        `scores`, which then must be those of the whole scene.
    """
    if energy is None:
        energy = positive_energy(scores)
    order = np.argsort(splats.scales, axis=1, kind="stable")
    sizes = np.take_along_axis(splats.scales, order, axis=1).astype(np.float64)
    basis_mean = scores.basis_mean[:, : splats.shN.shape[1]].astype(np.float64)
    estimated = _typical_costs(energy, sizes, basis_mean)
    found = scores.sensitivities
    if found is None:
        return estimated
    # Sensitivities are scaled like the energy: by `robust_energy` over the mean energy.
    rise = np.divide(
        robust_energy(scores), scores.energy, out=np.ones_like(energy), where=scores.energy > 0
    )
    rise = np.minimum(rise, _MAX_RISE)
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
    # Sensitivities are measured in some of the views only. A splat outside these views has zero
    # sensitivity, though its errors are visible elsewhere: its costs are the typical ones.
    unmeasured = (found.opacities + found.means.sum(axis=1) <= 0.0) & (robust_energy(scores) > 0.0)
    # Sensitivities of colours and sizes near the format's limits overflow.
    per_splat = [getattr(measured, name) for name in Costs.__dataclass_fields__]
    for values in per_splat:
        if values.ndim == 1:
            unmeasured |= ~np.isfinite(values)
    return Costs(
        *(
            np.where(unmeasured, getattr(estimated, name), getattr(measured, name))
            if getattr(measured, name).ndim == 1
            else getattr(measured, name)
            for name in Costs.__dataclass_fields__
        )
    )


def _typical_costs(energy: F64, sizes: F64, basis_mean: F64) -> Costs:
    """Return error costs estimated from energies and sizes, without sensitivities.

    Parameters
    ----------
    energy : (n,) float64
        Energy of each splat, positive.
    sizes : (n, 3) float64
        Log scales, the smallest first.
    basis_mean : (n, K-1) float64
        `Scores.basis_mean`.
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


def limit_steps(found: Costs, scales: NDArray[np.float32], lagrangian: float) -> Costs:
    """Return costs raised so that no step √(λ / cost) exceeds its attribute's coarsest step.

    Parameters
    ----------
    found : Costs
        Costs to limit, one row per splat. The energy, the cost of colours, stays as it is
        (`limit_colour_steps`).
    scales : (n, 3) float32
        Log scales: the coarsest steps of means and rotations depend on a splat's shape.
    lagrangian : float
        λ from which the steps are derived.
    """
    size = np.exp(np.clip(scales.astype(np.float64).mean(axis=1), -40, 40))
    long, middle, thin = (lagrangian / limit**2 for limit in _SCALE_LIMITS)
    sizes = np.clip(np.sort(scales.astype(np.float64), axis=1), -40, 40)
    # Swing tilts the longest axis, twist the middle one.
    swung, twisted = (
        lagrangian * (1 - flat) / np.maximum(flat, _TILT_SHARE**2)
        for flat in (np.exp(2 * (sizes[:, 0] - sizes[:, axis])) for axis in (2, 1))
    )
    return replace(
        found,
        mean=np.maximum(found.mean, lagrangian / np.square(_MEAN_LIMIT * size)),
        opacity=np.maximum(found.opacity, lagrangian / _OPACITY_LIMIT**2),
        scale_long=np.maximum(found.scale_long, long),
        scale_middle=np.maximum(found.scale_middle, middle),
        scale_thin=np.maximum(found.scale_thin, thin),
        swing=np.maximum(found.swing, swung),
        twist=np.maximum(found.twist, twisted),
    )


def coarsest_colour(scores: Scores) -> float:
    """Return the coarsest step of a colour, which is finer where `Scores.sparse` is set."""
    return SPARSE_COARSEST_COLOUR if scores.sparse else COARSEST_COLOUR


def limit_colour_steps(energy: F64, lagrangian: float, coarsest: float) -> F64:
    """Return (n,) energies raised so that no step √(λ / energy) exceeds `coarsest`."""
    return np.maximum(energy, lagrangian / coarsest**2)
