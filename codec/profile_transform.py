"""The `transform` profile: every value as fine as its effect on the picture asks for, no finer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import (
    allocation,
    colour_basis,
    colour_streams,
    fine_means,
    morton,
    resolution,
    rotation,
    shape_streams,
    streams,
    turn,
)
from . import grid as grids
from .ablation import Ablation
from .allocation import Costs
from .chunk import MAX_LOGIT, Payloads, chunk_means
from .colour_basis import ColourBasis
from .decoder import decode_colour_codebook
from .grid import Grid
from .splats import Splats
from .streams import Attribute, Stream

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

BASIS: Final = 0
"""Number of the codebook that holds the basis of shN."""

# The step of a turn at no halvings: its values lie in ±1.
_TURN_STEP: Final = 2.0

# Share of a change of area that opacity makes up for, and the least 1 - α it counts with. Half
# was best of 0, a half and all in renders of three trained scenes: overlapping splats share.
_AREA_SHARE: Final = 0.5
_LEAST_CLEAR: Final = 0.1

# A chunk of one place is taken to be so wide, scene units.
_LEAST_SPAN: Final = 2.0**-20

# Splats coarser than all but this share of a chunk set the cells that Morton order sorts.
_COARSEST: Final = 0.02


@dataclass(frozen=True, eq=False)
class TransformPlan:
    """What all chunks share.

    Parameters
    ----------
    slope : float
        λ: what ``cost · step²`` is everywhere.
    costs : Costs
        Of every splat.
    turns : (N, 3) float64
    scales : (N, 3) float32
        Log, middle, thin, long.
    basis : ColourBasis or None
        None at SH degree 0.
    basis_payloads : tuple of bytes
        One per SH band.
    ablation : Ablation
    """

    slope: float
    costs: Costs
    turns: F64
    scales: F32
    basis: ColourBasis | None
    basis_payloads: tuple[bytes, ...]
    ablation: Ablation


def plan(
    splats: Splats,
    costs: Costs,
    basis_spread: F64,
    slope: float,
    chunks: Sequence[slice],
    ablation: Ablation,
) -> TransformPlan:
    """Prepare a scene in its final order.

    Parameters
    ----------
    splats : Splats
        Valid rows, at least one.
    costs : Costs
        Of these rows.
    basis_spread : (15, 15) float64
        `Scores.basis_spread`.
    slope : float
    chunks : sequence of slice
    ablation : Ablation
    """
    costs = allocation.limited(costs, splats.scales, slope)
    turns, scales = turn.canonical(rotation.unit(splats.quats), splats.scales)
    basis: ColourBasis | None = None
    payloads: tuple[bytes, ...] = ()
    if splats.sh_degree:
        spread = basis_spread if ablation.view_metric else np.zeros_like(basis_spread)
        basis = colour_basis.fit(
            splats.shN, costs.energy, spread, slope, chunks, principal=ablation.colour_basis
        )
        payloads = tuple(streams.pack([b], digits=ablation.digits) for b in basis.streams())
        views = {band: memoryview(data) for band, data in enumerate(payloads, start=1)}
        stored = decode_colour_codebook(views, len(basis.rows), splats.sh_degree, "basis")
        basis = basis.stored_as(stored.shN)
    return TransformPlan(slope, costs, turns, scales, basis, payloads, ablation)


def encode_chunk(splats: Splats, plan_: TransformPlan, run: slice, sort: bool) -> Payloads:
    """Return the head and the tail of a chunk.

    Parameters
    ----------
    splats : Splats
        The planned scene.
    plan_ : TransformPlan
    run : slice
        The chunk's rows.
    sort : bool
        Whether to sort by Morton code.
    """
    slope, used = plan_.slope, plan_.ablation
    rows = np.arange(run.start, run.stop, dtype=np.int64)
    ladder, scale_grid = _ladder(plan_.scales[rows], plan_.costs.take(rows), slope, used.areas)
    scales = shape_streams.climb(scale_grid.dequantise(scale_grid.quantise(ladder)))
    means_costs = plan_.costs.take(rows).mean
    if used.fine_means:
        inside, means = _means(splats.means[rows], scales, means_costs, slope, sort)
    else:
        step = allocation.equal_step(slope, means_costs)
        inside, means = chunk_means(splats.means[rows], step, sort)
    rows, ladder, scales = rows[inside], ladder[inside], scales[inside]
    costs = plan_.costs.take(rows)
    # Of shapes all alike, every one gets the same resolution.
    shapes = scales if used.fine_turns else np.zeros_like(scales)
    tilt = resolution.fit(shapes, costs.tilt, slope, _TURN_STEP)
    spin = resolution.fit(shapes, costs.spin, slope, _TURN_STEP)
    turns, _ = shape_streams.turns(plan_.turns[rows], scales, tilt, spin)
    sh0 = splats.sh0[rows].astype(np.float64)
    tail: bytes | None = None
    if plan_.basis is not None:
        stream, missed = plan_.basis.encode(splats.shN[rows], costs.energy, slope, BASIS)
        if used.sh0_makes_up:
            # What shN lost, as its views see it on average.
            sh0 += np.einsum("nk,nkc->nc", costs.basis_mean, missed) / allocation.SH0_BASIS
        tail = streams.pack([stream], digits=used.digits)
    kept_areas = plan_.scales[rows] if used.areas else scales
    opacities = _opacities(splats.opacities[rows], kept_areas, scales)
    opacity_step = allocation.equal_step(slope, costs.opacity)
    head = [
        shape_streams.ladder(ladder, scale_grid),
        turns,
        means,
        streams.scalar(Attribute.OPACITIES, opacities, grids.fit(opacities, opacity_step)),
        _sh0(sh0, costs.energy, slope),
    ]
    needs = (BASIS,) if tail is not None else ()
    return Payloads(streams.pack(head, digits=used.digits), tail, (), needs, inside)


def _ladder(scales: F32, costs: Costs, slope: float, areas: bool) -> tuple[F32, Grid]:
    """Return the ladder to store and its grid: what one value loses, the next makes up for.

    A splat's weight in a picture goes with its area, about the product of its two longer axes. The
    errors of single splats average out; a change of all their areas does not.
    """
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    steps = np.array([allocation.equal_step(slope, column) for column in columns])
    ladder = shape_streams.steps_of(scales)
    grid = grids.fit(ladder, steps)
    if not areas:
        return ladder, grid
    stored = grid.dequantise(grid.quantise(ladder))
    # log area = 2·long - middle's distance: half of what the distance gained goes to the long axis.
    ladder[:, 0] += 0.5 * (stored[:, 1] - ladder[:, 1])
    # The mean of exp(2δ) over a step is above 1: exp(Δ²/6), to the second order.
    ladder[:, 0] -= np.float32(np.square(grid.step[0]) / 12)
    return ladder, grids.fit(ladder, steps)


def _opacities(opacities: F32, scales: F32, stored: F32) -> F32:
    """Return the (n, 1) opacities to store: what a splat's area gained, its opacity gives up."""
    logits = np.clip(opacities, -MAX_LOGIT, MAX_LOGIT).astype(np.float64)
    gained = (stored[:, 2] + stored[:, 0]) - (scales[:, 2] + scales[:, 0])
    # d(log α) = (1 - α)·d(logit); an opaque splat hardly answers, so its share is limited.
    clear = np.maximum(1 / (1 + np.exp(logits)), _LEAST_CLEAR)
    shift = np.clip(_AREA_SHARE * gained / clear, -1, 1)
    return (logits - shift).astype(np.float32)[:, None]


