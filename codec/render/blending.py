"""Alpha blending of footprints in a 16x16 px tile, front to back: the rules that every walk shares.

A walk takes one splat at a time through a tile, a row of 16 pixels after the other. The loop over
the 16 pixels calls `blend_pixel`, which has no branches, so that the compiler turns it into vector
instructions together with what the walk adds to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.frustum import ALPHA_MIN

from .jit import inner_kernel
from .projection import FLAT, NARROW, OPACITY, SHEAR, X, Y
from .tiles import TILE

F32 = NDArray[np.float32]

# 3DGS, renderCUDA: alpha is capped here, and a splat that would bring the transmittance below
# TRANSMITTANCE_MIN ends the pixel unblended. Both compared in float32, as there: two capped splats
# leave (1 - 0.99f)², which is below 1e-4f in float32 and would not be in float64.
ALPHA_MAX = np.float32(0.99)
TRANSMITTANCE_MIN = np.float32(1e-4)
_ALPHA_MIN = np.float32(ALPHA_MIN)

# exp(t) = p(t / 8)⁸ for t in [-6, 0], p interpolated at the Chebyshev nodes of [-0.75, 0]: relative
# error 4e-8 before rounding, under 2e-6 with it. Plain arithmetic, so that the compiler does a
# whole tile row at once. exp(-6) < 1/255, so everything beyond is cut anyway.
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
# A tile's state is one array of several planes of PIXELS values each, so that the compiler sees
# that they do not overlap. The first holds what `blend_pixel` takes as `live`. Offsets are
# unsigned: checks for an index that counts from the end would stop vectorisation.
LANES = np.uintp(TILE)
# Looking through the pixels of a tile takes about as long as blending two splats.
_PAIRS_PER_CHECK = 16
RED, GREEN, BLUE, REST = (np.uintp(k * PIXELS) for k in range(1, 5))
PLANES = 5
"""Planes that `blend_tile` fills."""
OFF_RED, OFF_GREEN, OFF_BLUE = (np.uintp(k * PIXELS) for k in range(PLANES, PLANES + 3))
PLANES_COMPARED = 8
"""The same and those that `compare_tile` fills."""


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
    """Blend one splat into one pixel behind what is already there.

    Parameters
    ----------
    live : float32
        Transmittance T before the splat; 0 for a pixel that has ended or lies outside the image.
    opacity : float32
        Of the splat, 0 to 1.
    exponent : float32
        Of its Gaussian in this pixel, at most 0.

    Returns
    -------
    raw, alpha : float32
        opacity · exp(exponent), and the same capped at `ALPHA_MAX`.
    weight : float32
        T · alpha where the splat is drawn, else 0.
    drawn : bool
        Whether it reaches alpha 1/255 and leaves enough transmittance to be blended.
    after : float32
        `live` for the next splat: 0 once this one has ended the pixel.
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
def all_ended(pair: int, state: F32) -> bool:
    """Return whether no pixel of a tile is live any more; looked up after some of the pairs only.

    Parameters
    ----------
    pair : int
        Number of the pair of a tile and a splat that was blended last. A walk that goes on behind
        the last live pixel changes nothing: counting the pixels that each splat ends would take
        almost as long as blending it.
    state : (at least PIXELS,) float32
        Its first plane holds what `blend_pixel` takes as `live`.
    """
    if pair % _PAIRS_PER_CHECK != 0:
        return False
    # Of integers: the compiler may not reorder a sum of floats, and so would not vectorise it.
    live = state.view(np.uint32)
    any_live = np.uint32(0)
    for pixel in range(PIXELS):
        any_live |= live[np.uintp(pixel)]
    return bool(any_live == 0)


@inner_kernel
def tile_area(tile: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Return the first row and column of a tile, px, and how many of each lie in the image."""
    tiles_x = (width + TILE - 1) // TILE
    top = tile // tiles_x * TILE
    left = tile % tiles_x * TILE
    return top, left, min(TILE, height - top), min(TILE, width - left)


@inner_kernel
def footprint_in_tile(
    ellipse: F32, top: int, left: int
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return narrow, shear, flat and opacity of one of `Footprints.ellipse`, then its centre.

    The centre's x and y are px from the centre of the tile's first pixel.
    """
    centre_x = ellipse[X] - np.float32(left) - _HALF
    centre_y = ellipse[Y] - np.float32(top) - _HALF
    return ellipse[NARROW], ellipse[SHEAR], ellipse[FLAT], ellipse[OPACITY], centre_x, centre_y


@inner_kernel
def rows_in_tile(rows: NDArray[np.int32], top: int, num_rows: int) -> tuple[int, int]:
    """Return the half-open rows of a tile that one of `Footprints.rows` may cover."""
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
        Filled plane by plane: `blend_pixel`'s live, then at the offsets `RED`, `GREEN`, `BLUE` the
        picture, at `REST`, where it is kept, the transmittance behind the last splat drawn (live is
        0 where a pixel has ended). Planes beyond these are set to 0.
    begin, end : int
        The tile's run in `members`.
    members : (P,) int32
        Rows of the footprints, nearest first.
    ellipse, rows : (M, 8) float32, (M, 2) int32
        Of `Footprints`.
    colours : (M, 3) float32
        Of the footprints, in the scene's colour space.
    present : (M,) bool
        Which footprints are drawn.
    top, left, num_rows, num_columns : int
        From `tile_area`.
    keep_rest : bool
        Whether the plane at `REST` is filled. Only a background needs it, and filling it takes
        about a tenth of a walk's time.

    Returns
    -------
    int
        Where the walk ended, at most `end`: no pixel of the tile shows the splats from here on in
        `members`.
    """
    state[:] = _ZERO
    open_pixels(state, num_rows, num_columns)
    if keep_rest:
        # Not a slice: numba compiles its error messages about shapes for seconds.
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
            dy = np.float32(y) - centre_y
            row_x = centre_x + shear * dy
            row_exponent = -flat * dy * dy
            base = np.uintp(y * TILE)
            for lane in range(LANES):
                at = base + lane
                u = narrow * (np.float32(lane) - row_x)
                _, _, weight, drawn, after = blend_pixel(state[at], opacity, row_exponent - u * u)
                state[at] = after
                if keep_rest:
                    state[at + REST] = after if drawn else state[at + REST]
                state[at + RED] += weight * red
                state[at + GREEN] += weight * green
                state[at + BLUE] += weight * blue
        if all_ended(pair, state):
            return pair + 1
    return end


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
    """Compare a tile that `blend_tile` has drawn with a picture, and reopen it for a second walk.

    Parameters
    ----------
    state : (PLANES_COMPARED * PIXELS,) float32
        The planes at `OFF_RED`, `OFF_GREEN`, `OFF_BLUE` become target less picture, 0 outside the
        image; the first becomes that of `open_pixels`.
    target : (H, W, 3) float32
        The whole picture, in the scene's colour space.
    top, left, num_rows, num_columns : int
        From `tile_area`.
    error : float
        Sum of squared differences so far.

    Returns
    -------
    float
        The same with those of this tile's pixels and channels.
    """
    open_pixels(state, num_rows, num_columns)
    for y in range(num_rows):
        for x in range(num_columns):
            pixel = y * TILE + x
            for channel in range(3):
                off = target[top + y, left + x, channel] - state[pixel + (1 + channel) * PIXELS]
                state[pixel + (PLANES + channel) * PIXELS] = off
                error += off * off
    return error
