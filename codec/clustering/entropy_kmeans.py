"""Codebooks for entropy-coded indices: rows and indices are chosen by error and bits together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .kmeans import TrainingConfig

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Vectors per block of the search: their costs for 1024 rows take 2 MiB and stay in the cache.
_BLOCK: Final = 512

# Share of all rows that one iteration may drop. What the members of a dropped row lose is known
# only while the row they move to stays.
_DROP_SHARE: Final = 0.25

# Uses of a row that none uses, for the bits of its index.
_FEWEST_USES: Final = 0.5


@dataclass(frozen=True, eq=False)
class RatedRows:
    """Rows of a codebook, with the bits of their indices.

    Parameters
    ----------
    rows : (C, d) float32
        Rows; the first is zero.
    bits : (C,) float64
        Bits of each row's index, entropy-coded.
    """

    rows: F32
    bits: F64

    def assign(self, vectors: F32, weights: F64, bit_price: float) -> tuple[I64, F64, F64]:
        """Return the row of least cost of each vector, its cost, and that of the second best row.

        The cost is the weighted squared distance plus the price of the index's bits.

        Parameters
        ----------
        vectors : (n, d) float32
            Vectors to look up.
        weights : (n,) float64
            Error per squared distance of each vector.
        bit_price : float
            Error that one bit is worth, positive.
        """
        best = np.empty(len(vectors), np.int64)
        costs = np.empty((len(vectors), 2))
        for block, total in self._costs(vectors, weights, bit_price):
            rows = np.arange(len(total))
            chosen = total.argmin(axis=1)
            best[block] = chosen
            costs[block, 0] = total[rows, chosen]
            total[rows, chosen] = np.inf
            costs[block, 1] = total.min(axis=1)
        return best, costs[:, 0], costs[:, 1]

    def candidates(self, vectors: F32, weights: F64, bit_price: float, count: int) -> I64:
        """Return the `count` rows of least cost of each vector, in any order, or all rows.

        Parameters
        ----------
        vectors, weights, bit_price
            As in `assign`.
        count : int
            Rows to return for each vector.
        """
        count = min(count, len(self.rows))
        out = np.empty((len(vectors), count), np.int64)
        for block, total in self._costs(vectors, weights, bit_price):
            out[block] = np.argpartition(total, count - 1, axis=1)[:, :count]
        return out

    def _costs(self, vectors: F32, weights: F64, bit_price: float) -> Iterator[tuple[slice, F32]]:
        """Yield the costs of all rows for each block of vectors."""
        norms = np.square(self.rows).sum(axis=1)
        transposed = np.ascontiguousarray(self.rows.T)
        index_price = (bit_price * self.bits).astype(np.float32)
        scales = weights.astype(np.float32)
        for start in range(0, len(vectors), _BLOCK):
            block = slice(start, min(start + _BLOCK, len(vectors)))
            total = vectors[block] @ transposed
            total *= -2
            total += norms
            total += np.square(vectors[block]).sum(axis=1)[:, None]
            np.maximum(total, 0, out=total)
            total *= scales[block, None]
            total += index_price
            yield block, total


def train(
    vectors: F32,
    weights: F64,
    rows: int,
    bit_price: float,
    row_bits: float,
    config: TrainingConfig,
    start: F32 | None = None,
    alone: F64 | None = None,
) -> RatedRows:
    """Train a codebook whose indices are entropy-coded.

    Parameters
    ----------
    vectors : (n, d) float32
        Vectors, at least one.
    weights : (n,) float64
        Error per squared distance of each vector, positive.
    rows : int
        Rows at most, at least 1.
    bit_price : float
        Error that one bit is worth, positive.
    row_bits : float
        Bits that a row takes in the file. A row that saves less is dropped.
    config : TrainingConfig
        Iterations and seed; all vectors are used.
    start : (c, d) float32, optional
        Rows of an earlier codebook to start from, the first of them zero; None draws vectors.
    alone : (n,) float64, optional
        Cost of each vector without the codebook. A vector that costs less alone shapes no row.

    Notes
    -----
    Entropy-constrained vector quantisation: Chou, Lookabaugh and Gray, "Entropy-constrained vector
    quantization" (1989).
    """
    limit = np.full(len(vectors), np.inf) if alone is None else alone
    book = _first(vectors, weights, rows, bit_price, config.seed, start, limit)
    for iteration in range(config.iterations):
        labels, costs, second = book.assign(vectors, weights, bit_price)
        # What a vector saves by its row: nothing where it costs less alone.
        second, costs = np.minimum(second, limit), np.minimum(costs, limit)
        saved = np.bincount(labels, second - costs, minlength=len(book.rows))
        worth = saved > bit_price * row_bits
        worth[0] = True
        most = int(_DROP_SHARE * len(worth)) + 1
        if iteration and not worth.all():
            order = np.argsort(saved, kind="stable")
            dropped = order[~worth[order]][:most]
            kept = np.ones(len(worth), np.bool_)
            kept[dropped] = False
            book = RatedRows(book.rows[kept], book.bits[kept])
            labels, costs, _ = book.assign(vectors, weights, bit_price)
        served = costs < limit
        book = _updated(book, vectors[served], weights[served], labels[served])
    return book


def _first(
    vectors: F32,
    weights: F64,
    rows: int,
    bit_price: float,
    seed: int,
    start: F32 | None,
    limit: F64,
) -> RatedRows:
    """Return the rows that training starts from, with indices of equal bits."""
    zero = np.zeros((1, vectors.shape[1]), np.float32)
    if start is None:
        rng = np.random.default_rng(seed)
        # In proportion to the bits that a vector is worth.
        error = np.minimum(weights * np.square(vectors.astype(np.float64)).sum(axis=1), limit)
        worth = np.log1p(error / bit_price)
        able = np.flatnonzero(worth > 0)
        share = worth[able] / worth[able].sum() if len(able) else None
        chosen = rng.choice(able, min(rows - 1, len(able)), replace=False, p=share)
        drawn = vectors[np.sort(chosen)]
    else:
        drawn = start[1:rows]
    first = np.concatenate([zero, drawn])
    return RatedRows(first, np.full(len(first), np.log2(len(first))))


def _updated(book: RatedRows, vectors: F32, weights: F64, labels: I64) -> RatedRows:
    """Return rows at the weighted means of their vectors, most used first behind the zero row."""
    count = len(book.rows)
    uses = np.bincount(labels, minlength=count)
    mass = np.bincount(labels, weights, minlength=count)
    rows = book.rows.astype(np.float64)
    for column in range(rows.shape[1]):
        sums = np.bincount(labels, weights * vectors[:, column], minlength=count)
        rows[:, column] = np.divide(sums, mass, out=rows[:, column], where=mass > 0)
    rows[0] = 0
    order = np.concatenate([[0], 1 + np.argsort(-uses[1:], kind="stable")])
    bits = np.log2(max(len(labels), 1) / np.maximum(uses, _FEWEST_USES))
    return RatedRows(rows.astype(np.float32)[order], bits[order])
