"""Alpha blending of footprints in a 16x16 px tile, front to back: rules of every tile kernel.

A kernel blends one splat at a time, row by row of 16 pixels. The loop over the 16 pixels calls
`blend_pixel`, which has no branches, so that the compiler vectorises it together with the kernel's
own arithmetic.

Kernels that need the colour behind each splat walk a tile twice (Kerbl et al. 2023, appendix C).
`draw_and_reopen` draws the tile; the second walk, from the front again, subtracts each splat and
sums its result over the pixels in lanes, one per column of the tile (`store_lane_sums`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.frustum import ALPHA_MIN

from .jit import inner_kernel
from .projection import FLAT, NARROW, OPACITY, SHEAR, X, Y
from .tiles import TILE

F32 = NDArray[np.float32]

# 3DGS, renderCUDA: alpha is capped at this value. A splat that would bring the transmittance below
# TRANSMITTANCE_MIN ends the pixel and is not blended. Both compare in float32, as in 3DGS: two
# capped splats leave (1 - 0.99f)², which is below 1e-4f in float32 but not in float64.
ALPHA_MAX = np.float32(0.99)
TRANSMITTANCE_MIN = np.float32(1e-4)
_ALPHA_MIN = np.float32(ALPHA_MIN)

# exp(t) = p(t / 8)⁸ for t in [-6, 0], p interpolated at the Chebyshev nodes of [-0.75, 0]: relative
# error 4e-8 before rounding, under 2e-6 with it. Plain arithmetic, so that the compiler vectorises
# a whole tile row. exp(-6) < 1/255, so smaller exponents are cut anyway.
_EXPONENT_MIN = np.float32(-6.0)
_EXPONENT_STEP = np.float32(1.0 / 8.0)
_E0 = np.float32(0.9999999976614112)
_E1 = np.float32(0.9999996941214522)
_E2 = np.float32(0.49999344142033314)
_E3 = np.float32(0.1666136657480342)
_E4 = np.float32(0.04146113829788055)
_E5 = np.float32(0.007918287681908878)
_E6 = np.float32(0.0009587715253757255)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_HALF = np.float32(0.5)

PIXELS = TILE * TILE
# A tile's state is one array of several planes of PIXELS values each, so that the compiler knows
# that they do not overlap. The first plane is `live` of `blend_pixel`. Offsets are unsigned: checks
# for negative indices would prevent vectorisation.
LANES = np.uintp(TILE)
PAIRS_READ = 64
"""Number of pairs whose footprints `read_footprints` copies."""
RED, GREEN, BLUE, REST = (np.uintp(k * PIXELS) for k in range(1, 5))
PLANES = 5
"""Number of planes that `blend_tile` fills."""
OFF_RED, OFF_GREEN, OFF_BLUE = (np.uintp(k * PIXELS) for k in range(PLANES, PLANES + 3))
PLANES_COMPARED = 8
"""Number of planes that `blend_tile` and `compare_tile` fill."""


@inner_kernel
def falloff(exponent: np.float32) -> np.float32:
    """Return exp(exponent) for an exponent of at most 0; below -6, exp(-6)."""
    t = max(exponent, _EXPONENT_MIN) * _EXPONENT_STEP
    p = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
    p = p * p
    p = p * p
    return p * p


@inner_kernel
def blend_pixel(
    live: np.float32, opacity: np.float32, exponent: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.bool_, np.float32]:
    """Blend one splat into one pixel behind the splats before it.

    Parameters
    ----------
    live : float32
        Transmittance T before the splat; 0 for a pixel that has ended or lies outside the image.
    opacity : float32
        Opacity of the splat, 0 to 1.
    exponent : float32
        Exponent of the splat's Gaussian in this pixel, at most 0.

    Returns
    -------
    raw : float32
        opacity · exp(exponent).
    alpha : float32
        `raw` capped at `ALPHA_MAX`.
    weight : float32
        T · alpha if the splat is drawn, else 0.
    drawn : bool
        Whether alpha is at least 1/255 and enough transmittance is left to blend the splat.
    after : float32
        `live` for the next splat: 0 once this splat has ended the pixel.
    """
    raw = opacity * falloff(exponent)
    alpha = min(ALPHA_MAX, raw)
    left = live * (_ONE - alpha)
    touched = alpha >= _ALPHA_MIN
    goes_on = left >= TRANSMITTANCE_MIN
    drawn = touched & goes_on
    weight = live * alpha if drawn else _ZERO
    after = (left if goes_on else _ZERO) if touched else live
    return raw, alpha, weight, drawn, after


@inner_kernel
def bits(value: np.float32) -> np.uint32:
    """Return the bits of a float32. Those of numbers from 0 up have the order of the numbers.

    The compiler vectorises maxima and unions of 32-bit integers over the pixels of a row, but not
    maxima of floats, which it may not reorder. Callers put results into `np.uint32`, because numba
    makes them 64 bits wide.
    """
    return np.float32(value).view(np.uint32)


@inner_kernel
def find_open_rows(state: F32, open_rows: NDArray[np.uint32]) -> int:
    """Find the rows of a tile with a pixel that has not ended, and return their number.

    A kernel leaves out the other rows: blending further splats into them changes nothing.

    Parameters
    ----------
    state : (at least PIXELS,) float32
        State of the tile; its first plane is `live` of `blend_pixel`.
    open_rows : (TILE,) uint32
        Output, by row: 0 where all pixels have ended.
    """
    count = 0
    for y in range(TILE):
        base = np.uintp(y * TILE)
        live = np.uint32(0)
        for lane in range(LANES):
            live = np.uint32(live | bits(state[base + lane]))
        open_rows[y] = live
        count += int(live != 0)
    return count


@inner_kernel
def read_footprints(
    pair: int,
    end: int,
    members: NDArray[np.int32],
    ellipse: F32,
    rows: NDArray[np.int32],
    near_ellipse: F32,
    near_rows: NDArray[np.int32],
) -> None:
    """Copy the footprints of the next pairs of a tile to the processor's cache, at one time.

    The footprints of a tile are far apart in memory. The copies do not depend on each other, so
    that the processor waits for many of them together, instead of for each before it is blended.

    Parameters
    ----------
    pair, end : int
        First pair, and the end of the tile's pairs.
    members, ellipse, rows
        Arguments of `blend_tile`.
    near_ellipse, near_rows : (PAIRS_READ, 8) float32, (PAIRS_READ, 2) int32
        Output: rows of `ellipse` and `rows`, one for each pair.
    """
    for k in range(min(PAIRS_READ, end - pair)):
        i = members[pair + k]
        for column in range(8):
            near_ellipse[k, column] = ellipse[i, column]
        near_rows[k, 0] = rows[i, 0]
        near_rows[k, 1] = rows[i, 1]


@inner_kernel
def tile_area(tile: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Return a tile's first row and column, px, and its row and column counts in the image."""
    tiles_x = (width + TILE - 1) // TILE
    top = tile // tiles_x * TILE
    left = tile % tiles_x * TILE
    return top, left, min(TILE, height - top), min(TILE, width - left)


