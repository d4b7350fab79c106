"""Running sums over views: the blending weights and viewing directions of each splat."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry import sh
from cogsplat.codec.render.blend_weights import PEAK, SQUARE, WEIGHT
from cogsplat.codec.render.jit import kernel
from cogsplat.codec.render.shading import sh_terms
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients
from cogsplat.codec.workspace import IN_MEMORY, Zeros

F64 = NDArray[np.float64]

_BASES = sh_coefficients(MAX_SH_DEGREE)

SHOWN_WEIGHT: Final = 0.01
"""Blending weight from which a pixel shows a splat; below it, the splat is only glimpsed.

Nearly every view of a city glimpses splats through the surfaces in front of them. If glimpses
count, 80 cameras of a city seem to show all of it, although 48 % of a picture from another camera
are splats that these only glimpse. From 0.01 on, scenes of which other cameras show more that is
new also have more splats shown by few cameras (docs/ablations.md, "Scoring large scenes").
"""

# Interval of the splats in the mean of `ViewSums.basis_spread`: a sample suffices.
_GRAM_STRIDE = 8


# Rows divided at once, which bounds temporary arrays.
_BLOCK = 1 << 16


@called_with(
    "int32[::1], int32[::1], float64[:, ::1], float32[:, ::1], float64[::1], float64, int64, "
    "boolean, boolean, float64[::1], float64[:, ::1], float64[::1], float64[::1], "
    "float32[::1], int32[::1], int32[::1], float64[:, ::1], float64[:, ::1]"
)
@kernel
def _add_view(
    reached: NDArray[np.int32],
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    means: NDArray[np.float32],
    position: NDArray[np.float64],
    share: float,
    num_pixels: int,
    colours: bool,
    directions: bool,
    contribution: NDArray[np.float64],
    bases: NDArray[np.float64],
    energy: NDArray[np.float64],
    largest_energy: NDArray[np.float64],
    peak: NDArray[np.float32],
    shown: NDArray[np.int32],
    covered: NDArray[np.int32],
    basis_sum: NDArray[np.float64],
    gram: NDArray[np.float64],
) -> None:
    """Add one view to the scene's sums; see `ViewSums.add`.

    `colours` enables the sum `bases`, `directions` the sums `basis_sum` and `gram`.
    """
    for i in reached:
        covered[i] += 1
    for row in range(len(index)):
        i = index[row]
        weight = share * sums[row, WEIGHT]
        square = sums[row, SQUARE]
        contribution[i] += weight
        energy[i] += share * square
        largest_energy[i] = max(largest_energy[i], square / num_pixels)
        peak[i] = max(peak[i], np.float32(sums[row, PEAK]))
        if sums[row, PEAK] >= SHOWN_WEIGHT:
            shown[i] += 1
        if not (colours or directions):
            continue
        x = means[i, 0] - position[0]
        y = means[i, 1] - position[1]
        z = means[i, 2] - position[2]
        inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        values = sh_terms(x * inverse, y * inverse, z * inverse)
        if colours:
            bases[i, 0] += weight * sh.C0
            for k in range(_BASES - 1):
                bases[i, k + 1] += weight * abs(values[k])
        square *= share
        if directions and square > 0.0:
            for j in range(basis_sum.shape[1]):
                basis_sum[i, j] += square * values[j]
            if i % _GRAM_STRIDE == 0:
                for j in range(basis_sum.shape[1]):
                    for k in range(j + 1):
                        gram[j, k] += square * values[j] * values[k]


@called_with("int32[::1], int32[::1], float64[:, ::1], float64, float64[:, ::1]")
@kernel
def add_rows(
    index: NDArray[np.int32],
    value_rows: NDArray[np.int32],
    values: F64,
    share: float,
    totals: F64,
) -> None:
    """Add scaled rows of values to totals by row of the scene, without temporary arrays.

    Parameters
    ----------
    index : (M,) int32
        Rows of the scene; ascending rows are added fastest, especially to a mapped array.
    value_rows : (M,) int32
        Row of `values` that is added to each row of `index`.
    values : (M, K) float64
        Values to add.
    share : float
        Factor on the values.
    totals : (N, K) float64
        Sums, changed in place.
    """
    for row in range(len(index)):
        value_row = value_rows[row]
        for column in range(values.shape[1]):
            totals[index[row], column] += share * values[value_row, column]


class ViewSums:
    """Running sums over the views of a scene of N splats.

    Parameters
    ----------
    splats : Splats
        Scene, whose means give the viewing directions.
    colours : bool
        Whether to sum `bases`, 128 bytes per splat.
    zeros : callable
        Allocator of the arrays, such as `Workspace.zeros`.

    Attributes
    ----------
    contribution : (N,) float64
        Σw, each view times its share, px.
    energy : (N,) float64
        Σw², each view times its share.
    largest_energy : (N,) float64
        Largest Σw² in one view, per pixel of that view.
    bases : (N, 16) float64
        Σw·|Y| of every SH basis Y in the direction of each view, times the view's share;
        0 rows unless `colours` is set.
    peak : (N,) float32
        Largest w in any pixel.
    shown : (N,) int32
        Number of views that show the splat: `SHOWN_WEIGHT` or more in some pixel.
    covered : (N,) int32
        Number of views that the splat's footprint reaches.
    """

    def __init__(
        self, splats: Splats, colours: bool = True, zeros: Zeros = IN_MEMORY.zeros
    ) -> None:
        n = len(splats)
        self._zeros = zeros
        self._means = splats.means
        self._colours = colours
        self._directions = bool(splats.sh_degree)
        self.contribution: F64 = zeros((n,), np.float64)
        self.energy: F64 = zeros((n,), np.float64)
        self.largest_energy: F64 = zeros((n,), np.float64)
        self.bases: F64 = zeros((n if colours else 0, _BASES), np.float64)
        self.peak: NDArray[np.float32] = zeros((n,), np.float32)
        self.shown: NDArray[np.int32] = zeros((n,), np.int32)
        self.covered: NDArray[np.int32] = zeros((n,), np.int32)
        bases = splats.shN.shape[1]
        self._basis_sum: F64 = zeros((n if self._directions else 0, bases), np.float64)
        self._gram = np.zeros((bases, bases), np.float64)

    def add(
        self,
        reached: NDArray[np.int32],
        index: NDArray[np.int32],
        sums: F64,
        position: F64,
        num_pixels: int,
        share: float,
    ) -> None:
        """Add the weights and viewing directions of one view to the sums.

        Ascending rows are added fastest.

        Parameters
        ----------
        reached : (M,) int32
            Rows of the splats whose footprint reaches the image.
        index : (S,) int32
            Rows of the splats that a pixel shows.
        sums : (S, 3) float64
            Sums of `blend_weights.add_weights` over all tiles, in the order of `index`.
        position : (3,) float64
            Position of the camera in the frame of the means.
        num_pixels : int
            Number of pixels of the view.
        share : float
            Weight of the view in all sums.
        """
        _add_view(
            reached,
            index,
            sums,
            self._means,
            position,
            share,
            num_pixels,
            self._colours,
            self._directions,
            self.contribution,
            self.bases,
            self.energy,
            self.largest_energy,
            self.peak,
            self.shown,
            self.covered,
            self._basis_sum,
            self._gram,
        )

    def basis_mean(self) -> NDArray[np.float32]:
        """Return the energy-weighted mean of the SH bases above DC over each splat's views.

        Returns
        -------
        (N, K-1) float32
            Means of the K - 1 bases of the scene's degree; zeros for splats that no view sees.
        """
        mean: NDArray[np.float32] = self._zeros((len(self.energy), len(self._gram)), np.float32)
        if not self._directions:
            return mean
        for start in range(0, len(mean), _BLOCK):
            rows = slice(start, start + _BLOCK)
            weight = np.where(self.energy[rows] > 0, self.energy[rows], 1.0)
            mean[rows] = self._basis_sum[rows] / weight[:, None]
        return mean

    def basis_spread(self) -> F64:
        """Return the covariance of the SH bases above DC over the views of one splat, as a mean.

        Returns
        -------
        (K-1, K-1) float64
            Energy-weighted mean of the covariances of every eighth splat of the scene.
        """
        if not self._directions:
            return np.zeros_like(self._gram)
        sampled = slice(None, None, _GRAM_STRIDE)
        weight = self.energy[sampled]
        sums = self._basis_sum[sampled][weight > 0]
        weight = weight[weight > 0]
        if len(weight) == 0:
            return np.zeros_like(self._gram)
        full = self._gram + np.tril(self._gram, -1).T
        # Sums in a fixed order: a matrix product's order depends on the number of threads.
        outer = np.einsum("nj,nk,n->jk", sums, sums, 1.0 / weight)
        spread: F64 = (full - outer) / weight.sum()
        return spread
