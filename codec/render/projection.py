"""EWA projection: splats as ellipses on a camera's image, bounded where alpha is 1/255."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import training_pixel
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.splats import Splats

from .depth_order import depth_order
from .jit import inner_kernel, kernel

# 3DGS, computeCov2D: the point of the Jacobian is clamped to the image widened by this share of its
# half size (1.3 tan(fov / 2) for a centred principal point).
GUARD = 0.3
# Bounds of an ellipse are widened by this many px and this share of its position and size, because
# the ellipse is rounded to float32. The alpha in a pixel decides whether a splat reaches it.
_SLACK_PX = 0.01
_SLACK = 1e-6
# Limit of a footprint's values, px or powers: the squares of larger values overflow float32.
_HUGE = 1e18

# Variance of a uniform distribution over a pixel, px².
PIXEL_VARIANCE = 1.0 / 12.0
# The pixel of a picture counts as that of training when their areas differ by less than this share:
# rounding of a position must not blur the picture of a training camera.
_SAME_PIXEL = 1e-6

# Bounds of a footprint by the sphere around its ellipsoid. A camera's rotation may be off by 1e-3,
# which lengthens the rows of the Jacobian; a splat of opacity 1 has the longest cut.
BALL = 1.02
BALL_EDGE = 1.001 * math.sqrt(-2.0 * math.log(ALPHA_MIN))

# Columns of `Footprints.ellipse`, and of `Footprints.added`.
X, Y, NARROW, SHEAR, FLAT, OPACITY, HALF_WIDTH, HALF_HEIGHT = range(8)
THICKNESS, FILTER = range(2)


@dataclass(frozen=True, eq=False)
class Footprints:
    """Projected ellipses of M visible splats, nearest first (camera-space z, ties by row).

    Alpha at an offset (dx, dy) from the centre is
    ``opacity · exp(-(narrow · (dx - shear · dy))² - flat · dy²)``, which is the projected Gaussian
    with its square completed in dx: thin diagonal ellipses stay accurate in float32.

    Parameters
    ----------
    index : (M,) int32
        Row of each footprint's splat in the scene.
    order : (M,) int32
        Rank of each value of `index` among all of them.
    ellipse : (M, 8) float32
        x, y (px), narrow (1/px), shear, flat (1/px²), opacity (0 to 1, rescaled when
        anti-aliased), half width along the centre's row and half height (px) at alpha 1/255.
    rows : (M, 2) int32
        Half-open range of image rows that may be covered.
    added : (M, 2) float32
        Variances added to the projected covariance, px²: the trained thickness, then the filter
        for which the opacity is rescaled.
    """

    index: NDArray[np.int32]
    order: NDArray[np.int32]
    ellipse: NDArray[np.float32]
    rows: NDArray[np.int32]
    added: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.index)

    @classmethod
    def joined(cls, parts: Sequence[Footprints]) -> Footprints:
        """Return the footprints of several parts of a scene, each further away than the last."""
        index = np.concatenate([part.index for part in parts])
        order = np.empty_like(index)
        order[np.argsort(index)] = np.arange(len(index), dtype=np.int32)
        return cls(
            index,
            order,
            np.concatenate([part.ellipse for part in parts]),
            np.concatenate([part.rows for part in parts]),
            np.concatenate([part.added for part in parts]),
        )

    def only(self, kept: NDArray[np.bool_]) -> Footprints:
        """Return the footprints of a mask, (M,) bool, nearest first."""
        by_row = np.empty_like(kept)
        by_row[self.order] = kept
        ranks = np.cumsum(by_row, dtype=np.int32) - np.int32(1)
        return Footprints(
            self.index[kept],
            ranks[self.order[kept]],
            self.ellipse[kept],
            self.rows[kept],
            self.added[kept],
        )

    def sorted_rows(self) -> NDArray[np.int32]:
        """Return `index` in ascending order, (M,): the order in which a scene is read fastest."""
        rows = np.empty_like(self.index)
        rows[self.order] = self.index
        return rows

    def row_order(self) -> NDArray[np.int32]:
        """Return the footprint numbers in ascending order of `index`, (M,)."""
        places = np.empty_like(self.order)
        places[self.order] = np.arange(len(self.order), dtype=np.int32)
        return places


@inner_kernel
def fill_rotation(
    qw: float, qx: float, qy: float, qz: float, rotation: NDArray[np.float64]
) -> float:
    """Compute the rotation matrix of a quaternion; return 2 / (its squared length).

    Parameters
    ----------
    qw, qx, qy, qz : float
        Quaternion of any non-zero length.
    rotation : (3, 3) float64
        Output: rotation from the splat's axes to the scene's.
    """
    norm = 2.0 / (qw * qw + qx * qx + qy * qy + qz * qz)
    rotation[0, 0] = 1.0 - norm * (qy * qy + qz * qz)
    rotation[0, 1] = norm * (qx * qy - qw * qz)
    rotation[0, 2] = norm * (qx * qz + qw * qy)
    rotation[1, 0] = norm * (qx * qy + qw * qz)
    rotation[1, 1] = 1.0 - norm * (qx * qx + qz * qz)
    rotation[1, 2] = norm * (qy * qz - qw * qx)
    rotation[2, 0] = norm * (qx * qz - qw * qy)
    rotation[2, 1] = norm * (qy * qz + qw * qx)
    rotation[2, 2] = 1.0 - norm * (qx * qx + qy * qy)
    return norm


@inner_kernel
def slack(centre: float, extent: float) -> float:
    """Return the margin, px, that covers the rounding of an ellipse's bounds to float32."""
    return _SLACK_PX + _SLACK * (abs(centre) + extent)


