"""Per-tile kernels: the forward pass, and the per-pixel half of the backward pass.

Blending is that of `codec.render.blending`. Both passes blend a tile front to back. The backward
pass subtracts each splat from the finished picture. The remainder is the colour behind the splat,
on which the gradient w.r.t. its alpha depends (Kerbl et al. 2023, appendix C).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.blending import (
    ALPHA_MAX,
    BLUE,
    GREEN,
    LANES,
    PIXELS,
    PLANES,
    PLANES_COMPARED,
    RED,
    REST,
    blend_pixel,
    blend_tile,
    footprint_in_tile,
    open_pixels,
    rows_in_tile,
    store_lane_sums,
    tile_area,
)
from cogsplat.codec.render.jit import inner_kernel, kernel
from cogsplat.codec.render.tiles import TILE

F32 = NDArray[np.float32]

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)

BY_RED, BY_GREEN, BY_BLUE, G, GU, GV, GUU, GUV, GVV, DELETED = range(10)
SUMS: Final = 10
"""Number of columns of the output of `differentiate_tiles`: gradients w.r.t. the colour, moments of
g, and the deletion error."""

# Offset of each column in the lanes of a tile row.
_L_RED, _L_GREEN, _L_BLUE, _L_G, _L_GU, _L_GV, _L_GUU, _L_GUV, _L_GVV, _L_DELETED = (
    np.uintp(k * TILE) for k in range(SUMS)
)

# Planes of a tile's state with the gradient w.r.t. the picture. Other kernels keep a target there.
_D_RED, _D_GREEN, _D_BLUE = (np.uintp(k * PIXELS) for k in range(PLANES, PLANES_COMPARED))


@called_with(
    "int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "boolean[::1], float32[::1], float32[:, :, ::1], int64[::1], int64, int64"
)
@kernel
def draw_tiles(
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: F32,
    rows: NDArray[np.int32],
    colours: F32,
    present: NDArray[np.bool_],
    background: F32,
    image: F32,
    stops: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Render the tiles from `first` to `last` of an image, and record where blending stopped.

    Parameters
    ----------
    lists_first, starts, members
        `first`, `starts` and `members` of the `TileLists`.
    ellipse, rows : (M, 8) float32, (M, 2) int32
        Arrays of `Footprints`.
    colours : (M, 3) float32
        Colours of the footprints, in the scene's colour space.
    present : (M,) bool
        Mask of the footprints to draw.
    background : (3,) float32
        Background colour, in the scene's colour space.
    image : (H, W, 3) float32
        Output: the picture, in the area of these tiles.
    stops : (tiles of the lists,) int64
        Output, by tile: position in `members` of the first footprint that is not blended because
        all pixels of the tile are opaque; the end of the list if there is none.
    first, last : int
        Half-open range of tiles, in row-major order.
    """
    height, width = image.shape[0], image.shape[1]
    state = np.empty(PLANES * PIXELS, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        stops[tile - lists_first] = blend_tile(
            state,
            starts[tile - lists_first],
            starts[tile - lists_first + 1],
            members,
            ellipse,
            rows,
            colours,
            present,
            top,
            left,
            num_rows,
            num_columns,
            True,
        )
        for y in range(num_rows):
            for x in range(num_columns):
                pixel = np.uintp(y * TILE + x)
                rest = state[pixel + REST]
                image[top + y, left + x, 0] = state[pixel + RED] + rest * background[0]
                image[top + y, left + x, 1] = state[pixel + GREEN] + rest * background[1]
                image[top + y, left + x, 2] = state[pixel + BLUE] + rest * background[2]


@inner_kernel
def _load_tile(
    state: F32, picture: F32, plane: int, top: int, left: int, rows: int, cols: int
) -> None:
    """Copy a tile of an (H, W, 3) picture into three planes of the tile's state.

    Parameters
    ----------
    state : float32
        Per-pixel planes of `PIXELS` values each.
    picture : (H, W, 3) float32
        Picture to copy from.
    plane : int
        Number of the first of the three planes.
    top, left, rows, cols : int
        Area of the tile inside the picture; other pixels become 0.
    """
    for channel in range(3):
        base = (plane + channel) * PIXELS
        for pixel in range(PIXELS):
            state[base + pixel] = _ZERO
        for y in range(rows):
            for x in range(cols):
                state[base + y * TILE + x] = picture[top + y, left + x, channel]


@called_with(
    "int64, int64[::1], int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "float32[:, :, ::1], float32[:, :, ::1], float32[:, ::1], int64, int64"
)
@kernel
def differentiate_tiles(
    lists_first: int,
    starts: NDArray[np.int64],
    stops: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: F32,
    rows: NDArray[np.int32],
    colours: F32,
    image: F32,
    by_image: F32,
    sums: F32,
    first: int,
    last: int,
) -> None:
    """Sum the gradients of a loss over the pixels of each pair of a tile and a footprint.

    (u, v) is the offset from the centre, scaled so that alpha is ``opacity · exp(-u² - v²)``. With
    g the gradient of the loss w.r.t. ln alpha in one pixel, moments are Σ over pixels of g·uᵖ·v^q.

    Parameters
    ----------
    lists_first, starts, members, ellipse, rows, colours
        Arguments of `draw_tiles`.
    stops : (tiles of the lists,) int64
        Output of `draw_tiles`.
    image : (H, W, 3) float32
        Output of `draw_tiles`, background included.
    by_image : (H, W, 3) float32
        Gradient of the loss w.r.t. the picture.
    sums : (P, SUMS) float32
        Output, by pair of a tile and a footprint: gradients w.r.t. the three colour channels, then
        the moments 1, u, v, uu, uv and vv, then the deletion error
        (`deletion_errors.deletion_errors`).
    first, last : int
        Half-open range of tiles, in row-major order.
    """
    height, width = image.shape[0], image.shape[1]
    state = np.empty(PLANES_COMPARED * PIXELS, np.float32)
    lanes = np.empty(SUMS * TILE, np.float32)
    for tile in range(first, last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        stop = stops[tile - lists_first]
        open_pixels(state, num_rows, num_columns)
        _load_tile(state, image, 1, top, left, num_rows, num_columns)
        _load_tile(state, by_image, PLANES, top, left, num_rows, num_columns)
        for pair in range(stop, end):
            for k in range(SUMS):
                sums[pair, k] = _ZERO
        for pair in range(begin, stop):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            root_flat = np.float32(math.sqrt(flat))
            lanes[:] = _ZERO
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                v = root_flat * dy
                row_exponent = -v * v
                base = np.uintp(y * TILE)
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    raw, alpha, weight, drawn, after = blend_pixel(
                        state[at], opacity, row_exponent - u * u
                    )
                    odds = alpha / (_ONE - alpha)
                    state[at] = after
                    shown_red = weight * red
                    shown_green = weight * green
                    shown_blue = weight * blue
                    behind_red = state[at + RED] - shown_red
                    behind_green = state[at + GREEN] - shown_green
                    behind_blue = state[at + BLUE] - shown_blue
                    state[at + RED] = behind_red
                    state[at + GREEN] = behind_green
                    state[at + BLUE] = behind_blue
                    by_red = state[at + _D_RED]
                    by_green = state[at + _D_GREEN]
                    by_blue = state[at + _D_BLUE]
                    # Colour lost by deletion; equals the derivative of the colour w.r.t. ln alpha.
                    lost_red = shown_red - behind_red * odds
                    lost_green = shown_green - behind_green * odds
                    lost_blue = shown_blue - behind_blue * odds
                    g = by_red * lost_red + by_green * lost_green + by_blue * lost_blue
                    lost = lost_red * lost_red + lost_green * lost_green + lost_blue * lost_blue
                    # A capped alpha has derivative 0.
                    g = g if drawn & (raw <= ALPHA_MAX) else _ZERO
                    # Where nothing is drawn, u may be too large for its square.
                    u = u if drawn else _ZERO
                    gu = g * u
                    lanes[lane + _L_RED] += weight * by_red
                    lanes[lane + _L_GREEN] += weight * by_green
                    lanes[lane + _L_BLUE] += weight * by_blue
                    lanes[lane + _L_G] += g
                    lanes[lane + _L_GU] += gu
                    lanes[lane + _L_GV] += g * v
                    lanes[lane + _L_GUU] += gu * u
                    lanes[lane + _L_GUV] += gu * v
                    lanes[lane + _L_GVV] += g * v * v
                    lanes[lane + _L_DELETED] += lost
            store_lane_sums(lanes, sums, SUMS, pair)
