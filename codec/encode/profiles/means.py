"""Means of the `transform` profile: a step per splat by its size, in Morton order."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.rate import allocation
from cogsplat.codec.streams import adaptive_step, refinement_bits, sorted_means
from cogsplat.codec.streams.grid import Grid

from .chunk_streams import chunk_means
from .refined import NO_REFINEMENT, Quantised, Refined

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Least extent of a chunk, scene units: all its means may be one point.
_LEAST_SPAN: Final = 2.0**-20

# Share of a chunk's splats at most whose steps exceed the cells of the Morton order.
_COARSEST: Final = 0.02


def quantise_means(
    means: F32, scales: F32, costs: F64, lagrangian: float, later_bits: int, sort: bool
) -> Quantised:
    """Quantise the means of a chunk, each with its own step.

    Parameters
    ----------
    means : (n, 3) float32
        Means of the chunk, scene units.
    scales : (n, 3) float32
        Log scales decoded from the head, which decide the bits of each row.
    costs : (n,) float64
        Squared picture error per squared error of a coordinate of each mean (`Costs.mean`).
    lagrangian : float
        λ of the refined values.
    later_bits : int
        Bits of each coordinate that the refinement holds.
    sort : bool
        Sort by Morton code; otherwise all means share one step.
    """
    if not sort:
        rows, stream, _ = chunk_means(means, allocation.equal_step(lagrangian, costs), sort)
        return rows, stream, NO_REFINEMENT
    head_lagrangian = lagrangian * 4.0**later_bits
    log_steps = np.log2(allocation.step_per_value(head_lagrangian, costs))
    # A power of two below which only the coarsest splats' steps lie: they have no extra bits.
    base = float(2.0 ** np.floor(np.quantile(log_steps, 1 - _COARSEST)))
    widest = _widest(means)
    base = min(max(base, widest * 2 / sorted_means.MAX_CELLS), widest)
    model = adaptive_step.fit(scales, costs, head_lagrangian, base)
    extra = model.extra_bits(scales)
    grid = _grid(means, base)
    refined = sorted_means.quantise(means, grid, extra, later_bits)
    codes = refinement_bits.coarse_codes(refined, later_bits)
    order = sorted_means.morton_order(codes, extra)
    codes, refined, extra = codes[order], refined[order], extra[order]
    stream = sorted_means.write(codes, grid, extra, model)
    if not later_bits:
        return order, stream, NO_REFINEMENT
    missed = np.square(means[order] - sorted_means.dequantise(codes, grid, extra))
    drop = float(costs[order] @ missed.sum(axis=1))
    return order, stream, Refined(refinement_bits.write(refined, later_bits), drop)


def _widest(means: F32) -> float:
    """Return the power of two that spans a chunk, the widest useful step."""
    span = float(np.ptp(means.astype(np.float64), axis=0).max())
    return float(2.0 ** np.ceil(np.log2(max(span, _LEAST_SPAN))))


def _grid(means: F32, step: float) -> Grid:
    """Return a grid of means with the step `step`; each extra bit of a splat halves the step."""
    minimum = means.min(axis=0)
    span = means.max(axis=0).astype(np.float64) - minimum
    levels = np.ceil(span / step) + 1
    maximum = minimum.astype(np.float64) + (levels - 1) * step
    return Grid(minimum, maximum.astype(np.float32), levels.astype(np.uint32))
