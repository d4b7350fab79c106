"""Marginal gains: drop of a picture's squared error when one splat is added or removed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .blending import (
    BLUE,
    GREEN,
    LANES,
    OFF_BLUE,
    OFF_GREEN,
    OFF_RED,
    PIXELS,
    PLANES_COMPARED,
    RED,
    blend_pixel,
    compare_tile,
    draw_and_reopen,
    footprint_in_tile,
    rows_in_tile,
    store_lane_sums,
)
from .jit import kernel
from .projection import Footprints
from .tiles import TILE, add_pair_sums, tile_lists

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)


@called_with(
    "int64, int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "boolean[::1], int64, int64, float32[:, :, ::1], float32[:, ::1]"
)
@kernel
def _measure_gains(
    lists_first: int,
    lists_last: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    width: int,
    height: int,
    target: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> float:
    """Sum the gain of every pair of a tile and a splat; return the sum of squared errors.

    An empty target stands for the picture itself.

    Each tile is walked twice: `blend_tile` draws the splats that are present. The second walk, over
    all splats, has at each splat the transmittance before it and the colour behind it, which
    determine the effect of adding or removing the splat.
    """
    state = np.empty(PLANES_COMPARED * PIXELS, np.float32)
    lanes = np.empty(TILE, np.float32)
    error = 0.0
    for tile in range(lists_first, lists_last):
        top, left, num_rows, num_columns, begin, stop = draw_and_reopen(
            state,
            sums,
            1,
            tile,
            lists_first,
            starts,
            members,
            ellipse,
            rows,
            colours,
            present,
            width,
            height,
        )
        # Without a comparison, `draw_and_reopen` leaves the differences at 0.
        if len(target):
            error = compare_tile(state, target, top, left, num_rows, num_columns, error)
        for pair in range(begin, stop):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            lanes[:] = _ZERO
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                # Pixels outside the image have transmittance, colours and error 0: they add 0.
                if present[i]:
                    for lane in range(LANES):
                        at = base + lane
                        u = narrow * (np.float32(lane) - row_x)
                        _, alpha, weight, drawn, after = blend_pixel(
                            state[at], opacity, row_exponent - u * u
                        )
                        # Without the splat, the colour behind it is 1 / (1 - alpha) as bright.
                        odds = alpha / (_ONE - alpha) if drawn else _ZERO
                        state[at] = after
                        behind_red = state[at + RED] - weight * red
                        behind_green = state[at + GREEN] - weight * green
                        behind_blue = state[at + BLUE] - weight * blue
                        state[at + RED] = behind_red
                        state[at + GREEN] = behind_green
                        state[at + BLUE] = behind_blue
                        change_red = odds * behind_red - weight * red
                        change_green = odds * behind_green - weight * green
                        change_blue = odds * behind_blue - weight * blue
                        lanes[lane] += (
                            change_red * (_TWO * state[at + OFF_RED] - change_red)
                            + change_green * (_TWO * state[at + OFF_GREEN] - change_green)
                            + change_blue * (_TWO * state[at + OFF_BLUE] - change_blue)
                        )
                else:
                    for lane in range(LANES):
                        at = base + lane
                        u = narrow * (np.float32(lane) - row_x)
                        live = state[at]
                        _, alpha, _, drawn, _ = blend_pixel(live, opacity, row_exponent - u * u)
                        # A splat that would end the pixel is not blended.
                        alpha = alpha if drawn else _ZERO
                        change_red = alpha * (live * red - state[at + RED])
                        change_green = alpha * (live * green - state[at + GREEN])
                        change_blue = alpha * (live * blue - state[at + BLUE])
                        lanes[lane] += (
                            change_red * (_TWO * state[at + OFF_RED] - change_red)
                            + change_green * (_TWO * state[at + OFF_GREEN] - change_green)
                            + change_blue * (_TWO * state[at + OFF_BLUE] - change_blue)
                        )
            store_lane_sums(lanes, sums, 1, pair)
    return error


def marginal_gains(
    footprints: Footprints,
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    size: tuple[int, int],
    target: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Measure each splat's marginal gain: the drop of the error if it is added or removed.

    Parameters
    ----------
    footprints : Footprints
        Footprints of M splats, present and absent.
    colours : (M, 3) float32
        Colours of the footprints, in the scene's colour space (`shading.footprint_colours`).
    present : (M,) bool
        Mask of the splats in the picture.
    size : tuple of int
        Width and height of the picture, px.
    target : (H, W, 3) float32, optional
        Target picture over black; the picture of the present splats by default.

    Returns
    -------
    gains : (M,) float64
        Drop of the sum of squared errors over pixels and channels when this splat alone is added or
        removed; negative if the error rises. Exact except in pixels whose end
        (`blending.TRANSMITTANCE_MIN`) the splat changes.
    error : float
        Sum of squared errors of the picture.
    """
    gains = np.zeros((len(footprints), 1), np.float64)
    error = 0.0
    width, height = size
    if target is None:
        target = np.empty((0, 0, 3), np.float32)
    for lists in tile_lists(footprints, width, height):
        pair_gains = np.empty((len(lists.members), 1), np.float32)
        error += _measure_gains(
            lists.first,
            lists.last,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            colours,
            present,
            width,
            height,
            target,
            pair_gains,
        )
        add_pair_sums(lists.members, pair_gains, gains, 0)
    return gains[:, 0], error
