"""Compiled loops of the compensation fit over the splats of a prefix; they fill arrays in place.

A prefix may be half of a large scene, and each iteration visits all of it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.jit import kernel

from .shift_adam import BETA_1, BETA_2, EPSILON

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@called_with(
    "int64[::1], float64[:, ::1], float64[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[::1], float32[:, ::1], float32[::1]"
)
@kernel
def draw_shifts(
    starts: I64,
    chunk_shifts: F64,
    strengths: F64,
    own: F32,
    scales: F32,
    opacities: F32,
    drawn_scales: F32,
    drawn_opacities: F32,
) -> None:
    """Apply the shifts of a layer to the scales and opacities of a prefix.

    Parameters
    ----------
    starts : (c + 1,) int64
        First splat of each of the prefix's chunks, and the one after the last.
    chunk_shifts, strengths : (at least c, 2) float64
        Shifts and strengths of the layer's chunks: log scale, logit.
    own : (k, 2) float32
        Shifts of the first k splats; later splats have none.
    scales, opacities : (n, 3) float32, (n,) float32
        Decoded log scales and logits.
    drawn_scales, drawn_opacities : (n, 3) float32, (n,) float32
        Output: shifted log scales and logits.
    """
    for chunk in range(len(starts) - 1):
        for i in range(starts[chunk], starts[chunk + 1]):
            by_scale, by_opacity = chunk_shifts[chunk, 0], chunk_shifts[chunk, 1]
            if i < len(own):
                by_scale += strengths[chunk, 0] * own[i, 0]
                by_opacity += strengths[chunk, 1] * own[i, 1]
            for axis in range(3):
                drawn_scales[i, axis] = scales[i, axis] + np.float32(by_scale)
            drawn_opacities[i] = opacities[i] + np.float32(by_opacity)


@called_with("int32[::1], float64[::1], float64[::1], float64, float64[:, ::1]")
@kernel
def add_gradient(
    rows: NDArray[np.int32], by_scale: F64, by_opacity: F64, weight: float, gradients: F64
) -> None:
    """Add the weighted gradient of one view to the gradient of the prefix.

    Parameters
    ----------
    rows : (M,) int32
        Splats that the view shows.
    by_scale, by_opacity : (M,) float64
        Derivatives of the view's error w.r.t. log scale and logit.
    weight : float
        Weight of the view.
    gradients : (n, 2) float64
        Gradient of the prefix, changed in place.
    """
    for place in range(len(rows)):
        gradients[rows[place], 0] += weight * by_scale[place]
        gradients[rows[place], 1] += weight * by_opacity[place]


@called_with(
    "int64[::1], float64[:, ::1], float64[:, ::1], float64[::1], int64[::1], "
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float64[:, ::1], "
    "float64[:, ::1]"
)
@kernel
def move_shifts(
    starts: I64,
    gradients: F64,
    strengths: F64,
    rates: F64,
    counts: I64,
    means: F32,
    squares: F32,
    shifts: F32,
    own: F32,
    of_chunks: F64,
    of_strengths: F64,
) -> None:
    """Move the splats' own shifts by a step of Adam, and sum gradients per chunk.

    Parameters
    ----------
    starts : (c + 1,) int64
        First splat of each of the prefix's chunks, and the end of the last.
    gradients : (n, 2) float64
        Gradient by the shift of each splat's log scale and logit.
    strengths : (at least c, 2) float64
        Strengths of the layer's chunks.
    rates : (2,) float64
        Learning rates.
    counts : (at least c,) int64
        Step count of each chunk's splats, this step included.
    means, squares, shifts : (k, 2) float32
        Moments of the gradient, and the shifts; changed in place.
    own : (k, 2) float32
        Shifts with which the first k splats were rendered.
    of_chunks, of_strengths : (at least c, 2) float64
        Output: gradients by the chunks' shifts and by their strengths.
    """
    for chunk in range(len(starts) - 1):
        first_moment = 1.0 - BETA_1 ** float(counts[chunk])
        second_moment = 1.0 - BETA_2 ** float(counts[chunk])
        for axis in range(2):
            strength = strengths[chunk, axis]
            by_chunk, by_strength = 0.0, 0.0
            for i in range(starts[chunk], starts[chunk + 1]):
                slope = gradients[i, axis]
                by_chunk += slope
                if i >= len(own):
                    continue
                by_strength += slope * own[i, axis]
                slope *= strength
                mean = BETA_1 * means[i, axis] + (1.0 - BETA_1) * slope
                square = BETA_2 * squares[i, axis] + (1.0 - BETA_2) * slope * slope
                size = math.sqrt(square / second_moment) + EPSILON
                means[i, axis] = mean
                squares[i, axis] = square
                shifts[i, axis] -= rates[axis] * (mean / first_moment) / size
            of_chunks[chunk, axis] = by_chunk
            of_strengths[chunk, axis] = by_strength


@called_with("float32[:, ::1], float64[::1], float64[:, ::1], uint8[::1], float32[:, ::1]")
@kernel
def choose_rows(shifts: F32, spread: F64, book: F64, codes: NDArray[np.uint8], own: F32) -> None:
    """Assign each splat the codebook row nearest to its shift; the first of equally near rows.

    Parameters
    ----------
    shifts : (k, 2) float32
        Shifts of the splats.
    spread : (2,) float64
        Unit of distance, for log scales and for logits.
    book : (rows, 2) float64
        Codebook of at most 256 rows.
    codes, own : (k,) uint8, (k, 2) float32
        Output: numbers of the rows, and the rows.
    """
    for i in range(len(shifts)):
        least, nearest = math.inf, 0
        for row in range(len(book)):
            by_scale = (shifts[i, 0] - book[row, 0]) / spread[0]
            by_opacity = (shifts[i, 1] - book[row, 1]) / spread[1]
            distance = by_scale * by_scale + by_opacity * by_opacity
            if distance < least:
                least, nearest = distance, row
        codes[i] = nearest
        own[i, 0] = book[nearest, 0]
        own[i, 1] = book[nearest, 1]
