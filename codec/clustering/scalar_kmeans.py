"""Codebooks of single values, close to the best: a dynamic programme, then Lloyd's steps."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The programme merges this many times as many cells as it leaves.
_FINER: Final = 4
# Most fine cells that one final cell is made of; the average is `_FINER`.
_WIDEST: Final = 64

_ITERATIONS: Final = 200
_BINS: Final = 4096


def train_scalars(values: F32, levels: int) -> F32:
    """Return the values that stand for many with little squared error.

    Parameters
    ----------
    values : (n,) float32
        Finite, in any order.
    levels : int
        Most values in the codebook, at least 1.

    Returns
    -------
    (C,) float32
        Ascending and distinct; the distinct `values` themselves where they are no more than
        `levels`.
    """
    ordered = np.sort(values)
    first = np.ones(len(ordered), np.bool_)
    first[1:] = ordered[1:] > ordered[:-1]
    distinct = ordered[first]
    if len(distinct) <= levels:
        return distinct
    sample = _Sorted(ordered)
    cells = sample.split(sample.start(levels), _FINER * levels)
    cells = sample.lloyd(sample.merge(cells, levels), _ITERATIONS)
    return np.unique(sample.centres(cells).astype(np.float32))


def nearest_scalars(values: F32, codebook: F32) -> NDArray[np.intp]:
    """Return the index of the nearest of ascending codebook values for each value, any shape."""
    between = (codebook[:-1].astype(np.float64) + codebook[1:]) / 2
    return np.searchsorted(between, values)


class _Sorted:
    """Ascending values with sums over any run of them; cells are the places where runs begin."""

    def __init__(self, ordered: F32) -> None:
        self.values = ordered.astype(np.float64)
        # Around the mean, so that squares do not cancel.
        self.middle = float(self.values.mean())
        moved = self.values - self.middle
        self.sums = np.concatenate([[0.0], np.cumsum(moved)])
        self.squares = np.concatenate([[0.0], np.cumsum(np.square(moved))])

    def start(self, levels: int) -> NDArray[np.intp]:
        """Cut where centres spaced with the cube root of the density meet, best for many levels.

        Panter and Dite, "Quantization distortion in pulse-count modulation with nonuniform spacing
        of levels" (1951).
        """
        counts, edges = np.histogram(self.values, _BINS)
        shares = np.concatenate([[0.0], np.cumsum(np.cbrt(counts))])
        places = (np.arange(levels) + 0.5) / levels * shares[-1]
        return self._cut(np.interp(places, shares, edges))

    def centres(self, cells: NDArray[np.intp]) -> F64:
        """Return the mean of each cell, none of them empty."""
        means: F64 = np.diff(self.sums[cells]) / np.diff(cells) + self.middle
        return means

    def lloyd(self, cells: NDArray[np.intp], iterations: int) -> NDArray[np.intp]:
        """Return better cells, where no value is nearer to another cell's mean."""
        for _ in range(iterations):
            better = self._cut(self.centres(cells))
            if np.array_equal(better, cells):
                break
            cells = better
        return cells

    def split(self, cells: NDArray[np.intp], levels: int) -> NDArray[np.intp]:
        """Return `levels` cells, or as many as there are, by halving those of the largest error."""
        while len(cells) - 1 < levels:
            sums, counts = np.diff(self.sums[cells]), np.diff(cells)
            errors = np.diff(self.squares[cells]) - sums**2 / counts
            errors[self.values[cells[:-1]] == self.values[cells[1:] - 1]] = 0
            # A third at a time, so that halves take part soon.
            most = min(levels - len(counts), len(counts) // 3 + 1)
            worst = np.argsort(-errors, kind="stable")[:most]
            worst = worst[errors[worst] > 0]
            middles = sums[worst] / counts[worst] + self.middle
            cuts = np.searchsorted(self.values, middles, side="right")
            # A mean rounded up to the last value would cut nothing off.
            cuts = np.minimum(cuts, np.searchsorted(self.values, self.values[cells[worst + 1] - 1]))
            finer = np.union1d(cells, cuts)
            if len(finer) == len(cells):
                break
            cells = finer
        return cells

    def merge(self, cells: NDArray[np.intp], levels: int) -> NDArray[np.intp]:
        """Return the best `levels` cells that whole given cells make (Bruce, 1965)."""
        fine = len(cells) - 1
        if fine <= levels:
            return cells
        width = min(_WIDEST, fine)
        # cost[j, t]: the error of one cell made of the fine cells from j - 1 - t to before j.
        ends = np.arange(fine + 1)[:, None]
        begins = ends - 1 - np.arange(width)
        legal = begins >= 0
        low, high = cells[begins.clip(0)], cells[ends]
        sums = self.sums[high] - self.sums[low]
        cost = self.squares[high] - self.squares[low] - sums**2 / (high - low).clip(1)
        cost[~legal] = np.inf
        best = np.full(fine + 1, np.inf)
        best[0] = 0
        padding = np.full(width, np.inf)
        choices = np.empty((levels, fine + 1), np.intp)
        for level in range(levels):
            before = sliding_window_view(np.concatenate([padding, best]), width)[: fine + 1, ::-1]
            total = before + cost
            choices[level] = total.argmin(axis=1)
            best = np.take_along_axis(total, choices[level][:, None], axis=1)[:, 0]
        places = [fine]
        for level in reversed(range(levels)):
            places.append(places[-1] - 1 - int(choices[level, places[-1]]))
        return cells[places[::-1]]

    def _cut(self, centres: F64) -> NDArray[np.intp]:
        inner = np.searchsorted(self.values, (centres[:-1] + centres[1:]) / 2, side="right")
        return np.unique(np.concatenate([[0], inner, [len(self.values)]]))
