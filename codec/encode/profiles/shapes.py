"""Scales, rotations and opacities of the `transform` profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.config import Ablation
from cogsplat.codec.geometry import rotations
from cogsplat.codec.rate import allocation, refinement_split
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.rate.refinement_split import Split
from cogsplat.codec.segments.opacities import MAX_LOGIT
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import adaptive_step, scale_differences, swing_twist
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Stream

from .refined import Refined, squared_error_drop

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Share of an area change that opacity compensates, and the least 1 - α in its derivative. Of 0, 0.5
# and 1, 0.5 gave the best renders of three trained scenes, because splats overlap.
_AREA_SHARE: Final = 0.5
_LEAST_CLEAR: Final = 0.1


@dataclass(frozen=True, eq=False)
class ShapeSource:
    """Shapes of a chunk before quantisation, and the costs of their errors.

    Parameters
    ----------
    angles : (n, 3) float64
        Swing and twist of each rotation (`swing_twist.decompose`).
    scales : (n, 3) float32
        Log scales; columns middle, thin, long.
    costs : Costs
        Costs of these rows, with no step beyond the coarsest.
    """

    angles: F64
    scales: F32
    costs: Costs

    @classmethod
    def of(cls, part: Splats, costs: Costs, lagrangian: float) -> ShapeSource:
        """Return the shapes of splats, given their costs and λ."""
        limited = rate_costs.limit_steps(costs, part.scales, lagrangian)
        return cls(*swing_twist.decompose(rotations.unit(part.quats), part.scales), limited)

    def __len__(self) -> int:
        return len(self.scales)

    def take(self, rows: I64) -> ShapeSource:
        """Return the shapes of the splats `rows`."""
        return ShapeSource(self.angles[rows], self.scales[rows], self.costs.take(rows))


@dataclass(frozen=True, eq=False)
class PlainShapes:
    """Quantised shapes of a chunk, without a codebook.

    Parameters
    ----------
    source : ShapeSource
        Shapes before quantisation.
    differences : (n, 3) float32
        Scale differences before quantisation (`differences_to_store`).
    sizes : Split
        Quantised differences.
    head_scales, scales : (n, 3) float32
        Log scales decoded from the head alone, and refined; columns middle, thin, long.
    lagrangian : float
        λ of the head.
    fine_rotations : bool
        Whether the step of a rotation follows from its splat's scales.
    needs : tuple of int
        Codebooks that the head needs: none.
    """

    source: ShapeSource
    differences: F32
    sizes: Split
    head_scales: F32
    scales: F32
    lagrangian: float
    fine_rotations: bool
    needs: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, source: ShapeSource, lagrangian: float, used: Ablation, most: tuple[int, ...]
    ) -> PlainShapes:
        """Quantise shapes; the refinement holds digits of scales of radices up to `most`."""
        costs = source.costs
        differences, grid = differences_to_store(source.scales, costs, lagrangian, used.areas)
        sizes = refinement_split.split(Attribute.SCALES, differences, grid, costs.scale_long, most)
        head, fine = (scale_differences.scales_of(part) for part in (sizes.coarse, sizes.fine))
        return cls(source, differences, sizes, head, fine, lagrangian, used.fine_rotations)

    def write(self, inside: I64) -> tuple[list[Stream], Refined]:
        """Return the streams of the head and the refinement, for rows in the order `inside`."""
        source, sizes = self.source.take(inside), self.sizes.take(inside)
        # Of shapes that are all alike, every rotation gets the same step.
        scales = self.head_scales[inside]
        step_scales = scales if self.fine_rotations else np.zeros_like(scales)
        streams = [
            scale_differences.write(sizes.coarse, sizes.grid),
            quantise_rotations(source, step_scales, self.lagrangian),
        ]
        return streams, refine_scales(sizes, self.differences[inside], source.costs)


def differences_to_store(
    scales: F32, costs: Costs, lagrangian: float, areas: bool
) -> tuple[F32, Grid]:
    """Return the scale differences of a chunk and their quantisation grid.

    A splat's weight in a picture is proportional to its area, about the product of its two longer
    axes. Quantisation errors of single splats average out; a bias of all areas does not.

    Parameters
    ----------
    scales : (n, 3) float32
        Log scales; columns middle, thin, long.
    costs : Costs
        Costs of these rows.
    lagrangian : float
        λ of the head.
    areas : bool
        Correct the longest axis for the area change of the quantised differences.
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


def refine_scales(parts: Split, differences: F32, costs: Costs) -> Refined:
    """Return the refinement of quantised scale differences.

    Parameters
    ----------
    parts : Split
        Coarse and fine differences.
    differences : (n, 3) float32
        Differences before quantisation.
    costs : Costs
        Costs of these rows.
    """
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    drop = squared_error_drop(parts, differences) * np.stack(columns, axis=1)
    return Refined(parts.digits, float(drop.sum()))


def opacities_to_store(opacities: F32, scales: F32, stored: F32) -> F32:
    """Return opacity logits corrected for the area change of quantised scales.

    A splat whose decoded scales enlarge its area gets a lower opacity.

    Parameters
    ----------
    opacities : (n,) float32
        Opacity logits of the source.
    scales, stored : (n, 3) float32
        Log scales of the source, and as decoded; columns middle, thin, long.

    Returns
    -------
    (n, 1) float32
        Corrected logits.
    """
    logits = np.clip(opacities, -MAX_LOGIT, MAX_LOGIT).astype(np.float64)
    gained = (stored[:, 2] + stored[:, 0]) - (scales[:, 2] + scales[:, 0])
    # d(log α) = (1 - α)·d(logit). An opaque splat hardly changes, so the factor is limited.
    clear = np.maximum(1 / (1 + np.exp(logits)), _LEAST_CLEAR)
    shift = np.clip(_AREA_SHARE * gained / clear, -1, 1)
    return (logits - shift).astype(np.float32)[:, None]


def quantise_rotations(source: ShapeSource, scales: F32, lagrangian: float) -> Stream:
    """Quantise the rotations of a chunk, each with a precision that follows from its shape.

    Parameters
    ----------
    source : ShapeSource
        Shapes to quantise.
    scales : (n, 3) float32
        Decoded log scales, which decide the bits of each row.
    lagrangian : float
        λ of the head.
    """
    return swing_twist.write(source.angles, scales, *rotation_steps(source, scales, lagrangian))


def rotation_steps(
    source: ShapeSource, scales: F32, lagrangian: float
) -> tuple[StepModel, StepModel]:
    """Return the step models of swing and twist for `quantise_rotations`."""
    swing, twist = (
        adaptive_step.fit(scales, cost, lagrangian, swing_twist.BASE_STEP)
        for cost in (source.costs.swing, source.costs.twist)
    )
    return swing, twist
