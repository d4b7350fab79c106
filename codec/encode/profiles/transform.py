"""The `transform` profile: every value as fine as its effect on the picture asks for, no finer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode import colour_transform
from cogsplat.codec.encode.colour_transform import ColourBasis
from cogsplat.codec.encode.config import Ablation
from cogsplat.codec.geometry import morton, rotations
from cogsplat.codec.rate import allocation, refinement_split, segment_order
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.rate.refinement_split import Cut
from cogsplat.codec.segments.codebooks import decode_colour_codebook
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import (
    adaptive_step,
    records,
    refinement_bits,
    refinement_digits,
    scalar,
    scale_differences,
    sh0_transform,
    sorted_means,
    swing_twist,
)
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Stream

from .chunk_streams import MAX_LOGIT, chunk_means

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


@dataclass(frozen=True)
class Coarseness:
    """How much coarser heads are than what their refinements make of them.

    Parameters
    ----------
    scales : tuple of int
        Largest radices of the ladder's components.
    means, turns : int
        Halvings that can wait.
    opacities, sh0 : tuple of int
        Largest radices.
    """

    scales: tuple[int, ...]
    means: int
    turns: int
    opacities: tuple[int, ...]
    sh0: tuple[int, ...]


KEPT_WHOLE: Final = Coarseness((1, 1, 1), 0, 0, (1,), (1, 1, 1))


# Bits of a coarse splat, about.
_HEAD_BITS: Final = 24.0

# Halvings that wait, less than what an equal λ asks for: sensitivities hold for small errors,
# and a prefix gains less from coarse splats than their costs say (measured on two trained scenes).
_LATER: Final = {"scales": 0.25, "opacities": -0.25, "means": -0.75, "turns": -1.5, "sh0": -0.75}
_MOST_LATER: Final = 5.0

# A ratio that asks for no halving.
_LEAST: Final = 2.0**-20


def coarseness(
    contribution: F64, lagrangian: float, chunks: Sequence[slice], missing_all: float
) -> dict[int, Coarseness]:
    """Return how coarse each head is to be: another bit of it gains what the next head's would.

    Parameters
    ----------
    contribution : (N,) float64
    lagrangian : float
        Of the refined values.
    chunks : sequence of slice
    missing_all : float
        Squared error of pictures of nothing, as `segment_order.head_gains` takes it.
    """
    sums = np.array([contribution[run].sum() for run in chunks])
    counts = np.array([run.stop - run.start for run in chunks])
    missing = segment_order.unsent_shares(sums)
    per_bit = segment_order.head_gains(missing, missing_all) / (_HEAD_BITS * counts)
    per_bit /= segment_order.refined_gain(missing[1:])
    # A bit more of a value whose error costs λ/12 gains 2·ln 2 times that.
    wanted = 0.5 * np.log2(np.maximum(12 / (2 * np.log(2)) * per_bit / lagrangian, _LEAST))
    return {run.start: _coarse(float(h)) for run, h in zip(chunks, wanted, strict=True)}


def _coarse(halvings: float) -> Coarseness:
    later = {name: min(max(halvings + own, 0.0), _MOST_LATER) for name, own in _LATER.items()}
    radices = {
        name: min(round(2**wait), refinement_digits.MAX_RADIX) for name, wait in later.items()
    }
    return Coarseness(
        scales=(radices["scales"],) * 3,
        means=round(later["means"]),
        turns=round(later["turns"]),
        opacities=(radices["opacities"],),
        sh0=(radices["sh0"],) * 3,
    )


@dataclass(frozen=True, eq=False)
class TransformPlan:
    """What all chunks share.

    Parameters
    ----------
    lagrangian : float
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
    coarse : mapping of int to Coarseness
        Of the heads of chunks, by their first rows; those that are not there are fine.
    """

    lagrangian: float
    costs: Costs
    turns: F64
    scales: F32
    basis: ColourBasis | None
    basis_payloads: tuple[bytes, ...]
    ablation: Ablation
    coarse: Mapping[int, Coarseness]


def plan(
    splats: Splats,
    costs: Costs,
    basis_spread: F64,
    lagrangian: float,
    chunks: Sequence[slice],
    ablation: Ablation,
    contribution: F64 | None = None,
    missing_all: float = segment_order.MISSING_ALL,
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
    lagrangian : float
    chunks : sequence of slice
    ablation : Ablation
    contribution : (N,) float64, optional
        Where heads are to be coarse, and refinements bring the rest.
    missing_all : float
        As `coarseness` takes it.
    """
    coarse = {}
    if contribution is not None:
        coarse = coarseness(contribution, lagrangian, chunks, missing_all)
    costs = rate_costs.limited(costs, splats.scales, lagrangian)
    turns, scales = swing_twist.canonical(rotations.unit(splats.quats), splats.scales)
    basis: ColourBasis | None = None
    payloads: tuple[bytes, ...] = ()
    if splats.sh_degree:
        spread = basis_spread if ablation.view_metric else np.zeros_like(basis_spread)
        basis = colour_transform.fit(
            splats.shN, costs.energy, spread, lagrangian, chunks, principal=ablation.colour_basis
        )
        payloads = tuple(records.pack([b], digits=ablation.digits) for b in basis.streams())
        views = {band: memoryview(data) for band, data in enumerate(payloads, start=1)}
        stored = decode_colour_codebook(views, len(basis.rows), splats.sh_degree, "basis")
        basis = basis.stored_as(stored.shN)
    return TransformPlan(lagrangian, costs, turns, scales, basis, payloads, ablation, coarse)


