"""Blending weights of splats in one view, summed over its pixels by splat."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with

from .blending import (
    LANES,
    PAIRS_READ,
    PIXELS,
    bits,
    blend_pixel,
    find_open_rows,
    footprint_in_tile,
    open_pixels,
    read_footprints,
    rows_in_tile,
    tile_area,
)
from .jit import kernel
from .projection import Footprints
from .tiles import TILE, TileLists, add_pair_sums

_ZERO = np.float32(0.0)

WEIGHT, SQUARE, PEAK = range(3)
"""Columns of a view's sums over pixels, with weights w = T·alpha: Σw, Σw² and the largest w."""
# Offset of the second half of a buffer of two times TILE lanes.
_SECOND = np.uintp(TILE)

# Splats of a pixel at most: ln(1e-4) / ln(1 - 1/255) = 2344 splats of the smallest alpha.
MAX_WEIGHTS = 2346


@called_with(
    "int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], int64, int64, float32, "
    "float32[:, ::1], float32[:, ::1], boolean[::1], int64, int64"
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
    transmittances: NDArray[np.float32],
    sums: NDArray[np.float32],
    acts: NDArray[np.bool_],
    first: int,
    last: int,
) -> None:
    """Sum the weights of every pair of a tile and a splat, for the tiles `first` to `last`.

    Parameters
    ----------
    lists_first, starts, members
        `first`, `starts` and `members` of the `TileLists`.
    ellipse, rows
        Arrays of `Footprints`.
    width, height : int
        Image size, px.
    least_weight : float32
        Smaller weights are left out of Σw.
    transmittances : (T or 0, PIXELS) float32
        Transmittance of nearer splats by pixel of all tiles (`open_tiles`), changed in place;
        without rows, nothing is nearer.
    sums : (P, 3) float32
        Zeros; output: Σw, Σw² and the largest w of each pair.
    acts : (P,) bool
        False; output: whether the pair changes the transmittance of a pixel: one that ends a pixel
        does, without a weight.
    first, last : int
        Half-open range of tiles.
    """
    live = np.empty(PIXELS, np.float32)
    open_rows = np.empty(TILE, np.uint32)
    near_ellipse = np.empty((PAIRS_READ, 8), np.float32)
    near_rows = np.empty((PAIRS_READ, 2), np.int32)
    # Σw and Σw² by column of the tile.
    lanes = np.empty(2 * TILE, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        if len(transmittances):
            live[:] = transmittances[tile]
        else:
            open_pixels(live, num_rows, num_columns)
        left_open = find_open_rows(live, open_rows)
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        for pair in range(begin, end):
            if left_open == 0:
                break
            place = (pair - begin) % PAIRS_READ
            if place == 0:
                read_footprints(pair, end, members, ellipse, rows, near_ellipse, near_rows)
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                near_ellipse[place], top, left
            )
            lanes[:] = _ZERO
            peak = np.uint32(0)
            changed = np.uint32(0)
            first_row, last_row = rows_in_tile(near_rows[place], top, num_rows)
            for y in range(first_row, last_row):
                if open_rows[y] == 0:
                    continue
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                open_row = np.uint32(0)
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    before = live[at]
                    _, _, weight, _, after = blend_pixel(before, opacity, row_exponent - u * u)
                    live[at] = after
                    lanes[lane] += weight if weight >= least_weight else _ZERO
                    lanes[lane + _SECOND] += weight * weight
                    peak = np.uint32(max(peak, bits(weight)))
                    changed = np.uint32(changed | np.uint32(bits(before) ^ bits(after)))
                    open_row = np.uint32(open_row | bits(after))
                open_rows[y] = open_row
                left_open -= int(open_row == 0)
            weights = _ZERO
            squares = _ZERO
            if changed != 0:
                for lane in range(LANES):
                    weights += lanes[lane]
                    squares += lanes[lane + _SECOND]
            sums[pair, WEIGHT] = weights
            sums[pair, SQUARE] = squares
            sums[pair, PEAK] = np.uint32(peak).view(np.float32)
            acts[pair] = changed != 0
        if len(transmittances):
            transmittances[tile] = live


