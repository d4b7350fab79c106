"""What each splat would change in the error of a thinned picture, from one walk over its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.order.prefix_inflation import Inflation, inflate
from cogsplat.codec.splats import Splats

from .jit import kernel
from .projection import FLAT, NARROW, OPACITY, SHEAR, X, Y, project
from .rasteriser import ALPHA_MAX, TRANSMITTANCE_MIN, blend_tile, falloff
from .shading import footprint_colours
from .tiles import TILE, tile_lists

_ALPHA_MIN = np.float32(ALPHA_MIN)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_HALF = np.float32(0.5)
_PIXELS = TILE * TILE
# Unsigned, so that no index is checked for counting from the end: such checks stop vectorisation.
_TILE = np.uintp(TILE)
_RED, _GREEN, _BLUE, _OFF_RED, _OFF_GREEN, _OFF_BLUE = (np.uintp(k * _PIXELS) for k in range(1, 7))


@kernel
def _probe(
    lists_first: int,
    lists_last: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    target: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> float:
    """Fill the gain of every pair of a tile and a splat; return the sum of squared errors.

    Two walks over each tile. The first blends what is present, over black.
    The second goes front to back again and knows, at each splat, the transmittance before it and
    the colour still to come from behind: all that adding it (or taking it out) would change.
    """
    height, width = target.shape[0], target.shape[1]
    tiles_x = (width + TILE - 1) // TILE
    # Transmittance; colour of the picture, then what of it lies behind; error.
    state = np.empty(7 * _PIXELS, np.float32)
    lanes = np.empty(TILE, np.float32)
    error = 0.0
    for tile in range(lists_first, lists_last):
        top = tile // tiles_x * TILE
        left = tile % tiles_x * TILE
        num_rows = min(TILE, height - top)
        num_columns = min(TILE, width - left)
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
        )
        for y in range(num_rows):
            for x in range(num_columns):
                pixel = y * TILE + x
                state[pixel] = _ONE
                for channel in range(3):
                    off = (
                        target[top + y, left + x, channel] - state[pixel + (1 + channel) * _PIXELS]
                    )
                    state[pixel + (4 + channel) * _PIXELS] = off
                    error += off * off
        for pair in range(stop, end):
            sums[pair] = _ZERO
        for pair in range(begin, stop):
            i = members[pair]
            narrow = ellipse[i, NARROW]
            shear = ellipse[i, SHEAR]
            flat = ellipse[i, FLAT]
            opacity = ellipse[i, OPACITY]
            centre_x = ellipse[i, X] - np.float32(left) - _HALF
            centre_y = ellipse[i, Y] - np.float32(top) - _HALF
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            lanes[:] = _ZERO
            for y in range(max(rows[i, 0] - top, 0), min(rows[i, 1] - top, num_rows)):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                # Columns and rows beyond the image have transmittance 0, nothing behind and no
                # error: they add nothing.
                if present[i]:
                    for lane in range(_TILE):
                        at = base + lane
                        u = narrow * (np.float32(lane) - row_x)
                        alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                        live = state[at]
                        after = live * (_ONE - alpha)
                        touched = alpha >= _ALPHA_MIN
                        goes_on = after >= TRANSMITTANCE_MIN
                        drawn = touched & goes_on
                        weight = live * alpha if drawn else _ZERO
                        # Without it, what lies behind shines through undimmed.
                        odds = alpha / (_ONE - alpha) if drawn else _ZERO
                        state[at] = (after if goes_on else _ZERO) if touched else live
                        behind_red = state[at + _RED] - weight * red
                        behind_green = state[at + _GREEN] - weight * green
                        behind_blue = state[at + _BLUE] - weight * blue
                        state[at + _RED] = behind_red
                        state[at + _GREEN] = behind_green
                        state[at + _BLUE] = behind_blue
                        change_red = odds * behind_red - weight * red
                        change_green = odds * behind_green - weight * green
                        change_blue = odds * behind_blue - weight * blue
                        lanes[lane] += (
                            change_red * (_TWO * state[at + _OFF_RED] - change_red)
                            + change_green * (_TWO * state[at + _OFF_GREEN] - change_green)
                            + change_blue * (_TWO * state[at + _OFF_BLUE] - change_blue)
                        )
                else:
                    for lane in range(_TILE):
                        at = base + lane
                        u = narrow * (np.float32(lane) - row_x)
                        alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                        live = state[at]
                        # Where it would end the pixel it is not blended.
                        drawn = (alpha >= _ALPHA_MIN) & (live * (_ONE - alpha) >= TRANSMITTANCE_MIN)
                        alpha = alpha if drawn else _ZERO
                        change_red = alpha * (live * red - state[at + _RED])
                        change_green = alpha * (live * green - state[at + _GREEN])
                        change_blue = alpha * (live * blue - state[at + _BLUE])
                        lanes[lane] += (
                            change_red * (_TWO * state[at + _OFF_RED] - change_red)
                            + change_green * (_TWO * state[at + _OFF_GREEN] - change_green)
                            + change_blue * (_TWO * state[at + _OFF_BLUE] - change_blue)
                        )
            total = _ZERO
            for lane in range(_TILE):
                total += lanes[lane]
            sums[pair] = total
    return error


@kernel
def _gather(
    members: NDArray[np.int32], pair_sums: NDArray[np.float32], sums: NDArray[np.float64]
) -> None:
    """Add up the tiles of each footprint, in the order of the lists."""
    for pair in range(len(members)):
        sums[members[pair]] += pair_sums[pair]


@dataclass(frozen=True, eq=False)
class Pool:
    """Some splats of a scene as they are drawn in a probe, without a copy of their colours.

    Parameters
    ----------
    scene : Splats
        Anti-aliased where its `info` says so.
    rows : (n,) int32
        Ascending.
    shapes : Splats
        Those rows, without higher SH coefficients and extra attributes.
    """

    scene: Splats
    rows: NDArray[np.int32]
    shapes: Splats


def pool_of(scene: Splats, rows: NDArray[np.integer], by: Inflation | None = None) -> Pool:
    """Return some rows of a scene, ascending, inflated where asked for."""
    shapes = scene.without_extras().with_sh_degree(0).take(rows)
    return Pool(scene, rows.astype(np.int32), shapes if by is None else inflate(shapes, by))


def probe(
    pool: Pool,
    present: NDArray[np.bool_],
    camera: Camera,
    target: NDArray[np.float32],
    *,
    kernel_px: float,
    near_plane: float = NEAR,
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Measure what adding each absent splat, or taking out each present one, does for a picture.

    Parameters
    ----------
    pool : Pool
        n splats.
    present : (n,) bool
        Those in the picture.
    camera : Camera
        In the frame of the means.
    target : (H, W, 3) float32
        What the picture should be, over black.
    kernel_px : float
        Variance added to projected covariances, px².
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.

    Returns
    -------
    rows : (M,) int32
        Places in the pool of splats whose footprint reaches the image.
    gains : (M,) float64
        By how much the sum of squared errors over pixels and channels falls when this one splat
        alone changes sides. Exact but for pixels that it would bring to their end
        (`rasteriser.TRANSMITTANCE_MIN`) or keep from it.
    error : float
        The sum of squared errors as it is.
    """
    antialiased = pool.scene.info.antialiased
    footprints = project(
        pool.shapes, camera, kernel_px=kernel_px, antialiased=antialiased, near_plane=near_plane
    )
    colours = footprint_colours(pool.scene, pool.rows, camera, footprints)
    here = present[footprints.index]
    gains = np.zeros(len(footprints), np.float64)
    error = 0.0
    for lists in tile_lists(footprints, camera.width, camera.height):
        pair_gains = np.empty(len(lists.members), np.float32)
        error += _probe(
            lists.first,
            lists.last,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            colours,
            here,
            target,
            pair_gains,
        )
        _gather(lists.members, pair_gains, gains)
    return footprints.index, gains, error