def encode_chunk(splats: Splats, plan_: TransformPlan, run: slice, sort: bool) -> Payloads:
    """Return the head, the refinement and the tail of a chunk.

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
    lagrangian, used = plan_.lagrangian, plan_.ablation
    rows = np.arange(run.start, run.stop, dtype=np.int64)
    ladder, scale_grid = _ladder(plan_.scales[rows], plan_.costs.take(rows), lagrangian, used.areas)
    # Values that the refinement is to bring; where there is none, nothing is cut off.
    coarse = plan_.coarse.get(run.start, KEPT_WHOLE)
    sizes = refinement_split.cut(
        Attribute.SCALES, ladder, scale_grid, plan_.costs.scale_long[rows], coarse.scales
    )
    head_scales, scales = (
        scale_differences.accumulate(sizes.coarse),
        scale_differences.accumulate(sizes.fine),
    )
    means_costs = plan_.costs.take(rows).mean
    if used.fine_means:
        inside, means, moved = _affordable(
            lambda halvings: _means(
                splats.means[rows], (head_scales, scales), means_costs, (lagrangian, halvings), sort
            ),
            coarse.means,
        )
    else:
        step = allocation.equal_step(lagrangian, means_costs)
        inside, means = chunk_means(splats.means[rows], step, sort)
        moved = _WHOLE
    rows, head_scales, scales = rows[inside], head_scales[inside], scales[inside]
    sizes = sizes.take(inside)
    costs = plan_.costs.take(rows)
    _, turns, turned = _affordable(
        lambda halvings: (
            inside,
            *_turns(plan_.turns[rows], (head_scales, scales), costs, plan_, halvings),
        ),
        coarse.turns,
    )
    sh0 = splats.sh0[rows].astype(np.float64)
    tail: bytes | None = None
    if plan_.basis is not None:
        stream, missed = plan_.basis.encode(splats.shN[rows], costs.energy, lagrangian, BASIS)
        if used.sh0_makes_up:
            # What shN lost, as its views see it on average.
            sh0 += np.einsum("nk,nkc->nc", costs.basis_mean, missed) / rate_costs.SH0_BASIS
        tail = records.pack([stream], digits=used.digits)
    kept_areas = plan_.scales[rows] if used.areas else scales
    opacities = _opacities(splats.opacities[rows], kept_areas, scales)
    opacity_grid = grids.fit(opacities, allocation.equal_step(lagrangian, costs.opacity))
    clear = refinement_split.cut(
        Attribute.OPACITIES, opacities, opacity_grid, costs.opacity, coarse.opacities
    )
    colour, coloured = _sh0(sh0, costs.energy, lagrangian, coarse.sh0)
    head = [
        scale_differences.write(sizes.coarse, sizes.grid),
        turns,
        means,
        scalar.write(Attribute.OPACITIES, clear.coarse, clear.grid),
        colour,
    ]
    sized = _Later(sizes.digits, _scale_gain(sizes, ladder[inside], costs))
    cleared = _Later(clear.digits, float(costs.opacity @ _squares(clear, opacities)[:, 0]))
    later = (sized, turned, moved, cleared, coloured)
    below = [part.stream for part in later if part.stream is not None]
    needs = (BASIS,) if tail is not None else ()
    return Payloads(
        records.pack(head, digits=used.digits),
        tail,
        (),
        needs,
        inside,
        records.pack(below, digits=used.digits) if below else None,
        sum(part.gain for part in later),
    )


@dataclass(frozen=True, eq=False)
class _Later:
    """What a refinement brings of an attribute, and the squared error that it removes."""

    stream: Stream | None
    gain: float = 0.0


_WHOLE: Final = _Later(None)


def _squares(parts: Cut, values: F32) -> F64:
    """Return the squared error that the digits of values remove, (n, c)."""
    wide = values.astype(np.float64)
    return np.square(parts.coarse - wide) - np.square(parts.fine - wide)


def _scale_gain(parts: Cut, ladder: F32, costs: Costs) -> float:
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    return float((_squares(parts, ladder) * np.stack(columns, axis=1)).sum())


def _ladder(scales: F32, costs: Costs, lagrangian: float, areas: bool) -> tuple[F32, Grid]:
    """Return the ladder to store and its grid: what one value loses, the next makes up for.

    A splat's weight in a picture goes with its area, about the product of its two longer axes. The
    errors of single splats average out; a change of all their areas does not.
    """
    columns = (costs.scale_long, costs.scale_middle, costs.scale_thin)
    steps = np.array([allocation.equal_step(lagrangian, column) for column in columns])
    ladder = scale_differences.differences_of(scales)
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


def _turns(
    turns: F64, scales: tuple[F32, F32], costs: Costs, plan_: TransformPlan, halvings: int
) -> tuple[Stream, _Later]:
    """Return the rotations of a head, and what refines them by so many halvings."""
    # Of shapes all alike, every one gets the same resolution.
    head, fine = scales if plan_.ablation.fine_turns else map(np.zeros_like, scales)
    lagrangian = plan_.lagrangian * 4.0**halvings
    tilt = adaptive_step.fit(head, costs.tilt, lagrangian, _TURN_STEP)
    spin = adaptive_step.fit(head, costs.spin, lagrangian, _TURN_STEP)
    if not halvings:
        return swing_twist.turns(turns, head, tilt, spin)[0], _WHOLE
    constants = [
        adaptive_step.with_more_bits(
            tilt, halvings, fine, costs.tilt, plan_.lagrangian, _TURN_STEP
        ),
        adaptive_step.with_more_bits(
            spin, halvings, fine, costs.spin, plan_.lagrangian, _TURN_STEP
        ),
    ]
    stream, below, coarse = swing_twist.refined_turns(turns, head, tilt, spin, fine, constants)
    missed = np.square(turns - coarse)
    gain = float(costs.tilt @ (missed[:, 0] + missed[:, 1]) + costs.spin @ missed[:, 2])
    return stream, _Later(below, gain)


def _about_bits(stream: Stream | None) -> float:
    """Return about how many bits the planes of a stream take: those of their bytes, each alone."""
    if stream is None:
        return 0.0
    return sum(refinement_split.bits(np.bincount(np.ravel(plane))) for plane in stream.planes)


def _affordable(
    cut: Callable[[int], tuple[I64, Stream, _Later]], most: int
) -> tuple[I64, Stream, _Later]:
    """Return a cut by as many halvings as cost no more than the bits that wait are worth.

    Values that follow from a row's own resolution cost more in two parts; and splats that share a
    cell of a coarse grid have no order there, which a sorted fine one need not spend bits on.
    """
    whole = cut(0)
    bits = _about_bits(whole[1])
    for halvings in range(most, 0, -1):
        tried = cut(halvings)
        waiting = _about_bits(tried[2].stream)
        if _about_bits(tried[1]) + waiting - bits <= refinement_split.WORTH * waiting:
            return tried
    return whole


def _means(
    means: F32, scales: tuple[F32, F32], costs: F64, wish: tuple[float, int], sort: bool
) -> tuple[I64, Stream, _Later]:
    """Return the order inside a chunk and its means, fine where the grid can hold them.

    `scales` are the head's and the refined ones; `wish` λ and the halvings that can wait.
    """
    lagrangian, later = wish
    head, fine = scales
    coarse_slope = lagrangian * 4.0**later
    wanted = np.log2(allocation.own_steps(coarse_slope, costs))
    # A power of two below which only the coarsest splats' steps lie: halvings start at 0 there.
    base = float(2.0 ** np.floor(np.quantile(wanted, 1 - _COARSEST)))
    base = min(base, _widest(means))
    coarse = adaptive_step.fit(head, costs, coarse_slope, base)
    halvings = coarse.extra_bits(head)
    extra = np.zeros_like(halvings)
    constant = 0.0
    if later:
        constant = adaptive_step.with_more_bits(coarse, later, fine, costs, lagrangian, base)
        extra = refinement_bits.gained(
            refinement_bits.with_constant(coarse, constant), fine, halvings
        )
    total = halvings + extra
    grid = _grid(means, base)
    top = grid.levels.astype(np.float64) * 2.0 ** int(total.max())
    if not sort or int(grid.levels.max()) > morton.MAX_LEVELS or top.max() >= 2.0**31:
        return *chunk_means(means, allocation.equal_step(lagrangian, costs), sort), _WHOLE
    codes = sorted_means.codes_of(means, grid, total)
    kept, _ = refinement_bits.coarse_of(codes, extra[:, None])
    order = sorted_means.morton_order(kept, halvings)
    stored, below = sorted_means.refine(codes[order], extra[order], constant)
    stream = sorted_means.write(stored, grid, halvings[order], coarse)
    if not later:
        return order, stream, _WHOLE
    missed = np.square(means[order] - sorted_means.values(stored, grid, halvings[order]))
    return order, stream, _Later(below, float(costs[order] @ missed.sum(axis=1)))


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


def _sh0(
    values: F64, energy: F64, lagrangian: float, most: tuple[int, ...]
) -> tuple[Stream, _Later]:
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
    step = allocation.equal_step(lagrangian, energy * rate_costs.SH0_COST * rate_costs.SH0_WEIGHT)
    parts = refinement_split.cut(Attribute.SH0, on_axes, grids.fit(on_axes, step), energy, most)
    stream = sh0_transform.write(parts.coarse, axes, parts.grid)
    missed = _squares(parts, on_axes) @ np.square(axes.astype(np.float64)).sum(axis=1)
    return stream, _Later(parts.digits, float(rate_costs.SH0_COST * (energy @ missed)))
