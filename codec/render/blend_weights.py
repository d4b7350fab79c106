"""Blend weights: how much each splat weighs in the pixels of one view, summed by splat."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with

from .blending import (
    LANES,
    PIXELS,
    all_ended,
    blend_pixel,
    footprint_in_tile,
    open_pixels,
    rows_in_tile,
    tile_area,
)
from .jit import kernel
from .projection import Footprints
from .tiles import TILE, TileLists, gather

_ZERO = np.float32(0.0)

WEIGHT, SQUARE, PEAK = range(3)
"""Columns of a view's sums: Σw, Σw² and the largest w, of the weights w = T·alpha."""
# Rows of a tile's lanes.
_SQUARES, _PEAKS, _ROW = np.uintp(TILE), np.uintp(2 * TILE), np.uintp(3 * TILE)

# No pixel blends more: ln(1e-4) / ln(1 - 1/255) = 2344 splats of the least alpha.
MOST_WEIGHTS = 2346


@called_with(
    "int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], int64, int64, float32, "
    "float32[:, ::1], int64, int64"
)
@kernel
def _weigh(
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    width: int,
    height: int,
    least_weight: np.float32,
    sums: NDArray[np.float32],
    first: int,
    last: int,
) -> None:
    """Sum the weights of every pair of a tile and a splat, for the tiles ``first`` to ``last``."""
    live = np.empty(PIXELS, np.float32)
    # Σw, Σw² and the largest w by column of the tile.
    lanes = np.empty(3 * TILE, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        open_pixels(live, num_rows, num_columns)
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        for pair in range(begin, end):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            lanes[:] = _ZERO
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    _, _, weight, _, after = blend_pixel(live[at], opacity, row_exponent - u * u)
                    live[at] = after
                    lanes[lane] += weight if weight >= least_weight else _ZERO
                    lanes[lane + _SQUARES] += weight * weight
                    lanes[lane + _PEAKS] = max(lanes[lane + _PEAKS], weight)
            weights = _ZERO
            squares = _ZERO
            peak = _ZERO
            for lane in range(LANES):
                weights += lanes[lane]
                squares += lanes[lane + _SQUARES]
                peak = max(peak, lanes[lane + _PEAKS])
            sums[pair, WEIGHT] = weights
            sums[pair, SQUARE] = squares
            sums[pair, PEAK] = peak
            if all_ended(pair, live):
                for rest in range(pair + 1, end):
                    for column in range(3):
                        sums[rest, column] = _ZERO
                break


@kernel
def _weigh_largest(
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    width: int,
    height: int,
    top_k: int,
    sums: NDArray[np.float32],
    first: int,
    last: int,
) -> None:
    """Do what `_weigh` does, with the `top_k` largest weights of each pixel in Σw.

    A kernel of its own: beside the choice of the largest, the loop over lanes of the other would
    take twice as long, and most runs need one of the two.
    """
    live = np.empty(PIXELS, np.float32)
    # By column of the tile: nothing, Σw², the largest w, and the weights of one row.
    lanes = np.empty(4 * TILE, np.float32)
    # The largest weights of each pixel so far, with their pairs; once there are K, the smallest is
    # the one to beat.
    best = np.empty((PIXELS, top_k), np.float32)
    owners = np.empty((PIXELS, top_k), np.int64)
    filled = np.zeros(PIXELS, np.int32)
    smallest = np.zeros(PIXELS, np.int32)
    bar = np.zeros(PIXELS, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        open_pixels(live, num_rows, num_columns)
        filled[:] = 0
        bar[:] = _ZERO
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        for pair in range(begin, end):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            lanes[:] = _ZERO
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                above_bar = 0
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    _, _, weight, _, after = blend_pixel(live[at], opacity, row_exponent - u * u)
                    live[at] = after
                    lanes[lane + _SQUARES] += weight * weight
                    lanes[lane + _PEAKS] = max(lanes[lane + _PEAKS], weight)
                    lanes[lane + _ROW] = weight
                    above_bar += int(weight > bar[at])
                if above_bar > 0:
                    for lane in range(LANES):
                        at = base + lane
                        weight = lanes[lane + _ROW]
                        if weight > bar[at]:
                            count = filled[at]
                            if count < top_k:
                                best[at, count] = weight
                                owners[at, count] = pair
                                filled[at] = count + 1
                                if count + 1 < top_k:
                                    continue
                            else:
                                best[at, smallest[at]] = weight
                                owners[at, smallest[at]] = pair
                            # Of equal weights the furthest yields, as in a stable sort.
                            low = 0
                            for k in range(1, top_k):
                                if best[at, k] < best[at, low] or (
                                    best[at, k] == best[at, low] and owners[at, k] > owners[at, low]
                                ):
                                    low = k
                            smallest[at] = low
                            bar[at] = best[at, low]
            squares = _ZERO
            peak = _ZERO
            for lane in range(LANES):
                squares += lanes[lane + _SQUARES]
                peak = max(peak, lanes[lane + _PEAKS])
            sums[pair, WEIGHT] = _ZERO
            sums[pair, SQUARE] = squares
            sums[pair, PEAK] = peak
            if all_ended(pair, live):
                for rest in range(pair + 1, end):
                    for column in range(3):
                        sums[rest, column] = _ZERO
                break
        for pixel in range(num_rows * TILE):
            for k in range(filled[pixel]):
                sums[owners[pixel, k], WEIGHT] += best[pixel, k]


def add_weights(
    lists: TileLists,
    footprints: Footprints,
    camera: Camera,
    top_k: int,
    threads: int,
    sums: NDArray[np.float64],
    *,
    least_weight: float = 0.0,
) -> None:
    """Add the weights of each footprint in the pixels of the tiles of `lists`.

    Parameters
    ----------
    lists : TileLists
        Of the footprints.
    footprints : Footprints
        M of them.
    camera : Camera
        The camera of the footprints.
    top_k : int
        The largest weights of a pixel that count in Σw (PRoGS, section 3.1); of equal weights the
        nearest count. At 0 all of at least `least_weight` do, in a third of the time.
    threads : int
        At least 1. The sums do not depend on it.
    sums : (M, 3) float64
        Columns `WEIGHT`, `SQUARE` and `PEAK`, over pixels; changed in place.
    least_weight : float
        Weights below this do not count in Σw; without effect where `top_k` is not 0.
    """
    pair_sums = np.empty((len(lists.members), 3), np.float32)
    by_size = 0 < top_k < MOST_WEIGHTS
    of_tiles = (
        lists.first,
        lists.starts,
        lists.members,
        footprints.ellipse,
        footprints.rows,
        camera.width,
        camera.height,
    )
    if by_size:
        lists.for_ranges(partial(_weigh_largest, *of_tiles, top_k, pair_sums), threads)
    else:
        least = np.float32(least_weight if top_k == 0 else 0.0)
        lists.for_ranges(partial(_weigh, *of_tiles, least, pair_sums), threads)
    gather(lists.members, pair_sums, sums, 1)