def _means(means: F32, scales: F32, costs: F64, slope: float, sort: bool) -> tuple[I64, Stream]:
    """Return the order inside a chunk and its means, fine where the grid can hold them."""
    wanted = np.log2(allocation.own_steps(slope, costs))
    # A power of two below which only the coarsest splats' steps lie: halvings start at 0 there.
    base = float(2.0 ** np.floor(np.quantile(wanted, 1 - _COARSEST)))
    base = min(base, _widest(means))
    finest = resolution.fit(scales, costs, slope, base)
    halvings = finest.halvings(scales)
    grid = _grid(means, base)
    top = grid.levels.astype(np.float64) * 2.0 ** int(halvings.max())
    if not sort or int(grid.levels.max()) > morton.MAX_LEVELS or top.max() >= 2.0**31:
        return chunk_means(means, allocation.equal_step(slope, costs), sort)
    codes = fine_means.fine_codes(means, grid, halvings)
    order = fine_means.morton_order(codes, halvings)
    return order, fine_means.fine_means(codes[order], grid, halvings[order], finest)


def _widest(means: F32) -> float:
    """Return a power of two as wide as a chunk: steps beyond it gain nothing, and overflow."""
    span = float(np.ptp(means.astype(np.float64), axis=0).max())
    return float(2.0 ** np.ceil(np.log2(max(span, _LEAST_SPAN))))


def _grid(means: F32, step: float) -> Grid:
    """Return a grid of exactly `step`, so that halvings of it are what `resolution` was told."""
    minimum = means.min(axis=0)
    span = means.max(axis=0).astype(np.float64) - minimum
    levels = np.minimum(np.ceil(span / step) + 1, float(grids.MAX_LEVELS))
    maximum = minimum.astype(np.float64) + (levels - 1) * step
    return Grid(minimum, maximum.astype(np.float32), levels.astype(np.uint32))


def _sh0(values: F64, energy: F64, slope: float) -> Stream:
    """Return sh0 on the axes along which its chunk varies most, a Karhunen-Loève transform."""
    weights = energy / energy.sum()
    centred = values - weights @ values
    moments = np.einsum("n,ni,nj->ij", weights, centred, centred)
    _, vectors = np.linalg.eigh(moments)
    # Signs of eigenvectors are arbitrary: the largest entry is made positive.
    largest = vectors[np.abs(vectors).argmax(axis=0), np.arange(3)]
    axes = (vectors * np.where(largest < 0, -1, 1))[:, ::-1].T.astype(np.float32)
    axes = np.clip(axes, -1, 1)
    on_axes = np.linalg.solve(axes.T.astype(np.float64), values.T).T.astype(np.float32)
    step = allocation.equal_step(slope, energy * allocation.SH0_COST * allocation.SH0_WEIGHT)
    stream, _ = colour_streams.sh0_on_axes(on_axes, axes, grids.fit(on_axes, step))
    return stream
