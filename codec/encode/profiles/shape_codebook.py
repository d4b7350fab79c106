"""Codebook of shapes of the profile `vq`; indices have the least error plus price of the bits.

A row is a rotation and two scales relative to the longest axis. A shape that costs less without the
codebook becomes an escape row: an index for it, and its values as without a codebook.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import entropy_kmeans
from cogsplat.codec.clustering.entropy_kmeans import RatedRows
from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.geometry import covariance, rotations
from cogsplat.codec.rate import allocation
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.segments import codebooks
from cogsplat.codec.streams import codebook_index, records, scalar, scale_differences, swing_twist
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import ESCAPE, Attribute, Stream

from .refined import NO_REFINEMENT, Refined, entropy_bits
from .shapes import ShapeSource, quantise_rotations, rotation_steps

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

# With the index of escape rows, indices take one byte, a plane. Two planes would both say which
# splats escape, for 0.4 bits a splat: 481 rows take as many bits in a house of rooms as 210.
_MOST_ROWS: Final = 255

# Bits of a row in the file.
_BITS_PER_ROW: Final = 45.0

# Records and words of the two streams that only a head with indices has, bits.
_RECORD_BITS: Final = 8 * 60

# Rows whose error is measured for each splat. In a house of rooms 8 take 0.9 bits a splat less than
# 1, and 16 take 0.06 less than 8.
_CANDIDATES: Final = 8

# Weight of the distance of two vectors, relative to the costs of swing and of the middle axis: of
# 1, 2 and 4 the one that took the fewest bits in four scenes.
_DISTANCE_WEIGHT: Final = 2.0

# Error that a bit is worth where rows are chosen, relative to other values: costs hold for small
# errors, and those of a row are large. Bytes at equal held-out PSNR against `transform`, at 34, 37
# and 40 dB nominal, at 1 and at 2: a house takes 8, 6 and 4 % less, and 10, 9 and 4 %; a terrace 3,
# 3 and 1 % less, and 5, 4 and 2 %; a captured room 3, 2 and 0 % less, and 3 and 1 % less and 1 %
# more; a captured object the same to 1 % more, and 0 to 3 % more. No row gains in a figure at 1.
_INDEX_PRICE: Final = 2.0

# A codebook is kept even if it raises the cost of all shapes, rows included, by up to this share:
# a caller that chooses the profile expects one.
_ACCEPTED: Final = 0.01

# Iterations of the choice of escape rows: the bits of an escape depend on the share of escapes.
_ROUNDS: Final = 3

# Minimum of 4 sinh² of the difference of two log scales: a rotation between equal axes changes
# nothing, and its weight would be infinite.
_LEAST_FLATNESS: Final = 0.05

# Squared radians per squared value of swing or twist (`rate.costs`).
_ROTATION_VALUE: Final = 2.5

# Vector of a ball, the row that training never drops: vectors are relative to it.
_BALL: Final = covariance.shape_vectors(
    np.array([[1, 0, 0, 0]], np.float32), np.zeros((1, 3), np.float32)
)


@dataclass(frozen=True, eq=False)
class IndexedShapes:
    """Quantised shapes of a chunk: indices into a codebook, scale factors, and escape rows.

    Parameters
    ----------
    indices : (n,) uint32
        Indices of rows of the codebook; `size` marks an escape row.
    size : int
        Rows of the codebook.
    own : ShapeSource
        Shapes of the escape rows.
    factors : (n, 1) float32
        Log scale factors: log lengths of the longest axis that keep each splat's area.
    grid : Grid
        Grid of `factors`.
    scales : (n, 3) float32
        Decoded log scales; columns middle, thin, long.
    lagrangian : float
        λ of the head.
    needs : tuple of int
        Codebooks that the head needs: one number.
    """

    indices: U32
    size: int
    own: ShapeSource
    factors: F32
    grid: Grid
    scales: F32
    lagrangian: float
    needs: tuple[int, ...]

    @property
    def head_scales(self) -> F32:
        """Log scales decoded from the head alone; nothing refines `scales`."""
        return self.scales

    def write(self, inside: I64) -> tuple[list[Stream], Refined]:
        """Return the streams of the head for rows in the order `inside`; nothing is refined."""
        indices = self.indices[inside]
        place = np.cumsum(self.indices == self.size) - 1
        own = self.own.take(place[inside][indices == self.size])
        escapes = _relative_streams(own, self.lagrangian)[0] if len(own) else []
        (number,) = self.needs
        streams = [
            *(replace(stream, flags=ESCAPE) for stream in escapes),
            codebook_index.write(Attribute.SHAPE, indices, number, self.size),
            scalar.write(Attribute.SCALE_FACTOR, self.factors[inside], self.grid),
        ]
        return streams, NO_REFINEMENT


@dataclass(frozen=True, eq=False)
class ShapeCodebook:
    """Codebook of shapes, and the chunks in which it costs less than shapes without it.

    Parameters
    ----------
    payload : bytes
        Payload of the segment.
    rows : ShapeCodebook
        Rows as a reader decodes them.
    search_rows : RatedRows
        Vectors of the rows, and the bits of their indices.
    chunks : frozenset of int
        First rows of the chunks that use the codebook.
    """

    payload: bytes
    rows: codebooks.ShapeCodebook
    search_rows: RatedRows
    chunks: frozenset[int] = frozenset()

    def quantise(self, source: ShapeSource, lagrangian: float, number: int) -> IndexedShapes:
        """Return the shapes of a chunk as indices of the codebook `number` and escape rows."""
        size = len(self.rows)
        indices = self.choose(source, _Vectors.of(source, lagrangian), lagrangian)[0]
        escaped = indices == size
        base = self.rows.scales[np.minimum(indices, size - 1)]
        own = source.take(np.flatnonzero(escaped))
        if len(own):
            base[escaped] = _relative_streams(own, lagrangian)[1]
        step = allocation.equal_step(lagrangian, source.costs.scale_long)
        # As in `differences_to_store`: areas are kept, also on average over a step.
        factors = source.scales[:, 2] - 0.5 * (base[:, 0] - _relative(source.scales)[:, 0])
        factors = (factors - step * step / 12).astype(np.float32)[:, None]
        grid = grids.fit(factors, step)
        stored = grid.dequantise(grid.quantise(factors))
        return IndexedShapes(
            indices, size, own, factors, grid, base + stored, lagrangian, (number,)
        )

    def choose(
        self, source: ShapeSource, vectors: _Vectors, lagrangian: float
    ) -> tuple[U32, float]:
        """Return the index of each splat, and error plus price of the bits of all.

        The size of the codebook stands for an escape row.
        """
        price = _price(lagrangian)
        near = self.search_rows.candidates(vectors.shapes, vectors.weights, price, _CANDIDATES)
        costs = _errors(source, self.rows, near) + price * self.search_rows.bits[near]
        best = costs.argmin(axis=1)
        places = np.arange(len(source))
        served = costs[places, best]
        chosen = near[places, best]
        share = 0.5
        least = 0.5 / len(source)
        for _ in range(_ROUNDS):
            escaped = served - price * np.log2(1 - share) > vectors.alone - price * np.log2(share)
            share = float(np.clip(escaped.mean(), least, 1 - least))
        indices = np.where(escaped, len(self.rows), chosen).astype(np.uint32)
        stream = codebook_index.write(Attribute.SHAPE, indices, 0, len(self.rows))
        errors = served - price * self.search_rows.bits[chosen]
        whole = float(np.where(escaped, vectors.alone, errors).sum())
        return indices, whole + price * (_RECORD_BITS + entropy_bits(stream))


@dataclass(frozen=True, eq=False)
class _Vectors:
    """Vectors, weights and costs of shapes, for training and for the choice of rows.

    Parameters
    ----------
    shapes : (n, 6) float32
        Vectors, relative to a ball.
    weights : (n,) float64
        Error per squared distance.
    alone : (n,) float64
        Error plus price of the bits of each shape without a codebook.
    costs : (n, 4) float64
        Costs of the middle axis, the thin axis, swing and twist.
    """

    shapes: F32
    weights: F64
    alone: F64
    costs: F64

    @classmethod
    def of(cls, source: ShapeSource, lagrangian: float) -> _Vectors:
        """Return the vectors of shapes, with what they cost without a codebook."""
        found = source.costs
        costs = np.stack([found.scale_middle, found.scale_thin, found.swing, found.twist], axis=1)
        quats = swing_twist.compose(source.angles.astype(np.float32))
        return cls(
            _vectors(quats, source.scales),
            _DISTANCE_WEIGHT * (found.swing + found.scale_middle),
            _alone(source, lagrangian),
            costs,
        )


def fit(
    source_of: Callable[[slice], ShapeSource],
    lagrangian: float,
    chunks: Sequence[slice],
    training: TrainingConfig,
    start: codebooks.ShapeCodebook | None = None,
) -> ShapeCodebook | None:
    """Train a codebook of shapes and choose its chunks; None if it costs more than accepted.

    Parameters
    ----------
    source_of : callable
        Returns the shapes of a range of rows.
    lagrangian : float
        λ of the encode.
    chunks : sequence of slice
        Row ranges of the chunks, at least one.
    training : TrainingConfig
        Iterations and training vectors at most.
    start : ShapeCodebook, optional
        Decoded codebook of an earlier encode to start from.
    """
    price = _price(lagrangian)
    parts = [_Vectors.of(source_of(run), lagrangian) for run in chunks]
    every = _Vectors(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in _Vectors.__dataclass_fields__
        )
    )
    found = _train(every, lagrangian, training, start)
    costs = np.array(
        [
            found.choose(source_of(run), part, lagrangian)[1]
            for run, part in zip(chunks, parts, strict=True)
        ]
    )
    saved = np.array([part.alone.sum() for part in parts]) - costs
    used = frozenset(run.start for run, gain in zip(chunks, saved, strict=True) if gain > 0)
    taken = 8 * price * len(found.payload)
    taken -= _ACCEPTED * float(every.alone.sum())
    worth = used and saved[saved > 0].sum() > taken
    return replace(found, chunks=used) if worth else None


def _train(
    every: _Vectors,
    lagrangian: float,
    training: TrainingConfig,
    start: codebooks.ShapeCodebook | None,
) -> ShapeCodebook:
    """Train a codebook on the vectors of a scene."""
    price = _price(lagrangian)
    share = min(1.0, training.samples / len(every.shapes))
    taken = np.random.default_rng(training.seed).random(len(every.shapes)) < share
    sample, weights, alone = every.shapes[taken], every.weights[taken], every.alone[taken]
    trained = entropy_kmeans.train(
        sample,
        weights,
        _MOST_ROWS,
        price,
        # A sample saves its share of the bits only.
        share * _BITS_PER_ROW,
        training,
        None if start is None else _vectors(start.quats, start.scales),
        alone,
    )
    labels, costs, _ = trained.assign(sample, weights, price)
    own = costs < alone
    size = len(trained.rows)
    mass = [
        np.bincount(labels[own], column[taken][own] / share, minlength=size)
        for column in every.costs.T
    ]
    least = every.costs.min(axis=0)
    middle, thin, swing, twist = (
        np.maximum(one, floor) for one, floor in zip(mass, least, strict=True)
    )
    none = np.zeros(size)
    row_costs = Costs(none, none, none, none, middle, thin, swing, twist, none[:, None])
    quats, scales = covariance.quats_and_scales(trained.rows + _BALL)
    rows = ShapeSource(*swing_twist.decompose(quats, 2 * scales), row_costs)
    payload = records.pack(_relative_streams(rows, lagrangian)[0])
    decoded = codebooks.decode_shape_codebook(memoryview(payload), size, "shape codebook")
    search_rows = RatedRows(_vectors(decoded.quats, decoded.scales), trained.bits)
    return ShapeCodebook(payload, decoded, search_rows)


def _price(lagrangian: float) -> float:
    """Return the error that a bit is worth where rows are chosen."""
    return _INDEX_PRICE * allocation.bit_price(lagrangian)


def _vectors(quats: F32, scales: F32) -> F32:
    """Return shapes as (n, 6) vectors relative to a ball.

    They are of deviations rather than variances: a thin axis counts more.
    """
    vectors: F32 = covariance.shape_vectors(quats, np.float32(0.5) * scales) - _BALL
    return vectors


def _relative(scales: F32) -> F32:
    """Return log scales relative to the longest axis, the last column."""
    return scales - scales[:, 2:]


def _relative_streams(source: ShapeSource, lagrangian: float) -> tuple[list[Stream], F32]:
    """Return the streams of shapes without their size, and the decoded relative scales."""
    differences = scale_differences.differences_of(_relative(source.scales))
    costs = (source.costs.scale_middle, source.costs.scale_thin)
    # The first difference, the size, is 0 in all rows: a grid of one level.
    steps = [1.0, *(allocation.equal_step(lagrangian, cost) for cost in costs)]
    grid = grids.fit(differences, np.array(steps))
    stored = scale_differences.scales_of(grid.dequantise(grid.quantise(differences)))
    return [
        scale_differences.write(differences, grid),
        quantise_rotations(source, stored, lagrangian),
    ], stored


def _alone(source: ShapeSource, lagrangian: float) -> F64:
    """Return error plus price of the bits of each shape without a codebook, but for its size."""
    (sizes, turns), stored = _relative_streams(source, lagrangian)
    costs = source.costs
    error = np.zeros(len(source))
    for cost in (costs.scale_middle, costs.scale_thin):
        error += cost * allocation.equal_step(lagrangian, cost) ** 2 / 12
    extra = swing_twist.extra_bits_of(stored, *rotation_steps(source, stored, lagrangian))
    for bits, cost in zip(extra, (costs.swing, costs.swing, costs.twist), strict=True):
        error += cost * swing_twist.STEPS[bits].astype(np.float64) ** 2 / 12
    held = np.sum(extra, axis=0, dtype=np.float64)
    # Codes are not equally frequent: their entropy is below the number of their bits.
    held *= entropy_bits(turns) / max(float(held.sum()), 1.0)
    return error + _price(lagrangian) * (entropy_bits(sizes) / len(source) + held)


def _errors(source: ShapeSource, rows: codebooks.ShapeCodebook, near: I64) -> F64:
    """Return the error of the rows `near`, (n, k), in place of each shape.

    The error is measured along the axes of the source, in units of its deviations: the diagonal of
    the row's covariance there is a change of scales, the rest a rotation.
    """
    costs = source.costs
    quats = swing_twist.compose(source.angles.astype(np.float32))
    scales = _relative(source.scales).astype(np.float64)
    to_source = rotations.matrices(quats) * np.exp(-scales)[:, None, :]
    row_scales = _relative(rows.scales).astype(np.float64)
    frames = rotations.matrices(rows.quats) * np.exp(row_scales)[:, None, :]
    # The scale factor keeps the area.
    grown = np.exp(0.5 * (scales[:, None, 0] - row_scales[near, 0]))
    turned = np.einsum("nji,nkjl->nkil", to_source, frames[near] * grown[..., None, None])
    found = np.einsum("nkil,nkjl->nkij", turned, turned)
    middle, thin, long = (0.5 * np.log(np.maximum(found[..., i, i], 1e-9)) for i in range(3))
    out: F64 = costs.scale_long[:, None] * np.square(long)
    out += costs.scale_middle[:, None] * np.square(long - middle)
    out += costs.scale_thin[:, None] * np.square(middle - thin)
    for i, j, cost in ((0, 2, costs.swing), (1, 2, costs.swing), (0, 1, costs.twist)):
        flat = np.square(2 * np.sinh(scales[:, i] - scales[:, j]))
        weight = cost / (_ROTATION_VALUE * np.maximum(flat, _LEAST_FLATNESS))
        out += weight[:, None] * np.square(found[..., i, j])
    return out
