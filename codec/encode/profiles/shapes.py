"""Scales, rotations and opacities of the `transform` profile: what makes a splat's shape."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.rate import allocation
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.rate.refinement_split import Split
from cogsplat.codec.segments.opacities import MAX_LOGIT
from cogsplat.codec.streams import adaptive_step, scale_differences, swing_twist
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Stream

from .refined import Refined, squared_error_drop

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Share of a change of area that opacity makes up for, and the least 1 - α it counts with. Half
# was best of 0, a half and all in renders of three trained scenes: overlapping splats share.
_AREA_SHARE: Final = 0.5
_LEAST_CLEAR: Final = 0.1


def differences_to_store(
    scales: F32, costs: Costs, lagrangian: float, areas: bool
) -> tuple[F32, Grid]:
    """Return the scale differences of a chunk and the grid to quantise them on.

    A splat's weight in a picture goes with its area, about the product of its two longer axes. The
    quantisation errors of single splats average out; a change of all their areas does not.

    Parameters
    ----------
    scales : (n, 3) float32
        Log, middle, thin, long.
    costs : Costs
        Of these rows.
    lagrangian : float
    areas : bool
        Whether the longest axis makes up for the area that the quantised differences change.
    """
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    steps = np.array([allocation.equal_step(lagrangian, column) for column in columns])
    differences = scale_differences.differences_of(scales)
    grid = grids.fit(differences, steps)
    if not areas:
        return differences, grid
    stored = grid.dequantise(grid.quantise(differences))
    # log area = 2·long - middle's distance: half of what the distance gained goes to the long axis.
    differences[:, 0] += 0.5 * (stored[:, 1] - differences[:, 1])
    # The mean of exp(2δ) over a step is above 1: exp(Δ²/6), to the second order.
    differences[:, 0] -= np.float32(np.square(grid.step[0]) / 12)
    return differences, grids.fit(differences, steps)


def refined_scales(parts: Split, differences: F32, costs: Costs) -> Refined:
    """Return what the refinement adds to quantised scale differences, (n, 3) float32 before."""
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    drop = squared_error_drop(parts, differences) * np.stack(columns, axis=1)
    return Refined(parts.digits, float(drop.sum()))


def opacities_to_store(opacities: F32, scales: F32, stored: F32) -> F32:
    """Return opacities that give up what the areas of the splats gained by quantisation.

    Parameters
    ----------
    opacities : (n,) float32
        Logit.
    scales, stored : (n, 3) float32
        Log, middle, thin, long; of the source and as they are decoded.

    Returns
    -------
    (n, 1) float32
        Logit.
    """
    logits = np.clip(opacities, -MAX_LOGIT, MAX_LOGIT).astype(np.float64)
    gained = (stored[:, 2] + stored[:, 0]) - (scales[:, 2] + scales[:, 0])
    # d(log α) = (1 - α)·d(logit); an opaque splat hardly answers, so its share is limited.
    clear = np.maximum(1 / (1 + np.exp(logits)), _LEAST_CLEAR)
    shift = np.clip(_AREA_SHARE * gained / clear, -1, 1)
    return (logits - shift).astype(np.float32)[:, None]


def quantise_rotations(values: F64, scales: F32, costs: Costs, lagrangian: float) -> Stream:
    """Return the rotations of a chunk, each as fine as its shape asks for.

    Parameters
    ----------
    values : (n, 3) float64
        Swing and twist of each rotation (`swing_twist.decompose`).
    scales : (n, 3) float32
        Log scales that the head alone gives: each row's number of bits follows from them. Where
        all are equal, so are the numbers.
    costs : Costs
        Of these rows.
    lagrangian : float
    """
    swing, twist = (
        adaptive_step.fit(scales, cost, lagrangian, swing_twist.BASE_STEP)
        for cost in (costs.swing, costs.twist)
    )
    return swing_twist.write(values, scales, swing, twist)
