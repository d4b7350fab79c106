"""Gradients of a picture's squared error by the opacity and the size of every splat in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.splats import Splats

from .blending import (
    ALPHA_MAX,
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
from .projection import FILTER, FLAT, NARROW, SHEAR, THICKNESS, Footprints, project
from .tiles import TILE, add_pair_sums, tile_lists

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)

# Least determinant divided by, px⁴: that of a flat splat without thickness is 0.
_TINY = 1e-30

# Number of derivatives (w.r.t. ln alpha, ln scale), and their offsets in the lanes of a tile.
_SUMS = 2
_BY_ALPHA, _BY_SCALE = (np.uintp(k * TILE) for k in range(_SUMS))


@called_with(
    "int64, int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "boolean[::1], float32[:, :, ::1], float32[:, ::1], float32[:, ::1]"
)
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
    added: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> float:
    """Differentiate a squared error w.r.t. ln alpha, and ln scale at a fixed opacity.

    Each tile is blended twice, because the derivative w.r.t. a splat's alpha depends on the colour
    behind the splat (Kerbl et al. 2023, appendix C).

    Parameters
    ----------
    lists_first, lists_last, starts, members
        Attributes of `TileLists`.
    ellipse, rows, colours, present
        Arguments of `blend_tile`.
    target : (H, W, 3) float32
        Target picture over black, in the scene's colour space.
    added : (M, 2) float32
        `Footprints.added`.
    sums : (P, 2) float32
        Output: both derivatives, summed over the pixels of each pair of a tile and a splat.

    Returns
    -------
    float
        Sum of squared errors over pixels and channels.
    """
    height, width = target.shape[0], target.shape[1]
    state = np.empty(PLANES_COMPARED * PIXELS, np.float32)
    lanes = np.empty(_SUMS * TILE, np.float32)
    error = 0.0
    for tile in range(lists_first, lists_last):
        top, left, num_rows, num_columns, begin, stop = draw_and_reopen(
            state,
            sums,
            _SUMS,
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
        error = compare_tile(state, target, top, left, num_rows, num_columns, error)
        for pair in range(begin, stop):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            widening = added[i, THICKNESS] + added[i, FILTER]
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
                    raw, alpha, weight, drawn, after = blend_pixel(
                        state[at], opacity, row_exponent - u * u
                    )
                    odds = alpha / (_ONE - alpha)
                    state[at] = after
                    behind_red = state[at + RED] - weight * red
                    behind_green = state[at + GREEN] - weight * green
                    behind_blue = state[at + BLUE] - weight * blue
                    state[at + RED] = behind_red
                    state[at + GREEN] = behind_green
                    state[at + BLUE] = behind_blue
                    off_red = -_TWO * state[at + OFF_RED]
                    off_green = -_TWO * state[at + OFF_GREEN]
                    off_blue = -_TWO * state[at + OFF_BLUE]
                    slope = (
                        off_red * (weight * red - behind_red * odds)
                        + off_green * (weight * green - behind_green * odds)
                        + off_blue * (weight * blue - behind_blue * odds)
                    )
                    # A capped alpha has derivative 0.
                    moves = drawn & (raw <= ALPHA_MAX)
                    slope = slope if moves else _ZERO
                    # Gradient of the exponent in the image, 1/px. It corrects for the part of the
                    # projected covariance that does not scale with the splat.
                    along = _TWO * narrow * u
                    across = _TWO * flat * dy - shear * along
                    wider = _TWO * (u * u - row_exponent)
                    wider -= widening * (along * along + across * across)
                    wider = wider if moves else _ZERO
                    lanes[lane + _BY_ALPHA] += slope
                    lanes[lane + _BY_SCALE] += slope * wider
            store_lane_sums(lanes, sums, _SUMS, pair)
    return error


@dataclass(frozen=True, eq=False)
class Gradient:
    """Derivatives of the sum of squared errors of one picture, over pixels and channels.

    Parameters
    ----------
    rows : (M,) int32
        Rows of the scene whose footprint reaches the image, nearest first.
    opacities : (M,) float64
        Derivative w.r.t. the opacity logit.
    scales : (M,) float64
        Derivative w.r.t. a common offset of all three log scales.
    error : float
        Sum of squared errors.
    """

    rows: NDArray[np.int32]
    opacities: NDArray[np.float64]
    scales: NDArray[np.float64]
    error: float


def _opacity_by_scale(footprints: Footprints) -> NDArray[np.float64]:
    """Return the derivative of ln opacity, rescaled for the filter, w.r.t. the log scale, (M,)."""
    ellipse = footprints.ellipse.astype(np.float64)
    thickness, blur = footprints.added.astype(np.float64).T
    var_y = 0.5 / ellipse[:, FLAT]
    det = 0.5 * var_y / ellipse[:, NARROW] ** 2
    cov = ellipse[:, SHEAR] * var_y
    bare_x = (det + cov * cov) / var_y - thickness - blur
    bare_y = var_y - thickness - blur
    bare = bare_x * bare_y - cov * cov
    trace = bare_x + bare_y
    trained = bare + thickness * trace + thickness * thickness
    # With s the factor on the scales and v the variance added, a determinant is
    # s⁴ bare + s² v trace + v². The opacity has the factor √(trained ÷ det).
    by_trained = (2.0 * bare + thickness * trace) / np.maximum(trained, _TINY)
    slope: NDArray[np.float64] = by_trained - (2.0 * bare + (thickness + blur) * trace) / det
    return np.where(blur > 0.0, slope, 0.0)


def gradient(
    splats: Splats,
    colours: NDArray[np.float32],
    camera: Camera,
    target: NDArray[np.float32],
    *,
    reduction: float = 1.0,
    near_plane: float = NEAR,
) -> Gradient:
    """Differentiate the squared error of a picture w.r.t. the opacities and sizes of its splats.

    Parameters
    ----------
    splats : Splats
        Splats of the picture, N rows, with the kernel of ``splats.info``. Their SH
        coefficients are not used.
    colours : (n, 3) float32
        Colours of the splats seen from the camera (`shading.row_colours`); at least N rows.
    camera : Camera
        Camera in the frame of the means.
    target : (H, W, 3) float32
        Target picture over black, in the scene's colour space.
    reduction : float
        See `projection.project`.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.

    Returns
    -------
    Gradient
    """
    footprints = project(splats, camera, reduction=reduction, near_plane=near_plane)
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
            footprints.added,
            pair_sums,
        )
        add_pair_sums(lists.members, pair_sums, sums, 0)
    logits = splats.opacities[footprints.index].astype(np.float64)
    by_scale = sums[:, 1].copy()
    if footprints.added[:, FILTER].any():
        by_scale += sums[:, 0] * _opacity_by_scale(footprints)
    return Gradient(
        footprints.index,
        sums[:, 0] * np.exp(-np.logaddexp(0.0, logits)),
        by_scale,
        error,
    )
