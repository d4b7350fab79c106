"""Means of the `transform` profile: quantised as finely as each splat is small, in Morton order."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton
from cogsplat.codec.rate import allocation
from cogsplat.codec.streams import adaptive_step, refinement_bits, sorted_means
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.grid import Grid

from .chunk_streams import chunk_means
from .refined import NOTHING, Quantised, Refined

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The least extent of a chunk, scene units: all its means may be one point.
_LEAST_SPAN: Final = 2.0**-20

# Only this share of a chunk's splats may have steps wider than the cells that are sorted.
_COARSEST: Final = 0.02


def quantise_means(
    means: F32,
    scales: tuple[F32, F32],
    costs: F64,
    lagrangian: float,
    later_bits: int,
    sort: bool,
) -> Quantised:
    """Return the means of a chunk, each with a step of its own where the grid can hold that.

    Parameters
    ----------
    means : (n, 3) float32
        Scene units.
    scales : tuple of two (n, 3) float32
        Log scales that the head gives and that the refinement gives: each row's number of bits
        follows from them.
    costs : (n,) float64
        `Costs.mean`.
    lagrangian : float
        λ of the refined values.
    later_bits : int
        Bits of every coordinate that the refinement holds.
    sort : bool
        Whether to sort by Morton code; otherwise all means have one step.
    """
    head, fine = scales
    head_lagrangian = lagrangian * 4.0**later_bits
    log_steps = np.log2(allocation.own_steps(head_lagrangian, costs))
    # A power of two below which only the coarsest splats' steps lie: they have no extra bits.
    base = float(2.0 ** np.floor(np.quantile(log_steps, 1 - _COARSEST)))
    base = min(base, _widest(means))
    model = adaptive_step.fit(head, costs, head_lagrangian, base)
    head_bits = model.extra_bits(head)
    refined_bits = np.zeros_like(head_bits)
    constant = 0.0
    if later_bits:
        constant = adaptive_step.with_more_bits(model, later_bits, fine, costs, lagrangian, base)
        refined_bits = refinement_bits.gained(
            refinement_bits.with_constant(model, constant), fine, head_bits
        )
    total = head_bits + refined_bits
    grid = _grid(means, base)
    top = grid.levels.astype(np.float64) * 2.0 ** int(total.max())
    if not sort or int(grid.levels.max()) > morton.MAX_LEVELS or top.max() >= 2.0**31:
        return *chunk_means(means, allocation.equal_step(lagrangian, costs), sort), NOTHING
    codes = sorted_means.codes_of(means, grid, total)
    kept, _ = refinement_bits.coarse_of(codes, refined_bits[:, None])
    order = sorted_means.morton_order(kept, head_bits)
    stored, below = sorted_means.refine(codes[order], refined_bits[order], constant)
    stream = sorted_means.write(stored, grid, head_bits[order], model)
    if not later_bits:
        return order, stream, NOTHING
    missed = np.square(means[order] - sorted_means.values(stored, grid, head_bits[order]))
    return order, stream, Refined(below, float(costs[order] @ missed.sum(axis=1)))


def _widest(means: F32) -> float:
    """Return a power of two as wide as a chunk: steps beyond it gain nothing, and overflow."""
    span = float(np.ptp(means.astype(np.float64), axis=0).max())
    return float(2.0 ** np.ceil(np.log2(max(span, _LEAST_SPAN))))


def _grid(means: F32, step: float) -> Grid:
    """Return a grid of exactly `step`, the step that the extra bits of the step model halve."""
    minimum = means.min(axis=0)
    span = means.max(axis=0).astype(np.float64) - minimum
    levels = np.minimum(np.ceil(span / step) + 1, float(grids.MAX_LEVELS))
    maximum = minimum.astype(np.float64) + (levels - 1) * step
    return Grid(minimum, maximum.astype(np.float32), levels.astype(np.uint32))