@inner_kernel
def footprint_in_tile(
    ellipse: F32, top: int, left: int
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return narrow, shear, flat, opacity and the centre's x and y of a `Footprints.ellipse` row.

    The centre is relative to the centre of the tile's first pixel, px.
    """
    centre_x = ellipse[X] - np.float32(left) - _HALF
    centre_y = ellipse[Y] - np.float32(top) - _HALF
    return ellipse[NARROW], ellipse[SHEAR], ellipse[FLAT], ellipse[OPACITY], centre_x, centre_y


@inner_kernel
def rows_in_tile(rows: NDArray[np.int32], top: int, num_rows: int) -> tuple[int, int]:
    """Return the half-open range of a tile's rows that a `Footprints.rows` row may cover."""
    return max(rows[0] - top, 0), min(rows[1] - top, num_rows)


@inner_kernel
def open_pixels(state: F32, num_rows: int, num_columns: int) -> None:
    """Set the first plane of a tile's state: transmittance 1 inside the image, 0 outside."""
    state[:PIXELS] = _ZERO
    for y in range(num_rows):
        for x in range(num_columns):
            state[y * TILE + x] = _ONE


@inner_kernel
def blend_tile(
    state: F32,
    begin: int,
    end: int,
    members: NDArray[np.int32],
    ellipse: F32,
    rows: NDArray[np.int32],
    colours: F32,
    present: NDArray[np.bool_],
    top: int,
    left: int,
    num_rows: int,
    num_columns: int,
    keep_rest: bool,
) -> int:
    """Blend the splats of one tile over black, nearest first.

    Parameters
    ----------
    state : (at least PLANES * PIXELS,) float32
        Output planes: `live` of `blend_pixel`; the picture at `RED`, `GREEN`, `BLUE`; optionally at
        `REST` the transmittance behind the last drawn splat (`live` is 0 once a pixel has ended).
        Further planes are set to 0.
    begin, end : int
        Range of the tile in `members`.
    members : (P,) int32
        Rows of the footprints, nearest first.
    ellipse, rows : (M, 8) float32, (M, 2) int32
        Arrays of `Footprints`.
    colours : (M, 3) float32
        Colours of the footprints in the scene's colour space.
    present : (M,) bool
        Mask of the footprints to draw.
    top, left, num_rows, num_columns : int
        Result of `tile_area`.
    keep_rest : bool
        Whether to fill the plane at `REST`. Only a background needs it, and it takes about a tenth
        of the kernel's time.

    Returns
    -------
    int
        End of the range of `members` that was blended, at most `end`; no pixel of the tile shows
        later splats.
    """
    open_rows = np.empty(TILE, np.uint32)
    state[:] = _ZERO
    open_pixels(state, num_rows, num_columns)
    left_open = find_open_rows(state, open_rows)
    if keep_rest:
        # A slice assignment would take numba seconds to compile (error messages about shapes).
        for pixel in range(PIXELS):
            state[np.uintp(pixel) + REST] = state[pixel]
    for pair in range(begin, end):
        i = members[pair]
        if not present[i]:
            continue
        narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(ellipse[i], top, left)
        red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
        first_row, last_row = rows_in_tile(rows[i], top, num_rows)
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
                _, _, weight, drawn, after = blend_pixel(state[at], opacity, row_exponent - u * u)
                state[at] = after
                open_row = np.uint32(open_row | bits(after))
                if keep_rest:
                    state[at + REST] = after if drawn else state[at + REST]
                state[at + RED] += weight * red
                state[at + GREEN] += weight * green
                state[at + BLUE] += weight * blue
            open_rows[y] = open_row
            left_open -= int(open_row == 0)
        if left_open == 0:
            return pair + 1
    return end


@inner_kernel
def draw_and_reopen(
    state: F32,
    sums: F32,
    columns: int,
    tile: int,
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: F32,
    rows: NDArray[np.int32],
    colours: F32,
    present: NDArray[np.bool_],
    width: int,
    height: int,
) -> tuple[int, int, int, int, int, int]:
    """Draw a tile over black, then reset its transmittances for a second pass from the front.

    Parameters
    ----------
    state : (at least PLANES * PIXELS,) float32
        Output planes: the picture from `blend_tile`, and the transmittances from `open_pixels`.
    sums : (P, columns) float32
        Sums by pair of a tile and a splat. Pairs behind the last blended splat are set to 0.
    columns : int
        Number of columns of `sums`; a constant, so that the compiler unrolls loops.
    tile : int
        Number of the tile in the image.
    lists_first, starts, members
        Attributes of `TileLists`.
    ellipse, rows, colours, present
        Arguments of `blend_tile`.
    width, height : int
        Image size, px.

    Returns
    -------
    top, left, num_rows, num_columns : int
        Result of `tile_area`.
    begin, stop : int
        Range of `members` to blend in the second pass.
    """
    top, left, num_rows, num_columns = tile_area(tile, width, height)
    begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
    stop = blend_tile(
        state,
        begin,
        end,
        members,
        ellipse,
        rows,
        colours,
        present,
        top,
        left,
        num_rows,
        num_columns,
        False,
    )
    for pair in range(stop, end):
        for column in range(columns):
            sums[pair, column] = _ZERO
    open_pixels(state, num_rows, num_columns)
    return top, left, num_rows, num_columns, begin, stop


@inner_kernel
def store_lane_sums(lanes: F32, sums: F32, columns: int, pair: int) -> None:
    """Add up the SIMD lanes of each column, and store the totals in the row `pair` of `sums`.

    Parameters
    ----------
    lanes : (columns * TILE,) float32
        Partial sums: one lane per pixel column of a tile, for each column of `sums`.
    sums : (P, columns) float32
        Output.
    columns : int
        Number of columns of `sums`.
    pair : int
        Row of `sums` to write.
    """
    for column in range(columns):
        row = np.uintp(column * TILE)
        total = _ZERO
        for lane in range(LANES):
            total += lanes[row + lane]
        sums[pair, column] = total


@inner_kernel
def compare_tile(
    state: F32,
    target: F32,
    top: int,
    left: int,
    num_rows: int,
    num_columns: int,
    error: float,
) -> float:
    """Add a drawn tile's squared error against a target, and keep the differences.

    Parameters
    ----------
    state : (PLANES_COMPARED * PIXELS,) float32
        State of a tile drawn by `blend_tile`. The planes at `OFF_RED`, `OFF_GREEN`, `OFF_BLUE`
        become target minus picture, and 0 outside the image.
    target : (H, W, 3) float32
        Target for the whole picture, in the scene's colour space.
    top, left, num_rows, num_columns : int
        Result of `tile_area`.
    error : float
        Sum of squared differences of earlier tiles.

    Returns
    -------
    float
        `error` plus the squared differences of this tile's pixels and channels.
    """
    for y in range(num_rows):
        for x in range(num_columns):
            pixel = y * TILE + x
            for channel in range(3):
                off = target[top + y, left + x, channel] - state[pixel + (1 + channel) * PIXELS]
                state[pixel + (PLANES + channel) * PIXELS] = off
                error += off * off
    return error
