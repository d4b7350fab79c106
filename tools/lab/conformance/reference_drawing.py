"""Reference renderer, written from SPEC 8.7 alone; it computes the pictures of the vectors.

It shares no code with the renderers, computes in float64 and evaluates every splat at every pixel.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgpack

from . import reference_decoder

Vector = list[float]

_NEAR: Final = 0.2
_ALPHA_LEAST: Final = 1.0 / 255.0
_ALPHA_MOST: Final = 0.99
_TRANSMITTANCE_LEAST: Final = 1e-4
_GUARD: Final = 0.3
_SAME_PIXEL: Final = 1e-6


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with the keys of SPEC 4.4."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: Vector
    translation: Vector


@dataclass(frozen=True)
class _Kernel:
    """Keys of the root that say how wide splats are drawn."""

    kernel_px: float
    antialiased: bool
    capture: list[tuple[float, float, float, float]]


@dataclass(frozen=True)
class _Ellipse:
    """A splat in the picture: centre, covariance, opacity and colour."""

    depth: float
    x: float
    y: float
    covariance: tuple[float, float, float]
    opacity: float
    colour: Vector


def draw(data: bytes, camera: Camera) -> Vector:
    """Draw a valid file before black: R, G, B of each pixel, row by row."""
    scene = reference_decoder.decode(data)
    (root_length,) = struct.unpack_from("<I", data, 12)
    root = msgpack.unpackb(data[64 : 64 + root_length])
    kernel = _Kernel(
        root["kernel_px"],
        root["antialiased"],
        list(struct.iter_unpack("<4f", root.get("capture", b""))),
    )
    rows = scene.rows
    ellipses = [
        _ellipse(camera, kernel, *splat)
        for splat in zip(
            rows["means"],
            rows["scales"],
            rows["quats"],
            rows["opacities"],
            [dc + rest for dc, rest in zip(rows["sh0"], rows["shN"], strict=True)],
            strict=True,
        )
    ]
    drawn = sorted((e for e in ellipses if e is not None), key=lambda e: e.depth)
    return [
        value
        for row in range(camera.height)
        for column in range(camera.width)
        for value in _pixel(drawn, column + 0.5, row + 0.5)
    ]


def _position(camera: Camera) -> Vector:
    r, t = camera.rotation, camera.translation
    return [-sum(r[3 * i + axis] * t[i] for i in range(3)) for axis in range(3)]


def _squared_distance(a: Sequence[float], b: Sequence[float]) -> float:
    return sum((p - q) ** 2 for p, q in zip(a, b, strict=True))


def _added(camera: Camera, kernel: _Kernel, mean: Vector) -> tuple[float, float]:
    """Return the thickness and the filter of a splat, px²."""
    if kernel.antialiased:
        return 0.0, kernel.kernel_px
    if not kernel.capture:
        return kernel.kernel_px, 0.0
    position = _position(camera)
    from_viewer = [_squared_distance(view[:3], position) for view in kernel.capture]
    if 0.0 in from_viewer:
        weights = [float(square == 0.0) for square in from_viewer]
    else:
        weights = [(min(from_viewer) / square) ** 2 for square in from_viewer]
    pixels = [_squared_distance(mean, view[:3]) / view[3] ** 2 for view in kernel.capture]
    area = sum(w * pixel for w, pixel in zip(weights, pixels, strict=True)) / sum(weights)
    share = camera.fx * camera.fy * area / _squared_distance(mean, position)
    if abs(share - 1.0) < _SAME_PIXEL:
        share = 1.0
    return kernel.kernel_px * share, max(0.0, 1.0 - share) / 12.0


def _ellipse(
    camera: Camera,
    kernel: _Kernel,
    mean: Vector,
    scales: Vector,
    quat: Vector,
    logit: Vector,
    coefficients: Vector,
) -> _Ellipse | None:
    """Project a splat; None if nothing of it is drawn."""
    r, t = camera.rotation, camera.translation
    x, y, z = (sum(r[3 * i + j] * mean[j] for j in range(3)) + t[i] for i in range(3))
    if not z > _NEAR:
        return None

    guard = _GUARD * camera.width / 2 / camera.fx
    left, right = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    u = min(max(x / z, left - guard), right + guard)
    guard = _GUARD * camera.height / 2 / camera.fy
    top, bottom = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    v = min(max(y / z, top - guard), bottom + guard)
    jacobian = [
        [camera.fx / z, 0.0, -camera.fx * u / z],
        [0.0, camera.fy / z, -camera.fy * v / z],
    ]
    to_picture = [
        [sum(row[i] * r[3 * i + j] for i in range(3)) for j in range(3)] for row in jacobian
    ]
    # The splat's axes in the picture, each as long as its standard deviation.
    axes = _rotation(quat)
    lengths = [math.exp(scale) for scale in scales]
    spread = [
        [lengths[k] * sum(row[j] * axes[j][k] for j in range(3)) for k in range(3)]
        for row in to_picture
    ]
    xx, xy, yy = (
        sum(p * q for p, q in zip(spread[a], spread[b], strict=True))
        for a, b in ((0, 0), (0, 1), (1, 1))
    )
    thickness, blur = _added(camera, kernel, mean)
    xx, yy = xx + thickness, yy + thickness
    before = xx * yy - xy * xy
    xx, yy = xx + blur, yy + blur
    after = xx * yy - xy * xy
    if not after > 0.0:
        return None
    opacity = 1.0 / (1.0 + math.exp(-logit[0]))
    if blur > 0.0:
        opacity *= math.sqrt(before / after)
    return _Ellipse(
        z,
        camera.fx * x / z + camera.cx,
        camera.fy * y / z + camera.cy,
        (xx, xy, yy),
        opacity,
        _colour(coefficients, mean, _position(camera)),
    )


def _rotation(quat: Vector) -> list[Vector]:
    """Return the rotation matrix of a unit quaternion w x y z, row by row."""
    w, x, y, z = quat
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def _colour(coefficients: Vector, mean: Vector, position: Vector) -> Vector:
    """Return the colour of a splat seen from a position (SPEC 2.3)."""
    distance = math.sqrt(_squared_distance(mean, position))
    x, y, z = ((m - o) / distance for m, o in zip(mean, position, strict=True))
    basis = [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]
    return [
        max(0.0, 0.5 + sum(b * c for b, c in zip(basis, coefficients[channel::3], strict=False)))
        for channel in range(3)
    ]


def _pixel(drawn: Sequence[_Ellipse], x: float, y: float) -> Vector:
    """Blend the splats, nearest first, at the centre of a pixel."""
    colour, transmittance = [0.0, 0.0, 0.0], 1.0
    for splat in drawn:
        xx, xy, yy = splat.covariance
        dx, dy = x - splat.x, y - splat.y
        square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
        alpha = min(_ALPHA_MOST, splat.opacity * math.exp(-square / 2))
        if alpha < _ALPHA_LEAST:
            continue
        if transmittance * (1 - alpha) < _TRANSMITTANCE_LEAST:
            break
        colour = [c + transmittance * alpha * s for c, s in zip(colour, splat.colour, strict=True)]
        transmittance *= 1 - alpha
    return colour