@called_with(
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1], float64[:, ::1], "
    "float64[::1], float64[::1], float64[::1], float64[::1], int64, int64, float64, float64, "
    "float64, boolean, int32[::1], int32[::1], float64[::1], float32[:, ::1], int32[:, ::1], "
    "float32[:, ::1]"
)
@kernel
def _project(
    means: NDArray[np.float32],
    scales: NDArray[np.float32],
    quats: NDArray[np.float32],
    opacities: NDArray[np.float32],
    rotation: NDArray[np.float64],
    translation: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    variances: NDArray[np.float64],
    pixel: NDArray[np.float64],
    width: int,
    height: int,
    near_plane: float,
    nearest: float,
    furthest: float,
    listed: bool,
    chosen: NDArray[np.int32],
    index: NDArray[np.int32],
    depths: NDArray[np.float64],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    added: NDArray[np.float32],
) -> int:
    """Write the footprints that may reach a pixel to the outputs and return their number.

    Every comparison is written so that NaN fails it.

    Parameters
    ----------
    variances : (2,) float64
        Thickness and filter of every splat, px², where `pixel` is empty; else ``kernel_px`` in
        pixels of training, and 0.
    pixel : (5,) or (0,) float64
        Training pixel (`capture.training_pixel`), empty for one thickness and filter.
    nearest, furthest : float
        Half-open range of depths.
    listed : bool
        Whether only the splats of the rows `chosen` are projected.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    guard_x = GUARD * width / (2.0 * fx)
    guard_y = GUARD * height / (2.0 * fy)
    low_x, high_x = -cx / fx - guard_x, (width - cx) / fx + guard_x
    low_y, high_y = -cy / fy - guard_y, (height - cy) / fy + guard_y
    r = rotation
    thickness, blur = variances[THICKNESS], variances[FILTER]
    sized = len(pixel) > 0
    count = 0
    for k in range(len(chosen) if listed else len(means)):
        i = np.int64(chosen[k]) if listed else k
        mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        z = r[2, 0] * mx + r[2, 1] * my + r[2, 2] * mz + translation[2]
        if not (z > near_plane and z >= nearest and z < furthest):
            continue
        x = (r[0, 0] * mx + r[0, 1] * my + r[0, 2] * mz + translation[0]) / z
        y = (r[1, 0] * mx + r[1, 1] * my + r[1, 2] * mz + translation[1]) / z
        px, py = fx * x + cx, fy * y + cy
        if sized:
            # Areas of the pixel of training over this picture's, at the splat.
            dx, dy, dz = mx - pixel[0], my - pixel[1], mz - pixel[2]
            area = pixel[3] * (dx * dx + dy * dy + dz * dz) + pixel[4]
            share = area * fx * fy / (z * z * (1.0 + x * x + y * y))
            if abs(share - 1.0) < _SAME_PIXEL:
                share = 1.0
            thickness = variances[THICKNESS] * share
            blur = PIXEL_VARIANCE * (1.0 - share) if share < 1.0 else 0.0
        jx = -min(max(x, low_x), high_x)
        jy = -min(max(y, low_y), high_y)
        if not (0.5 < px < width - 0.5 and 0.5 < py < height - 0.5):
            # Most splats of a large scene are outside the picture: a sphere around the ellipsoid
            # tells without its rotation and opacity.
            widest = max(scales[i, 0], scales[i, 1], scales[i, 2])
            ball = BALL * math.exp(2.0 * widest) / (z * z)
            ball_x = BALL_EDGE * math.sqrt(ball * fx * fx * (1.0 + jx * jx) + thickness + blur)
            ball_y = BALL_EDGE * math.sqrt(ball * fy * fy * (1.0 + jy * jy) + thickness + blur)
            ball_x += slack(px, ball_x)
            ball_y += slack(py, ball_y)
            if px + ball_x <= 0.5 or px - ball_x >= width - 0.5:
                continue
            if py + ball_y <= 0.5 or py - ball_y >= height - 0.5:
                continue
        opacity = 1.0 / (1.0 + math.exp(-float(opacities[i])))
        if not opacity >= ALPHA_MIN:
            continue

        # Rotation of the splat from its quaternion, normalised here.
        qw, qx, qy, qz = (
            float(quats[i, 0]),
            float(quats[i, 1]),
            float(quats[i, 2]),
            float(quats[i, 3]),
        )
        norm = 2.0 / (qw * qw + qx * qx + qy * qy + qz * qz)
        xx, yy, zz = norm * qx * qx, norm * qy * qy, norm * qz * qz
        xy, xz, yz = norm * qx * qy, norm * qx * qz, norm * qy * qz
        wx, wy, wz = norm * qw * qx, norm * qw * qy, norm * qw * qz

        # Rows of the projection's Jacobian times the world-to-camera rotation, in world axes.
        ax = (fx / z) * (r[0, 0] + jx * r[2, 0])
        ay = (fx / z) * (r[0, 1] + jx * r[2, 1])
        az = (fx / z) * (r[0, 2] + jx * r[2, 2])
        bx = (fy / z) * (r[1, 0] + jy * r[2, 0])
        by = (fy / z) * (r[1, 1] + jy * r[2, 1])
        bz = (fy / z) * (r[1, 2] + jy * r[2, 2])

        # These rows in the splat's axes, times its standard deviations m: covariance = m mᵀ.
        s0, s1, s2 = math.exp(scales[i, 0]), math.exp(scales[i, 1]), math.exp(scales[i, 2])
        a0 = s0 * (ax * (1.0 - yy - zz) + ay * (xy + wz) + az * (xz - wy))
        a1 = s1 * (ax * (xy - wz) + ay * (1.0 - xx - zz) + az * (yz + wx))
        a2 = s2 * (ax * (xz + wy) + ay * (yz - wx) + az * (1.0 - xx - yy))
        b0 = s0 * (bx * (1.0 - yy - zz) + by * (xy + wz) + bz * (xz - wy))
        b1 = s1 * (bx * (xy - wz) + by * (1.0 - xx - zz) + bz * (yz + wx))
        b2 = s2 * (bx * (xz + wy) + by * (yz - wx) + bz * (1.0 - xx - yy))
        var_x = a0 * a0 + a1 * a1 + a2 * a2
        var_y = b0 * b0 + b1 * b1 + b2 * b2
        cov = a0 * b0 + a1 * b1 + a2 * b2
        # Cauchy-Binet: a sum of squares, because var_x var_y - cov² cancels for thin splats.
        n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
        det_bare = n0 * n0 + n1 * n1 + n2 * n2
        det = det_bare + thickness * (var_x + var_y) + thickness * thickness
        var_x += thickness
        var_y += thickness
        if blur > 0.0:
            # Mip-Splatting, section 4.2: the wider footprint keeps the splat's total opacity.
            det_trained = det
            det += blur * (var_x + var_y) + blur * blur
            var_x += blur
            var_y += blur
            opacity *= math.sqrt(det_trained / det)
            if not opacity >= ALPHA_MIN:
                continue
        if not (det > 0.0 and var_y > 0.0):
            continue

        cut = math.log(opacity / ALPHA_MIN)
        half_height = math.sqrt(2.0 * cut * var_y)
        half_width = math.sqrt(2.0 * cut * det / var_y)
        reach_x = math.sqrt(2.0 * cut * var_x)
        edge_x = reach_x + slack(px, reach_x)
        edge_y = half_height + slack(py, half_height)
        if not (px + edge_x > 0.5 and px - edge_x < width - 0.5):
            continue
        if not (py + edge_y > 0.5 and py - edge_y < height - 0.5):
            continue
        narrow = math.sqrt(0.5 * var_y / det)
        shear = cov / var_y
        flat = 0.5 / var_y
        if not (abs(px) < _HUGE and abs(py) < _HUGE and abs(shear) < _HUGE):
            continue
        if not (narrow < _HUGE and flat < _HUGE):
            continue
        index[count] = i
        depths[count] = z
        ellipse[count, X] = px
        ellipse[count, Y] = py
        ellipse[count, NARROW] = narrow
        ellipse[count, SHEAR] = shear
        ellipse[count, FLAT] = flat
        ellipse[count, OPACITY] = opacity
        ellipse[count, HALF_WIDTH] = half_width
        ellipse[count, HALF_HEIGHT] = half_height
        added[count, THICKNESS] = thickness
        added[count, FILTER] = blur
        # Clamped as floats: a huge splat would overflow the integers.
        rows[count, 0] = math.ceil(max(py - edge_y - 0.5, 0.0))
        rows[count, 1] = math.floor(min(py + edge_y - 0.5, height - 1.0)) + 1
        count += 1
    return count


def project(
    splats: Splats,
    camera: Camera,
    *,
    reduction: float = 1.0,
    near_plane: float = NEAR,
    rows: NDArray[np.int32] | None = None,
    depths: tuple[float, float] = (0.0, math.inf),
) -> Footprints:
    """Project a scene into a camera, with the kernel of ``splats.info``.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn (NaN, zero quaternions) are ignored.
    camera : Camera
        Camera in the frame of the means.
    reduction : float
        Reduction of the picture per axis against the pictures of training, at least 1.
        Not used for scenes with capture viewpoints or marked as anti-aliased.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    rows : (K,) int32, optional
        Rows of the splats to project, ascending; by default all.
    depths : (float, float)
        Half-open range of camera-space depths; splats outside it are left out.

    Returns
    -------
    Footprints

    Notes
    -----
    SPEC 8.7. Training added `kernel_px` to the covariance in each of its pictures, so a splat has
    that thickness in pixels of training. Where pixels are larger, the splat is then filtered by
    what the larger pixel has beyond that of training, and keeps its total opacity.
    """
    n = len(splats) if rows is None else len(rows)
    index = np.empty(n, np.int32)
    found = np.empty(n, np.float64)
    ellipse = np.empty((n, 8), np.float32)
    image_rows = np.empty((n, 2), np.int32)
    added = np.empty((n, 2), np.float32)
    variances, pixel = view_kernel(splats, camera, reduction)
    count = _project(
        splats.means,
        splats.scales,
        splats.quats,
        splats.opacities,
        camera.rotation,
        camera.translation,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
        variances,
        pixel,
        camera.width,
        camera.height,
        float(near_plane),
        float(depths[0]),
        float(depths[1]),
        rows is not None,
        np.empty(0, np.int32) if rows is None else rows,
        index,
        found,
        ellipse,
        image_rows,
        added,
    )
    order = depth_order(found[:count])
    return Footprints(
        index[:count].take(order),
        order,
        ellipse.take(order, axis=0),
        image_rows.take(order, axis=0),
        added.take(order, axis=0),
    )


def view_kernel(
    splats: Splats, camera: Camera, reduction: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the variances that a camera adds to the footprints of a scene.

    Parameters
    ----------
    splats, camera, reduction
        See `project`.

    Returns
    -------
    variances : (2,) float64
        Thickness and filter of every splat, px², where `pixel` is empty; else ``kernel_px`` in
        pixels of training, and 0.
    pixel : (5,) or (0,) float64
        Training pixel (`capture.training_pixel`), empty for one thickness and filter.
    """
    info = splats.info
    if info.antialiased:
        return np.array([0.0, info.kernel_px]), np.empty(0)
    if info.capture:
        return np.array([info.kernel_px, 0.0]), training_pixel(info.capture, camera.position)
    share = 1.0 / (reduction * reduction)
    return np.array([info.kernel_px * share, PIXEL_VARIANCE * (1.0 - share)]), np.empty(0)