@called_with("int64, int64, float32[:, ::1]")
@kernel
def open_tiles(width: int, height: int, transmittances: NDArray[np.float32]) -> None:
    """Open all pixels of an image: light of 1 inside it, of 0 beyond its edges.

    Parameters
    ----------
    width, height : int
        Image size, px.
    transmittances : (T, PIXELS) float32
        Output: what is left of the light of each pixel of each tile, row by row.
    """
    for tile in range(len(transmittances)):
        _, _, num_rows, num_columns = tile_area(tile, width, height)
        open_pixels(transmittances[tile], num_rows, num_columns)


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
    acts: NDArray[np.bool_],
    first: int,
    last: int,
) -> None:
    """Sum the blending weights of each pair; Σw counts only each pixel's `top_k` largest weights.

    Σw² and the largest weight include all splats, as in `_weigh`. The kernels are separate,
    because selecting the largest weights would double the time of the loop over lanes of `_weigh`.
    """
    live = np.empty(PIXELS, np.float32)
    open_rows = np.empty(TILE, np.uint32)
    # Σw² and one row of weights, by column of the tile.
    lanes = np.empty(2 * TILE, np.float32)
    # The K largest weights of each pixel so far, their pairs, and the threshold for the next one.
    best = np.empty((PIXELS, top_k), np.float32)
    owners = np.empty((PIXELS, top_k), np.int64)
    filled = np.zeros(PIXELS, np.int32)
    smallest = np.zeros(PIXELS, np.int32)
    bar = np.zeros(PIXELS, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        open_pixels(live, num_rows, num_columns)
        left_open = find_open_rows(live, open_rows)
        filled[:] = 0
        bar[:] = _ZERO
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        for pair in range(begin, end):
            if left_open == 0:
                break
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            lanes[:] = _ZERO
            peak = np.uint32(0)
            changed = np.uint32(0)
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                if open_rows[y] == 0:
                    continue
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                open_row = np.uint32(0)
                above_bar = 0
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    before = live[at]
                    _, _, weight, _, after = blend_pixel(before, opacity, row_exponent - u * u)
                    live[at] = after
                    lanes[lane] += weight * weight
                    lanes[lane + _SECOND] = weight
                    peak = np.uint32(max(peak, bits(weight)))
                    changed = np.uint32(changed | np.uint32(bits(before) ^ bits(after)))
                    open_row = np.uint32(open_row | bits(after))
                    above_bar += int(weight > bar[at])
                open_rows[y] = open_row
                left_open -= int(open_row == 0)
                if above_bar > 0:
                    for lane in range(LANES):
                        at = base + lane
                        weight = lanes[lane + _SECOND]
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
                            # Among equal weights the furthest is replaced, as in a stable sort.
                            low = 0
                            for k in range(1, top_k):
                                if best[at, k] < best[at, low] or (
                                    best[at, k] == best[at, low] and owners[at, k] > owners[at, low]
                                ):
                                    low = k
                            smallest[at] = low
                            bar[at] = best[at, low]
            squares = _ZERO
            for lane in range(LANES):
                squares += lanes[lane]
            sums[pair, WEIGHT] = _ZERO
            sums[pair, SQUARE] = squares
            sums[pair, PEAK] = np.uint32(peak).view(np.float32)
            acts[pair] = changed != 0
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
    transmittances: NDArray[np.float32] | None = None,
) -> NDArray[np.bool_]:
    """Add the weights of each footprint in the pixels of the tiles of `lists`.

    Parameters
    ----------
    lists : TileLists
        Tile lists of the footprints.
    footprints : Footprints
        Footprints of M splats.
    camera : Camera
        Camera of the footprints.
    top_k : int
        Number of a pixel's largest weights that count in Σw (PRoGS, section 3.1); ties go to the
        nearest. 0 counts all weights of at least `least_weight`, in a third of the time.
    threads : int
        Number of threads, at least 1. The sums do not depend on it.
    sums : (M, 3) float64
        Columns `WEIGHT`, `SQUARE` and `PEAK`, changed in place.
    least_weight : float
        Minimum of the weights that count in Σw; ignored unless `top_k` is 0.
    transmittances : (T, 256) float32, optional
        Transmittance of nearer splats by pixel (`open_tiles`), changed in place; not with
        `top_k`. By default nothing is nearer.

    Returns
    -------
    (P,) bool
        Mask of the pairs that change a pixel. Without the others, pictures are the same.
    """
    # The kernels leave out the pairs behind the one that ends a tile: their sums are 0.
    pair_sums = np.zeros((len(lists.members), 3), np.float32)
    acts = np.zeros(len(lists.members), np.bool_)
    by_size = 0 < top_k < MAX_WEIGHTS
    if transmittances is None:
        transmittances = np.empty((0, PIXELS), np.float32)
    elif by_size:
        raise ValueError(f"top_k {top_k} behind nearer splats, expected 0")
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
        lists.for_ranges(partial(_weigh_largest, *of_tiles, top_k, pair_sums, acts), threads)
    else:
        least = np.float32(least_weight if top_k == 0 else 0.0)
        lists.for_ranges(
            partial(_weigh, *of_tiles, least, transmittances, pair_sums, acts), threads
        )
    add_pair_sums(lists.members, pair_sums, sums, 1)
    return acts
