"""Per-splat kernels of the backward pass, from gradients of footprints to gradients of values.

They differentiate the EWA projection (Zwicker et al. 2001; Kerbl et al. 2023, appendix A) and the
spherical harmonics, in float64.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry import sh
from cogsplat.codec.render.jit import inner_kernel, kernel
from cogsplat.codec.render.projection import (
    FILTER,
    FLAT,
    GUARD,
    NARROW,
    SHEAR,
    THICKNESS,
    fill_rotation,
)
from cogsplat.codec.render.shading import sh_terms

from .tile_kernels import BY_RED, GU, GUU, GUV, GV, GVV, G

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@inner_kernel
def _direction_gradient(
    x: float, y: float, z: float, c: F64, degree: int
) -> tuple[float, float, float]:
    """Return the gradient w.r.t. (x, y, z) of a linear combination of the SH bases above DC.

    Parameters
    ----------
    x, y, z : float
        Unit viewing direction.
    c : (15,) float64
        Factor of each basis, in the order of `sh.terms`.
    degree : int
        SH degree, 1 to 3; factors of higher degrees are ignored.
    """
    gx, gy, gz = -sh.C1 * c[2], -sh.C1 * c[0], sh.C1 * c[1]
    if degree > 1:
        a, b, d = sh.C2_XY, sh.C2_ZZ, sh.C2_XX_YY
        gx += a * (y * c[3] - z * c[6]) - 2.0 * b * x * c[5] + 2.0 * d * x * c[7]
        gy += a * (x * c[3] - z * c[4]) - 2.0 * b * y * c[5] - 2.0 * d * y * c[7]
        gz += -a * (y * c[4] + x * c[6]) + 4.0 * b * z * c[5]
    if degree > 2:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        gx += -6.0 * sh.C3_3 * xy * c[8] - 3.0 * sh.C3_3 * (xx - yy) * c[14]
        gy += -3.0 * sh.C3_3 * (xx - yy) * c[8] + 6.0 * sh.C3_3 * xy * c[14]
        gx += sh.C3_2 * yz * c[9]
        gy += sh.C3_2 * xz * c[9]
        gz += sh.C3_2 * xy * c[9]
        gx += sh.C3_1 * (2.0 * xy * c[10] - (4.0 * zz - 3.0 * xx - yy) * c[12])
        gy += sh.C3_1 * (2.0 * xy * c[12] - (4.0 * zz - xx - 3.0 * yy) * c[10])
        gz += -8.0 * sh.C3_1 * (yz * c[10] + xz * c[12])
        gx += -6.0 * sh.C3_0 * xz * c[11]
        gy += -6.0 * sh.C3_0 * yz * c[11]
        gz += sh.C3_0 * (6.0 * zz - 3.0 * xx - 3.0 * yy) * c[11]
        gx += 2.0 * sh.C3_XX_YY * xz * c[13]
        gy += -2.0 * sh.C3_XX_YY * yz * c[13]
        gz += sh.C3_XX_YY * (xx - yy) * c[13]
    return gx, gy, gz


@called_with(
    "int32[::1], int32[::1], float64[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, :, ::1], float64[::1], int64, float32[:, ::1], float32[:, ::1], "
    "float32[:, :, ::1], int64, int64"
)
@kernel
def add_colour_gradients(
    order: NDArray[np.int32],
    index: NDArray[np.int32],
    sums: F64,
    colours: F32,
    means: F32,
    shN: F32,
    position: F64,
    degree: int,
    by_means: F32,
    by_sh0: F32,
    by_shN: F32,
    first: int,
    last: int,
) -> None:
    """Add the gradients w.r.t. SH coefficients, and w.r.t. means through the viewing direction.

    Parameters
    ----------
    order : (M,) int32
        Footprints in ascending order of `index`, in which the values of the scene are read fastest.
    index : (M,) int32
        Splat of each footprint, without duplicates.
    sums : (M, SUMS) float64
        Output of `differentiate_tiles`, summed over the tiles of each footprint.
    colours : (M, 3) float32
        Colours of the footprints. A channel at 0 is clamped and has no gradient.
    means, shN : (N, 3) float32, (N, K-1, 3) float32
        Values of the scene.
    position : (3,) float64
        Camera position, scene units.
    degree : int
        SH degree of the picture.
    by_means, by_sh0, by_shN : (N, 3), (N, 3), (N, K-1, 3) float32
        Gradients, changed in place.
    first, last : int
        Half-open range of `order`.
    """
    dots = np.zeros(15, np.float64)
    higher = (degree + 1) * (degree + 1) - 1
    for place in range(first, last):
        row = order[place]
        i = index[row]
        red = sums[row, BY_RED] if colours[row, 0] > 0.0 else 0.0
        green = sums[row, BY_RED + 1] if colours[row, 1] > 0.0 else 0.0
        blue = sums[row, BY_RED + 2] if colours[row, 2] > 0.0 else 0.0
        by_sh0[i, 0] += sh.C0 * red
        by_sh0[i, 1] += sh.C0 * green
        by_sh0[i, 2] += sh.C0 * blue
        if higher == 0:
            continue
        x = means[i, 0] - position[0]
        y = means[i, 1] - position[1]
        z = means[i, 2] - position[2]
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
        values = sh_terms(x, y, z)
        for k in range(higher):
            value = values[k]
            by_shN[i, k, 0] += value * red
            by_shN[i, k, 1] += value * green
            by_shN[i, k, 2] += value * blue
            dots[k] = shN[i, k, 0] * red + shN[i, k, 1] * green + shN[i, k, 2] * blue
        gx, gy, gz = _direction_gradient(x, y, z, dots, degree)
        # The direction has length 1, so the radial part of its gradient is removed.
        along = gx * x + gy * y + gz * z
        by_means[i, 0] += (gx - along * x) * inverse
        by_means[i, 1] += (gy - along * y) * inverse
        by_means[i, 2] += (gz - along * z) * inverse


@called_with(
    "int32[::1], int32[::1], float64[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[::1], float64[:, ::1], float64[::1], float64[::1], int64, int64, "
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1], "
    "float64[:, ::1], int64, int64"
)
@kernel
def add_shape_gradients(
    order: NDArray[np.int32],
    index: NDArray[np.int32],
    sums: F64,
    ellipse: F32,
    means: F32,
    scales: F32,
    quats: F32,
    opacities: F32,
    rotation: F64,
    translation: F64,
    intrinsics: F64,
    width: int,
    height: int,
    added: F32,
    by_means: F32,
    by_scales: F32,
    by_quats: F32,
    by_opacities: F32,
    by_centres: F64,
    first: int,
    last: int,
) -> None:
    """Add the gradients w.r.t. means, scales, quaternions and opacities.

    Parameters
    ----------
    order, index, sums
        Arguments of `add_colour_gradients`.
    ellipse : (M, 8) float32
        Array of `Footprints`.
    means, scales, quats, opacities
        Values of the scene.
    rotation, translation, intrinsics : (3, 3), (3,), (4,) float64
        Camera pose, and fx, fy, cx, cy.
    width, height : int
        Size of the picture, px.
    added : (M, 2) float32
        Array of `Footprints`. Its dependence on the means is neglected.
    by_means, by_scales, by_quats, by_opacities : (N, 3), (N, 3), (N, 4), (N,) float32
        Gradients w.r.t. means, log scales, quaternions and logits, changed in place.
    by_centres : (M, 2) float64
        Output: gradients w.r.t. the image-space centres of the footprints, 1/px.
    first, last : int
        Half-open range of `order`.

    Notes
    -----
    In (u, v) of `differentiate_tiles`, w = W·(pixel - centre) and the covariance's inverse is
    2·Wᵀ·W. With M the second moments of g, the gradient w.r.t. the centre is 2·Wᵀ·(Σ g·w), and the
    gradient w.r.t. the covariance is 2·Wᵀ·M·W.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    guard_x = GUARD * width / (2.0 * fx)
    guard_y = GUARD * height / (2.0 * fy)
    low_x, high_x = -cx / fx - guard_x, (width - cx) / fx + guard_x
    low_y, high_y = -cy / fy - guard_y, (height - cy) / fy + guard_y
    splat = np.empty((3, 3), np.float64)
    local = np.empty(3, np.float64)
    # Rows of the projection's Jacobian in world axes, then along the unit axes of the splat.
    world = np.empty((2, 3), np.float64)
    bare = np.empty((2, 3), np.float64)
    scaled = np.empty((2, 3), np.float64)
    by_scaled = np.empty((2, 3), np.float64)
    by_world = np.empty((2, 3), np.float64)
    linear = np.empty(3, np.float64)
    for place in range(first, last):
        row = order[place]
        i = index[row]
        g, gu, gv = sums[row, G], sums[row, GU], sums[row, GV]
        guu, guv, gvv = sums[row, GUU], sums[row, GUV], sums[row, GVV]
        for k in range(3):
            local[k] = translation[k]
            for axis in range(3):
                local[k] += rotation[k, axis] * means[i, axis]
        z = local[2]
        x, y = local[0] / z, local[1] / z
        slope_x = min(max(x, low_x), high_x)
        slope_y = min(max(y, low_y), high_y)
        narrow = float(ellipse[row, NARROW])
        sheared = -narrow * float(ellipse[row, SHEAR])
        root_flat = math.sqrt(float(ellipse[row, FLAT]))

        qw, qx, qy, qz = (
            float(quats[i, 0]),
            float(quats[i, 1]),
            float(quats[i, 2]),
            float(quats[i, 3]),
        )
        norm = fill_rotation(qw, qx, qy, qz, splat)
        for k in range(3):
            linear[k] = math.exp(float(scales[i, k]))
            world[0, k] = fx / z * (rotation[0, k] - slope_x * rotation[2, k])
            world[1, k] = fy / z * (rotation[1, k] - slope_y * rotation[2, k])
        for j in range(2):
            for k in range(3):
                bare[j, k] = (
                    world[j, 0] * splat[0, k]
                    + world[j, 1] * splat[1, k]
                    + world[j, 2] * splat[2, k]
                )
                scaled[j, k] = bare[j, k] * linear[k]

        by_x = 2.0 * narrow * gu
        by_y = 2.0 * (sheared * gu + root_flat * gv)
        by_centres[row, 0], by_centres[row, 1] = by_x, by_y
        xx = 2.0 * narrow * narrow * guu
        xy = 2.0 * narrow * (sheared * guu + root_flat * guv)
        yy = sheared * sheared * guu + 2.0 * sheared * root_flat * guv
        yy = 2.0 * (yy + root_flat * root_flat * gvv)
        if added[row, FILTER] > 0.0:
            # The log of the opacity factor is half the difference of ln det of the covariance
            # without and with the filter.
            thickness = float(added[row, THICKNESS])
            var_x = scaled[0, 0] ** 2 + scaled[0, 1] ** 2 + scaled[0, 2] ** 2
            var_y = scaled[1, 0] ** 2 + scaled[1, 1] ** 2 + scaled[1, 2] ** 2
            cov = 0.0
            det = 0.0
            for j in range(3):
                cov += scaled[0, j] * scaled[1, j]
                k = (j + 1) % 3
                area = scaled[0, j] * scaled[1, k] - scaled[0, k] * scaled[1, j]
                det += area * area
            det += thickness * (var_x + var_y) + thickness * thickness
            var_x += thickness
            var_y += thickness
            if det > 0.0:
                xx += 0.5 * g * (var_y / det - 2.0 * narrow * narrow)
                xy -= 0.5 * g * (cov / det + 2.0 * narrow * sheared)
                yy += 0.5 * g * (var_x / det - 2.0 * (sheared * sheared + root_flat * root_flat))
        for k in range(3):
            by_scaled[0, k] = 2.0 * (xx * scaled[0, k] + xy * scaled[1, k])
            by_scaled[1, k] = 2.0 * (xy * scaled[0, k] + yy * scaled[1, k])
            by_scales[i, k] += by_scaled[0, k] * scaled[0, k] + by_scaled[1, k] * scaled[1, k]
            by_scaled[0, k] *= linear[k]
            by_scaled[1, k] *= linear[k]
        for j in range(2):
            for k in range(3):
                by_world[j, k] = (
                    by_scaled[j, 0] * splat[k, 0]
                    + by_scaled[j, 1] * splat[k, 1]
                    + by_scaled[j, 2] * splat[k, 2]
                )

        # Gradient w.r.t. small rotations δ about the axes of the splat, then w.r.t. the quaternion,
        # which changes by ½·q·(0, δ).
        turn_x = by_scaled[0, 1] * bare[0, 2] - by_scaled[0, 2] * bare[0, 1]
        turn_x += by_scaled[1, 1] * bare[1, 2] - by_scaled[1, 2] * bare[1, 1]
        turn_y = by_scaled[0, 2] * bare[0, 0] - by_scaled[0, 0] * bare[0, 2]
        turn_y += by_scaled[1, 2] * bare[1, 0] - by_scaled[1, 0] * bare[1, 2]
        turn_z = by_scaled[0, 0] * bare[0, 1] - by_scaled[0, 1] * bare[0, 0]
        turn_z += by_scaled[1, 0] * bare[1, 1] - by_scaled[1, 1] * bare[1, 0]
        by_quats[i, 0] -= norm * (turn_x * qx + turn_y * qy + turn_z * qz)
        by_quats[i, 1] += norm * (qw * turn_x + qy * turn_z - qz * turn_y)
        by_quats[i, 2] += norm * (qw * turn_y + qz * turn_x - qx * turn_z)
        by_quats[i, 3] += norm * (qw * turn_z + qx * turn_y - qy * turn_x)

        # Gradient w.r.t. the mean in camera axes: through the centre, and through the Jacobian.
        by_slope_x, by_slope_y, by_depth = by_x * fx, by_y * fy, 0.0
        through_x, through_y = 0.0, 0.0
        for k in range(3):
            by_depth -= by_world[0, k] * world[0, k] + by_world[1, k] * world[1, k]
            through_x -= fx / z * by_world[0, k] * rotation[2, k]
            through_y -= fy / z * by_world[1, k] * rotation[2, k]
        if low_x < x < high_x:
            by_slope_x += through_x
        if low_y < y < high_y:
            by_slope_y += through_y
        local[0] = by_slope_x / z
        local[1] = by_slope_y / z
        local[2] = (by_depth - by_slope_x * x - by_slope_y * y) / z
        for axis in range(3):
            by_means[i, axis] += (
                rotation[0, axis] * local[0]
                + rotation[1, axis] * local[1]
                + rotation[2, axis] * local[2]
            )
        # 1 - σ(logit), without overflow at infinite logits.
        by_opacities[i] += g / (1.0 + math.exp(float(opacities[i])))
