"""Codebooks of scalars by k-means, near the optimum found by dynamic programming."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# A cell is a run of sorted values represented by one codebook value. Dynamic programming merges 4
# times the final number of cells, at most 64 cells into one.
_FINE_CELL_FACTOR: Final = 4
_MAX_MERGED: Final = 64

# Lloyd iterations at most, and bins of the histogram that gives the first cells.
_ITERATIONS: Final = 200
_BINS: Final = 4096


def train_scalars(values: F32, levels: int) -> F32:
    """Train a scalar codebook with low squared error.

    Parameters
    ----------
    values : (n,) float32
        Finite values in any order.
    levels : int
        Codebook values at most, at least 1.

    Returns
    -------
    (C,) float32
        Distinct codebook values, ascending. If `values` has at most `levels` distinct values, the
        codebook is these values.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.clustering.scalar_kmeans import train_scalars
    >>> train_scalars(np.array([1, 1, 4, 8, 9, 10], np.float32), 2).tolist()
    [2.0, 9.0]
    """
    ordered = np.sort(values)
    first = np.ones(len(ordered), np.bool_)
    first[1:] = ordered[1:] > ordered[:-1]
    distinct = ordered[first]
    if len(distinct) <= levels:
        return distinct
    sample = _SortedValues(ordered)
    cells = sample.split(sample.first_cells(levels), _FINE_CELL_FACTOR * levels)
    cells = sample.lloyd(sample.merge(cells, levels), _ITERATIONS)
    return np.unique(sample.centres(cells).astype(np.float32))


def nearest_scalars(values: F32, codebook: F32) -> NDArray[np.intp]:
    """Return the index of the nearest codebook value of each value.

    Parameters
    ----------
    values : any shape, float32
        Values to look up.
    codebook : (C,) float32
        Codebook values, ascending.

    Returns
    -------
    intp, shape of `values`
        Indices; ties go to the lower codebook value.
    """
    between = (codebook[:-1].astype(np.float64) + codebook[1:]) / 2
    return np.searchsorted(between, values)


class _SortedValues:
    """Sorted values with prefix sums, for the sum and squared error of any cell.

    A cell is a run of the sorted values. The methods give C cells as C + 1 ascending positions: the
    first value of each cell, then the number of values.
    """

    def __init__(self, ordered: F32) -> None:
        self.values = ordered.astype(np.float64)
        # Centred on the mean, against cancellation of squares.
        self.middle = float(self.values.mean())
        moved = self.values - self.middle
        self.sums = np.concatenate([[0.0], np.cumsum(moved)])
        self.squares = np.concatenate([[0.0], np.cumsum(np.square(moved))])

    def first_cells(self, levels: int) -> NDArray[np.intp]:
        """Return `levels` cells whose density is the cube root of the values' density.

        This is optimal for many levels: Panter and Dite, "Quantization distortion in pulse-count
        modulation with nonuniform spacing of levels" (1951).
        """
        counts, edges = np.histogram(self.values, _BINS)
        shares = np.concatenate([[0.0], np.cumsum(np.cbrt(counts))])
        places = (np.arange(levels) + 0.5) / levels * shares[-1]
        return self._nearest_cells(np.interp(places, shares, edges))

    def centres(self, cells: NDArray[np.intp]) -> F64:
        """Return the mean of each cell; no cell may be empty."""
        means: F64 = np.diff(self.sums[cells]) / np.diff(cells) + self.middle
        return means

    def lloyd(self, cells: NDArray[np.intp], iterations: int) -> NDArray[np.intp]:
        """Improve cells by Lloyd iterations, until convergence but at most `iterations`."""
        for _ in range(iterations):
            better = self._nearest_cells(self.centres(cells))
            if np.array_equal(better, cells):
                break
            cells = better
        return cells

    def split(self, cells: NDArray[np.intp], levels: int) -> NDArray[np.intp]:
        """Divide the cells of largest error at their means, until there are `levels` cells.

        There are fewer cells if every cell holds equal values.
        """
        while len(cells) - 1 < levels:
            sums, counts = np.diff(self.sums[cells]), np.diff(cells)
            errors = np.diff(self.squares[cells]) - sums**2 / counts
            errors[self.values[cells[:-1]] == self.values[cells[1:] - 1]] = 0
            # A third of the cells at a time, so that new cells soon compete with the rest.
            most = min(levels - len(counts), len(counts) // 3 + 1)
            worst = np.argsort(-errors, kind="stable")[:most]
            worst = worst[errors[worst] > 0]
            middles = sums[worst] / counts[worst] + self.middle
            cuts = np.searchsorted(self.values, middles, side="right")
            # A mean rounded up to the cell's last value would leave the cell uncut.
            cuts = np.minimum(cuts, np.searchsorted(self.values, self.values[cells[worst + 1] - 1]))
            finer = np.union1d(cells, cuts)
            if len(finer) == len(cells):
                break
            cells = finer
        return cells

    def merge(self, cells: NDArray[np.intp], levels: int) -> NDArray[np.intp]:
        """Merge neighbouring cells into `levels` cells of minimum squared error.

        The borders to keep are found by dynamic programming (Bruce, 1965).
        """
        fine = len(cells) - 1
        if fine <= levels:
            return cells
        width = min(_MAX_MERGED, fine)
        # cost[j, t]: squared error of the fine cells j - 1 - t to j - 1 merged into one.
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

    def _nearest_cells(self, centres: F64) -> NDArray[np.intp]:
        """Return the cells of ascending centres: each value belongs to its nearest centre."""
        inner = np.searchsorted(self.values, (centres[:-1] + centres[1:]) / 2, side="right")
        return np.unique(np.concatenate([[0], inner, [len(self.values)]]))
