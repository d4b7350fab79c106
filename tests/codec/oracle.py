"""Brute force in float64, pixel by pixel over all splats: no tiles, no extents, no shortcuts.

Written from the equations (Zwicker et al. 2001, Kerbl et al. 2023), sharing no code with codec.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import lpmv

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import SceneInfo, Splats

# Compared in float32 by 3DGS.
ALPHA_MAX = float(np.float32(0.99))
STOP = float(np.float32(1e-4))


@dataclass(frozen=True)
class View:
    """image (H, W, 3), rest (H, W), weights (H·W, N), all float64, N in the scene's order."""

    image: NDArray[np.float64]
    weights: NDArray[np.float64]
    depth_order: NDArray[np.intp]


def real_sh(directions, degree):
    """Real SH with the Condon-Shortley phase, from associated Legendre functions: (N, K)."""
    x, y, z = np.asarray(directions, np.float64).T
    azimuth = np.arctan2(y, x)
    columns = []
    for band in range(degree + 1):
        for m in range(-band, band + 1):
            order = abs(m)
            norm = (2 * band + 1) / (4 * math.pi)
            norm *= math.factorial(band - order) / math.factorial(band + order)
            value = math.sqrt(norm) * lpmv(order, band, z)
            if m > 0:
                value = math.sqrt(2) * value * np.cos(order * azimuth)
            elif m < 0:
                value = math.sqrt(2) * value * np.sin(order * azimuth)
            columns.append(value)
    return np.stack(columns, axis=1)


def rotation_matrix(quat):
    """Rotation of a wxyz quaternion as the product q v q*, column by column."""
    w, *vector = np.asarray(quat, np.float64) / np.linalg.norm(np.asarray(quat, np.float64))
    axis = np.array(vector)
    columns = []
    for unit in np.eye(3):
        inner = np.cross(axis, unit) + w * unit
        columns.append(unit + 2.0 * np.cross(axis, inner))
    return np.stack(columns, axis=1)


def directions(splats, camera):
    offset = splats.means.astype(np.float64) - camera.position
    return offset / np.linalg.norm(offset, axis=1, keepdims=True)


def covariance(splats, camera, row):
    """Projected covariance without the kernel, centre and depth of one splat."""
    mean = camera.rotation @ splats.means[row].astype(np.float64) + camera.translation
    depth = mean[2]
    spread = rotation_matrix(splats.quats[row]) @ np.diag(np.exp(splats.scales[row].astype(float)))
    sigma = spread @ spread.T
    guard_x = 0.3 * camera.width / 2 / camera.fx
    guard_y = 0.3 * camera.height / 2 / camera.fy
    slope_x = np.clip(
        mean[0] / depth, -camera.cx / camera.fx - guard_x,
        (camera.width - camera.cx) / camera.fx + guard_x,
    )  # fmt: skip
    slope_y = np.clip(
        mean[1] / depth, -camera.cy / camera.fy - guard_y,
        (camera.height - camera.cy) / camera.fy + guard_y,
    )  # fmt: skip
    jacobian = np.array(
        [
            [camera.fx / depth, 0, -camera.fx * slope_x / depth],
            [0, camera.fy / depth, -camera.fy * slope_y / depth],
        ]
    )
    linear = jacobian @ camera.rotation
    centre = np.array(
        [camera.fx * mean[0] / depth + camera.cx, camera.fy * mean[1] / depth + camera.cy]
    )
    return linear @ sigma @ linear.T, centre, depth


# Viewpoints near to and far from `camera()`: some splats are drawn smaller than in training, some
# larger.
CAPTURE = ((0.5, -0.25, -2.0, 60.0), (-3.0, 1.0, -4.0, 25.0), (4.0, 2.0, 3.0, 40.0))
INFOS = {
    "usual": SceneInfo(),
    "antialiased": SceneInfo(antialiased=True),
    "captured": SceneInfo(capture=CAPTURE),
}


def added(splats, camera, row, reduction=1.0):
    """Trained thickness and filter of a splat, px²."""
    kernel_px, capture = splats.info.kernel_px, np.array(splats.info.capture, np.float64)
    if splats.info.antialiased:
        return 0.0, kernel_px
    share = 1.0 / reduction**2
    if len(capture):
        nearness = np.linalg.norm(capture[:, :3] - camera.position, axis=1) ** -4.0
        pixels = np.linalg.norm(capture[:, :3] - splats.means[row], axis=1) / capture[:, 3]
        distance = np.linalg.norm(splats.means[row] - camera.position)
        share = np.average(pixels**2, weights=nearness) * camera.fx * camera.fy / distance**2
    return kernel_px * share, max(0.0, (1.0 - share) / 12.0)


