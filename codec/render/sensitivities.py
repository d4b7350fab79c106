"""Sensitivities: squared error of the pictures per squared error of each stored value.

Rate allocation derives quantiser steps from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry import sh
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Gather

from .blending import (
    ALPHA_MAX,
    BLUE,
    GREEN,
    LANES,
    PIXELS,
    PLANES,
    RED,
    blend_pixel,
    draw_and_reopen,
    footprint_in_tile,
    rows_in_tile,
    store_lane_sums,
)
from .jit import inner_kernel, kernel
from .projection import (
    FILTER,
    FLAT,
    GUARD,
    NARROW,
    SHEAR,
    THICKNESS,
    Footprints,
    fill_rotation,
)
from .tiles import TILE, TileLists, add_pair_sums

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)

PAIRS_AT_ONCE = 1 << 22
"""Pairs of a tile and a splat listed at once, at most; each takes 40 bytes of moments."""

# Moments Σ g·u^p·v^q (see `_moments`), named by p and q, then Σw², and their rows in a tile's
# lanes.
M00, M20, M11, M02, M40, M31, M22, M13, M04, SQUARES = range(10)
MOMENTS = 10
_L20, _L11, _L02, _L40, _L31, _L22, _L13, _L04, _LW = (
    np.uintp(k * TILE) for k in range(1, MOMENTS)
)

# Columns of a view's sensitivities.
_OPACITY, _MEANS, _SCALES, _ROTATIONS, _SH0 = 0, 1, 4, 7, 10
COLUMNS = 13


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Mean squared error of the pictures per squared error of one stored value of one splat.

    An error δ of one value costs ``sensitivity · δ²``; independent errors of several values add up
    (the diagonal of the Gauss-Newton matrix). The mean is over channels, pixels and views, with
    given and jittered views half each, as in `Scores.energy`. Colours are not clipped.

    Parameters
    ----------
    opacities : (N,) float64
        Sensitivity to the opacity logits.
    means : (N, 3) float64
        Sensitivity to the means along the world's axes, per squared scene unit.
    scales : (N, 3) float64
        Sensitivity to the log scales.
    rotations : (N, 3) float64
        Sensitivity to small rotations about the splat's own axes, per squared radian:
        ``q ← q · (1, δ / 2)``.
    sh0 : (N, 3) float64
        Sensitivity to the DC coefficients, by channel; 0 if the colour is clamped at 0.

    Notes
    -----
    The derivatives of the blend are exact with two exceptions. Discontinuities are ignored: the cut
    at alpha 1/255, the end of a pixel, the depth order. The change of shape and colour with the
    direction of a shifted mean is ignored too; it is smaller by the ratio of the splat's size to
    its distance.
    """

    opacities: NDArray[np.float64]
    means: NDArray[np.float64]
    scales: NDArray[np.float64]
    rotations: NDArray[np.float64]
    sh0: NDArray[np.float64]

    def take(self, rows: NDArray[np.int64], gather: Gather = IN_MEMORY.gather) -> Sensitivities:
        """Return the sensitivities of the splats `rows`, copied by a `Workspace.gather`."""
        return Sensitivities(
            *(gather(getattr(self, name), rows) for name in self.__dataclass_fields__)
        )


def from_columns(columns: NDArray[np.float64]) -> Sensitivities:
    """Return the (N, 13) sums of `view_sensitivities` as `Sensitivities`; the arrays are views."""
    return Sensitivities(
        opacities=columns[:, _OPACITY],
        means=columns[:, _MEANS:_SCALES],
        scales=columns[:, _SCALES:_ROTATIONS],
        rotations=columns[:, _ROTATIONS:_SH0],
        sh0=columns[:, _SH0:COLUMNS],
    )


