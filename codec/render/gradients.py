"""How the error of a picture changes with the opacity and size of every splat in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.splats import Splats

from .jit import kernel
from .projection import FLAT, NARROW, OPACITY, SHEAR, Footprints, X, Y, project
from .rasteriser import ALPHA_MAX, TRANSMITTANCE_MIN, blend_tile, falloff
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

# Sums of a footprint: by ln alpha, by ln scale.
_SUMS = 2
_BY_ALPHA, _BY_SCALE = (np.uintp(k * TILE) for k in range(_SUMS))


@kernel
def _differentiate(
    lists_first: int,
    lists_last: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    target: NDArray[np.float32],
    kernel_px: np.float32,
    sums: NDArray[np.float32],
) -> float:
    """Fill the derivatives of every pair of a tile and a splat; return the sum of squared errors.

    Two walks over each tile, as in `gain_probe`: the second knows at each splat the colour behind.
    """
    height, width = target.shape[0], target.shape[1]
    tiles_x = (width + TILE - 1) // TILE
    state = np.empty(7 * _PIXELS, np.float32)
    lanes = np.empty(_SUMS * TILE, np.float32)
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
                        state[pixel + (1 + channel) * _PIXELS] - target[top + y, left + x, channel]
                    )
                    state[pixel + (4 + channel) * _PIXELS] = off
                    error += off * off
        for pair in range(stop, end):
            for k in range(_SUMS):
                sums[pair, k] = _ZERO
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
                for lane in range(_TILE):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    raw = opacity * falloff(row_exponent - u * u)
                    alpha = min(ALPHA_MAX, raw)
                    live = state[at]
                    after = live * (_ONE - alpha)
                    touched = alpha >= _ALPHA_MIN
                    goes_on = after >= TRANSMITTANCE_MIN
                    drawn = touched & goes_on
                    weight = live * alpha if drawn else _ZERO
                    odds = alpha / (_ONE - alpha)
                    state[at] = (after if goes_on else _ZERO) if touched else live
                    behind_red = state[at + _RED] - weight * red
                    behind_green = state[at + _GREEN] - weight * green
                    behind_blue = state[at + _BLUE] - weight * blue
                    state[at + _RED] = behind_red
                    state[at + _GREEN] = behind_green
                    state[at + _BLUE] = behind_blue
                    off_red = _TWO * state[at + _OFF_RED]
                    off_green = _TWO * state[at + _OFF_GREEN]
                    off_blue = _TWO * state[at + _OFF_BLUE]
                    slope = (
                        off_red * (weight * red - behind_red * odds)
                        + off_green * (weight * green - behind_green * odds)
                        + off_blue * (weight * blue - behind_blue * odds)
                    )
                    # A capped alpha does not move.
                    moves = drawn & (raw <= ALPHA_MAX)
                    slope = slope if moves else _ZERO
                    # The exponent's gradient in the image, px^-1: the widening of the covariance
                    # by the kernel does not scale with the splat.
                    along = _TWO * narrow * u
                    across = _TWO * flat * dy - shear * along
                    wider = _TWO * (u * u - row_exponent)
                    wider -= kernel_px * (along * along + across * across)
                    wider = wider if moves else _ZERO
                    lanes[lane + _BY_ALPHA] += slope
                    lanes[lane + _BY_SCALE] += slope * wider
            for k in range(_SUMS):
                row = np.uintp(k * TILE)
                total = _ZERO
                for lane in range(_TILE):
                    total += lanes[row + lane]
                sums[pair, k] = total
    return error


@kernel
def _gather(
    members: NDArray[np.int32], pair_sums: NDArray[np.float32], sums: NDArray[np.float64]
) -> None:
    """Add up the tiles of each footprint, in the order of the lists."""
    for pair in range(len(members)):
        i = members[pair]
        for k in range(_SUMS):
            sums[i, k] += pair_sums[pair, k]


@dataclass(frozen=True, eq=False)
class Gradient:
    """Derivatives of the sum of squared errors of one picture, over pixels and channels.

    Parameters
    ----------
    rows : (M,) int32
        Splats whose footprint reaches the image.
    opacities : (M,) float64
        By the logit.
    scales : (M,) float64
        By a number added to all three log scales.
    error : float
        The sum of squared errors.
    """

    rows: NDArray[np.int32]
    opacities: NDArray[np.float64]
    scales: NDArray[np.float64]
    error: float


def _opacity_by_scale(footprints: Footprints, kernel_px: float) -> NDArray[np.float64]:
    """Return the derivative of the anti-aliased opacities' logarithm by the log scale: (M,)."""
    ellipse = footprints.ellipse.astype(np.float64)
    var_y = 0.5 / ellipse[:, FLAT]
    det = 0.5 * var_y / ellipse[:, NARROW] ** 2
    cov = ellipse[:, SHEAR] * var_y
    bare_x = (det + cov * cov) / var_y - kernel_px
    bare_y = var_y - kernel_px
    bare = bare_x * bare_y - cov * cov
    # det = s⁴ bare + s² kernel trace + kernel², s the factor on the scales; bare itself goes by s⁴.
    slope: NDArray[np.float64] = 2.0 - (2.0 * bare + kernel_px * (bare_x + bare_y)) / det
    return slope


def gradient(
    splats: Splats,
    colours: NDArray[np.float32],
    camera: Camera,
    target: NDArray[np.float32],
    *,
    kernel_px: float,
    near_plane: float = NEAR,
) -> Gradient:
    """Differentiate the error of a picture by what compensation may change.

    Parameters
    ----------
    splats : Splats
        N of them, in the picture. Anti-aliased where ``splats.info`` says so; their SH coefficients
        do not count.
    colours : (n, 3) float32
        What they show to the camera; of n at least N rows the first N count.
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
    Gradient
    """
    antialiased = splats.info.antialiased
    footprints = project(
        splats, camera, kernel_px=kernel_px, antialiased=antialiased, near_plane=near_plane
    )
    shown = colours[footprints.index]
    everything = np.ones(len(footprints), np.bool_)
    sums = np.zeros((len(footprints), _SUMS), np.float64)
    error = 0.0
    for lists in tile_lists(footprints, camera.width, camera.height):
        pair_sums = np.empty((len(lists.members), _SUMS), np.float32)
        error += _differentiate(
            lists.first,
            lists.last,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            shown,
            everything,
            target,
            np.float32(kernel_px),
            pair_sums,
        )
        _gather(lists.members, pair_sums, sums)
    logits = splats.opacities[footprints.index].astype(np.float64)
    by_scale = sums[:, 1]
    if antialiased:
        by_scale = by_scale + sums[:, 0] * _opacity_by_scale(footprints, kernel_px)
    return Gradient(
        footprints.index,
        sums[:, 0] * np.exp(-np.logaddexp(0.0, logits)),
        by_scale,
        error,
    )