def view(splats, camera, *, reduction=1.0, background=(0, 0, 0), near_plane=0.2):
    n = len(splats)
    columns, lines = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([columns.ravel(), lines.ravel()], axis=1)
    degree = math.isqrt(splats.shN.shape[1] + 1) - 1
    coefficients = np.concatenate([splats.sh0[:, None], splats.shN], axis=1).astype(np.float64)
    bases = real_sh(directions(splats, camera), degree)
    colours = np.maximum(np.einsum("nk,nkc->nc", bases, coefficients) + 0.5, 0.0)

    projected = [covariance(splats, camera, row) for row in range(n)]
    depths = np.array([depth for _, _, depth in projected])
    depth_order = np.argsort(depths, kind="stable")
    transmittance = np.ones(len(pixels))
    running = np.ones(len(pixels), bool)
    weights = np.zeros((len(pixels), n))
    for row in depth_order:
        bare, centre, depth = projected[row]
        if depth <= near_plane:
            continue
        thickness, blur = added(splats, camera, row, reduction)
        trained = bare + thickness * np.eye(2)
        wide = trained + blur * np.eye(2)
        with np.errstate(over="ignore"):
            opacity = 1.0 / (1.0 + np.exp(-float(splats.opacities[row])))
        if blur:
            opacity *= math.sqrt(max(0.0, np.linalg.det(trained) / np.linalg.det(wide)))
        offset = pixels - centre
        square = np.einsum("pi,ij,pj->p", offset, np.linalg.inv(wide), offset)
        alpha = np.minimum(ALPHA_MAX, opacity * np.exp(-0.5 * square))
        touched = running & (alpha >= 1 / 255)
        after = transmittance * (1 - alpha)
        stops = touched & (after < STOP)
        running &= ~stops
        drawn = touched & ~stops
        weights[drawn, row] = (transmittance * alpha)[drawn]
        transmittance[drawn] = after[drawn]
    image = weights @ colours + transmittance[:, None] * np.asarray(background, np.float64)
    return View(image.reshape(camera.height, camera.width, 3), weights, depth_order)


def top_weights(seen, top_k):
    """Keep each pixel's `top_k` largest weights (0 = all), of equal ones the nearest: (H·W, N)."""
    if top_k == 0:
        return seen.weights
    by_depth = seen.weights[:, seen.depth_order]
    rank = np.argsort(np.argsort(-by_depth, axis=1, kind="stable"), axis=1)
    kept = np.empty_like(seen.weights)
    kept[:, seen.depth_order] = np.where(rank < top_k, by_depth, 0.0)
    return kept


def scene(seed, n=60, degree=3, opacity=1.5, info=None):
    """Random splats before and around `camera()`, some thin, some faint, some opaque."""
    rng = np.random.default_rng(seed)
    k = (degree + 1) ** 2
    return Splats(
        means=(rng.normal(size=(n, 3)) * [1.2, 1.2, 1.0]).astype(np.float32),
        scales=rng.normal(-1.8, 0.8, size=(n, 3)).astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        opacities=rng.normal(0.5, opacity, size=n).astype(np.float32),
        sh0=rng.normal(0.0, 1.0, size=(n, 3)).astype(np.float32),
        shN=rng.normal(0.0, 0.3, size=(n, k - 1, 3)).astype(np.float32),
        info=info or SceneInfo(),
    )


def camera(angle=0.3, width=53, height=37, focal=45.0, distance=4.0, shift=0.0):
    """Look at the origin from `distance`, turned by `angle` about the world's y axis."""
    cos, sin = math.cos(angle), math.sin(angle)
    tilt = np.array(
        [[1, 0, 0], [0, math.cos(0.2), -math.sin(0.2)], [0, math.sin(0.2), math.cos(0.2)]]
    )
    rotation = tilt @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=1.1 * focal,
        cx=width / 2 + shift,
        cy=height / 2 - shift,
        rotation=rotation,
        translation=np.array([0.1, -0.05, distance]),
        name=f"view {angle}",
    )