@called_with(
    "int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "boolean[::1], int64, int64, float32[:, ::1], int64, int64"
)
@kernel
def _moments(
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    width: int,
    height: int,
    sums: NDArray[np.float32],
    first: int,
    last: int,
) -> None:
    """Sum the moments of every pair of a tile and a splat, for the tiles ``first`` to ``last``.

    (u, v) is the offset from the centre, scaled so that alpha is ``opacity · exp(-u² - v²)``. With
    g = Σ over channels of (∂C/∂alpha · alpha)², the moments are Σ over pixels of g·u^p·v^q, and of
    w². The derivative ∂C/∂alpha is T·c minus the colour behind the splat over 1 - alpha (Kerbl et
    al. 2023, appendix C), so each tile is walked twice.
    """
    state = np.empty(PLANES * PIXELS, np.float32)
    lanes = np.empty(MOMENTS * TILE, np.float32)
    for tile in range(first, last):
        top, left, num_rows, _, begin, stop = draw_and_reopen(
            state,
            sums,
            MOMENTS,
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
        for pair in range(begin, stop):
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            root_flat = math.sqrt(flat)
            lanes[:] = _ZERO
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                v = root_flat * dy
                vv = v * v
                base = np.uintp(y * TILE)
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    raw, alpha, weight, drawn, after = blend_pixel(
                        state[at], opacity, row_exponent - u * u
                    )
                    state[at] = after
                    odds = alpha / (_ONE - alpha)
                    weighted_red = weight * red
                    weighted_green = weight * green
                    weighted_blue = weight * blue
                    behind_red = state[at + RED] - weighted_red
                    behind_green = state[at + GREEN] - weighted_green
                    behind_blue = state[at + BLUE] - weighted_blue
                    state[at + RED] = behind_red
                    state[at + GREEN] = behind_green
                    state[at + BLUE] = behind_blue
                    slope_red = weighted_red - behind_red * odds
                    slope_green = weighted_green - behind_green * odds
                    slope_blue = weighted_blue - behind_blue * odds
                    g = slope_red * slope_red + slope_green * slope_green + slope_blue * slope_blue
                    # A capped alpha has derivative 0.
                    g = g if drawn & (raw <= ALPHA_MAX) else _ZERO
                    # u of a splat that is not drawn may be so large that its powers overflow.
                    u = u if drawn else _ZERO
                    gu = g * u
                    guu = gu * u
                    guuu = guu * u
                    gvv = g * vv
                    lanes[lane] += g
                    lanes[lane + _L20] += guu
                    lanes[lane + _L11] += gu * v
                    lanes[lane + _L02] += gvv
                    lanes[lane + _L40] += guuu * u
                    lanes[lane + _L31] += guuu * v
                    lanes[lane + _L22] += guu * vv
                    lanes[lane + _L13] += gu * vv * v
                    lanes[lane + _L04] += gvv * vv
                    lanes[lane + _LW] += weight * weight
            store_lane_sums(lanes, sums, MOMENTS, pair)


def add_moments(
    lists: TileLists,
    footprints: Footprints,
    colours: NDArray[np.float32],
    camera: Camera,
    threads: int,
    moments: NDArray[np.float64],
) -> None:
    """Add the moments of each footprint in the tiles of `lists`.

    Parameters
    ----------
    lists : TileLists
        Tile lists of the footprints.
    footprints : Footprints
        Footprints of M splats.
    colours : (M, 3) float32
        Colours of the footprints.
    camera : Camera
        Camera of the footprints.
    threads : int
        Number of threads, at least 1. The sums do not depend on it.
    moments : (M, 13) float64
        Moments in the first ten columns (see `_moments`), changed in place.
    """
    pair_sums = np.empty((len(lists.members), MOMENTS), np.float32)
    everything = np.ones(len(footprints), np.bool_)

    sum_up = partial(
        _moments,
        lists.first,
        lists.starts,
        lists.members,
        footprints.ellipse,
        footprints.rows,
        colours,
        everything,
        camera.width,
        camera.height,
        pair_sums,
    )
    lists.for_ranges(sum_up, threads)
    add_pair_sums(lists.members, pair_sums, moments, 0)


@inner_kernel
def _quartic_sum(moments: NDArray[np.float64], c: float, p: float, q: float, r: float) -> float:
    """Return Σ over pixels of g·(c + p u² + q uv + r v²)², computed from `_moments`."""
    total = c * c * moments[M00]
    total += 2.0 * c * (p * moments[M20] + q * moments[M11] + r * moments[M02])
    total += p * p * moments[M40] + r * r * moments[M04]
    total += 2.0 * q * (p * moments[M31] + r * moments[M13])
    total += (q * q + 2.0 * p * r) * moments[M22]
    # Cancellation may leave a small negative sum.
    return float(max(total, 0.0))


@called_with(
    "int32[::1], int32[::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1], float64[:, ::1], "
    "float64[::1], float64[::1], int64, int64, float32[:, ::1], float64[:, ::1]"
)
@kernel
def _moments_to_sensitivities(
    index: NDArray[np.int32],
    order: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    colours: NDArray[np.float32],
    means: NDArray[np.float32],
    scales: NDArray[np.float32],
    quats: NDArray[np.float32],
    opacities: NDArray[np.float32],
    rotation: NDArray[np.float64],
    translation: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    width: int,
    height: int,
    added: NDArray[np.float32],
    columns: NDArray[np.float64],
) -> None:
    """Convert the moments of footprints to `Sensitivities` of one view, in place.

    Parameters
    ----------
    index : (M,) int32
        `Footprints.index`.
    order : (M,) int32
        Order in which footprints are processed. Ascending rows are fastest if the scene is mapped
        from a file.
    ellipse : (M, 8) float32
        `Footprints.ellipse`.
    colours : (M, 3) float32
        Colours of the footprints.
    means, scales, quats, opacities
        Arrays of the scene.
    rotation, translation, intrinsics, width, height
        Camera; intrinsics are fx, fy, cx, cy.
    added : (M, 2) float32
        `Footprints.added`.
    columns : (M, 13) float64
        Input: moments in the first columns. Output: sums of squared derivatives w.r.t. each value.
    """
    m = np.empty(MOMENTS, np.float64)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    guard_x = GUARD * width / (2.0 * fx)
    guard_y = GUARD * height / (2.0 * fy)
    low_x, high_x = -cx / fx - guard_x, (width - cx) / fx + guard_x
    low_y, high_y = -cy / fy - guard_y, (height - cy) / fy + guard_y
    local = np.empty(3, np.float64)
    splat_rotation = np.empty((3, 3), np.float64)
    # Projections of the splat's three axes, of unit length in the scene: in px, and in (u, v).
    bare = np.empty((3, 2), np.float64)
    axes = np.empty((3, 2), np.float64)
    variances = np.empty(3, np.float64)
    for row in order:
        i = index[row]
        for k in range(MOMENTS):
            m[k] = columns[row, k]
        for k in range(COLUMNS):
            columns[row, k] = 0.0
        for channel in range(3):
            if colours[row, channel] > 0.0:
                columns[row, _SH0 + channel] = sh.C0 * sh.C0 / 3.0 * m[SQUARES]
        if not m[M00] > 0.0:
            continue
        rest = 1.0 / (1.0 + math.exp(float(opacities[i])))
        columns[row, _OPACITY] = rest * rest * m[M00] / 3.0

        for k in range(3):
            local[k] = translation[k]
            for axis in range(3):
                local[k] += rotation[k, axis] * means[i, axis]
        z = local[2]
        x, y = local[0] / z, local[1] / z
        narrow = float(ellipse[row, NARROW])
        sheared = -narrow * float(ellipse[row, SHEAR])
        root_flat = math.sqrt(float(ellipse[row, FLAT]))
        for axis in range(3):
            # d(log alpha) = 2 (u, v) · d(u, v) of the centre.
            right = fx / z * (rotation[0, axis] - x * rotation[2, axis])
            down = fy / z * (rotation[1, axis] - y * rotation[2, axis])
            du = narrow * right + sheared * down
            dv = root_flat * down
            square = du * du * m[M20] + 2.0 * du * dv * m[M11] + dv * dv * m[M02]
            columns[row, _MEANS + axis] = 4.0 / 3.0 * max(square, 0.0)

        fill_rotation(
            float(quats[i, 0]),
            float(quats[i, 1]),
            float(quats[i, 2]),
            float(quats[i, 3]),
            splat_rotation,
        )
        slope_x = min(max(x, low_x), high_x)
        slope_y = min(max(y, low_y), high_y)
        var_x, var_y, cov, det = 0.0, 0.0, 0.0, 0.0
        for j in range(3):
            variances[j] = math.exp(2.0 * float(scales[i, j]))
            for k in range(3):
                local[k] = 0.0
                for axis in range(3):
                    local[k] += rotation[k, axis] * splat_rotation[axis, j]
            right = fx / z * (local[0] - slope_x * local[2])
            down = fy / z * (local[1] - slope_y * local[2])
            bare[j, 0], bare[j, 1] = right, down
            axes[j, 0] = narrow * right + sheared * down
            axes[j, 1] = root_flat * down
            var_x += variances[j] * right * right
            var_y += variances[j] * down * down
            cov += variances[j] * right * down
            for k in range(j):
                area = bare[k, 0] * down - bare[k, 1] * right
                det += variances[j] * variances[k] * area * area
        thickness = float(added[row, THICKNESS])
        det += thickness * (var_x + var_y) + thickness * thickness
        var_x += thickness
        var_y += thickness
        for j in range(3):
            for k in range(j + 1):
                # d(covariance) = strength · (a bᵀ + b aᵀ): axis j scaled, or rotated against k.
                if j == k:
                    strength = variances[j]
                    column = _SCALES + j
                else:
                    strength = variances[j] - variances[k]
                    # Axes 1 and 2 rotate about axis 0, axes 2 and 0 about 1, axes 0 and 1 about 2.
                    column = _ROTATIONS + 3 - j - k
                constant = 0.0
                if added[row, FILTER] > 0.0 and det > 0.0:
                    # The logarithm of the opacity's factor is half the trained covariance's ln det
                    # less half the filtered one's, whose inverse is 2 (u, v)·(u, v).
                    inner = var_y * bare[j, 0] * bare[k, 0] + var_x * bare[j, 1] * bare[k, 1]
                    inner -= cov * (bare[j, 0] * bare[k, 1] + bare[j, 1] * bare[k, 0])
                    widened = axes[j, 0] * axes[k, 0] + axes[j, 1] * axes[k, 1]
                    constant = inner / det - 2.0 * widened
                quartic = _quartic_sum(
                    m,
                    constant,
                    4.0 * axes[j, 0] * axes[k, 0],
                    4.0 * (axes[j, 0] * axes[k, 1] + axes[j, 1] * axes[k, 0]),
                    4.0 * axes[j, 1] * axes[k, 1],
                )
                columns[row, column] = strength * strength / 3.0 * quartic


def view_sensitivities(
    splats: Splats,
    camera: Camera,
    footprints: Footprints,
    colours: NDArray[np.float32],
    moments: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Convert the moments of one view to the sensitivities of the stored values, in place.

    Parameters
    ----------
    splats, camera, footprints, colours
        Inputs of `add_moments`.
    moments : (M, 13) float64
        Moments over all measured tiles, from `add_moments`; overwritten, because a second such
        array of a large view would take as much memory as the scene.

    Returns
    -------
    (M, 13) float64
        The array `moments` with the columns of `from_columns`: sums over pixels, means over
        channels.
    """
    _moments_to_sensitivities(
        footprints.index,
        footprints.row_order(),
        footprints.ellipse,
        colours,
        splats.means,
        splats.scales,
        splats.quats,
        splats.opacities,
        camera.rotation,
        camera.translation,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
        camera.width,
        camera.height,
        footprints.added,
        moments,
    )
    return moments
