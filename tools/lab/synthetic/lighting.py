"""Lighting of the synthetic scene: shadows, ambient occlusion and gloss, baked into SH."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import sh

from .materials import Surfels
from .patches import dot, smoothstep, unit

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The light, y up, linear colours: an afternoon sun and the sky it leaves blue.
SUN_DIRECTION = np.array([-0.52, 0.66, 0.54]) / np.sqrt(0.52**2 + 0.66**2 + 0.54**2)
SUN_COLOUR = np.array([2.35, 2.02, 1.50])
SKY_COLOUR = np.array([0.30, 0.39, 0.56])
BOUNCE_COLOUR = np.array([0.22, 0.18, 0.13])

# From y up to the axes of SceneInfo's default, "RDF": half a turn about x.
TO_SCENE = np.array([1.0, -1.0, -1.0])

# Direction of a second, wide light in highlights: the bright sky opposite the sun.
_WINDOW_DIRECTION = np.array([0.55, 0.62, -0.56]) / np.sqrt(0.55**2 + 0.62**2 + 0.56**2)
_WINDOW_SPREAD = 0.34
_WINDOW_SHARE = 0.30
_RIM_SHARE = 0.22

# Rows of the basis by band.
_BANDS = ((0, 1), (1, 4), (4, 9), (9, 16))

# (1 - t)²(1 + t) in Legendre polynomials: 0 face on, 1 at grazing angles, never negative.
_RIM = (2.0 / 3.0, -2.0 / 5.0, -2.0 / 3.0, 2.0 / 5.0)

BLOCK = 8192
"""Rows per block of `bake`, so that intermediates fit in the cache."""


@dataclass(frozen=True, eq=False)
class Occluders:
    """Spheres and boxes that cast shadows in place of the objects.

    Parameters
    ----------
    balls : (m, 5) float64
        Centre, radius and share of light blocked.
    boxes : (k, 7) float64
        Centre, half extents and turn about +y in radians.
    """

    balls: F64
    boxes: F64


def tone_map(linear: F64) -> F64:
    """Return display colours in [0, 1) of linear light: exponential shoulder, then gamma 2."""
    result: F64 = np.sqrt(1.0 - np.exp(-linear))
    return result


def bake(surfels: Surfels, occluders: Occluders, rng: np.random.Generator) -> F32:
    """Return SH coefficients of the light that each surfel reflects.

    Parameters
    ----------
    surfels : Surfels
        n surfels.
    occluders : Occluders
        Shapes that cast shadows.
    rng : numpy.random.Generator
        Source of the noise that training leaves in the higher bands.

    Returns
    -------
    (n, 16, 3) float32
        SH coefficients in scene axes (x, -y, -z of the y-up axes), 3DGS basis, evaluated at the
        direction from camera to splat.
    """
    n = len(surfels.spread)
    coefficients = np.empty((n, 16, 3), np.float32)
    for start in range(0, n, BLOCK):
        rows = slice(start, min(start + BLOCK, n))
        coefficients[rows] = _bake_block(surfels, rows, occluders, rng)
    return coefficients


def _bake_block(
    surfels: Surfels, rows: slice, occluders: Occluders, rng: np.random.Generator
) -> F64:
    """Return the SH coefficients of a block of surfels, their lighting baked in."""
    points, normals = surfels.patch.points[rows], surfels.patch.normals[rows]
    albedo, glow = surfels.albedo[rows], surfels.glow[rows, None]
    open_sky = _ambient(points, normals, occluders)
    sunlit = _sunlight(points + 0.02 * normals, occluders)
    towards_sun = dot(normals, SUN_DIRECTION)

    up = 0.5 + 0.5 * normals[:, 1:2]
    ambient = (BOUNCE_COLOUR + up * (SKY_COLOUR - BOUNCE_COLOUR)) * open_sky[:, None]
    sun = SUN_COLOUR * (np.maximum(towards_sun, 0.0) * sunlit)[:, None]
    diffuse = tone_map(albedo * np.where(glow > 0.5, 1.0, ambient + sun))

    coefficients = highlights(
        normals, diffuse, surfels.gloss[rows], surfels.spread[rows], sunlit, open_sky
    )
    coefficients[:, 0] += (diffuse - 0.5) / sh.C0
    return coefficients + _training_noise(surfels.opacities_unit[rows], rng)


def highlights(
    normals: F64, diffuse: F64, gloss: F64, spread: F64, sunlit: F64, open_sky: F64
) -> F64:
    """Return SH coefficients of the highlights of surfels.

    Parameters
    ----------
    normals, diffuse, gloss : (n, 3) float64
        Unit normals, colour without highlights, and brightness of the highlight, display space.
    spread : (n,) float64
        Width of the sun's highlight; see `Surfels`.
    sunlit, open_sky : (n,) float64
        Shares of the sun and of the sky that reach each surfel.

    Returns
    -------
    (n, 16, 3) float64
        See `bake`.
    """
    towards_sun = dot(normals, SUN_DIRECTION)
    strength = (
        gloss * (sunlit * smoothstep(0.0, 0.3, towards_sun))[:, None],
        gloss
        * (_WINDOW_SHARE * open_sky * smoothstep(-0.3, 0.3, dot(normals, _WINDOW_DIRECTION)))[
            :, None
        ],
        gloss * (_RIM_SHARE * open_sky)[:, None],
    )
    # Highlights are limited to the headroom between diffuse colour and 1.
    total = strength[0] + strength[1] + strength[2]
    fit = np.minimum(1.0, np.maximum(1.0 - diffuse, 0.0) / np.maximum(total, 1e-9))

    coefficients = np.zeros((len(normals), 16, 3))
    lobes = (
        (_mirrored(SUN_DIRECTION, normals), _lobe_weights(spread)),
        (_mirrored(_WINDOW_DIRECTION, normals), _lobe_weights(np.full(1, _WINDOW_SPREAD))),
        (normals, np.array([[b / (2 * band + 1) for band, b in enumerate(_RIM)]])),
    )
    for amount, (axis, weights) in zip(strength, lobes, strict=True):
        lit = np.flatnonzero(amount.max(axis=1) > 1e-4)
        # The highlight is visible to a camera that looks against the mirrored light.
        basis = sh.basis(-axis[lit] * TO_SCENE, 3)
        of_row = weights[lit] if len(weights) > 1 else weights
        for band, (first, last) in enumerate(_BANDS):
            basis[:, first:last] *= 4.0 * np.pi * of_row[:, band : band + 1]
        coefficients[lit] += basis[:, :, None] * (amount[lit] * fit[lit])[:, None, :]
    return coefficients


def _training_noise(opacities_unit: F64, rng: np.random.Generator) -> F64:
    """Return noise for bands 1 to 3, stronger for fainter splats, as training leaves it."""
    n = len(opacities_unit)
    sigma = (0.010 + 0.06 * (1.0 - opacities_unit) ** 2) * np.exp(0.5 * rng.standard_normal(n))
    values = np.zeros((n, 16, 3))
    values[:, 1:] = rng.standard_normal((n, 15, 3), dtype=np.float32)
    # Most of a splat's noise is brightness, which the channels share.
    values[:, 1:] = 0.6 * values[:, 1:] + 0.8 * values[:, 1:, 1:2]
    return values * np.minimum(sigma, 0.15)[:, None, None]


def _mirrored(light: F64, normals: F64) -> F64:
    """Reflect the direction of the light at each normal."""
    return 2.0 * dot(normals, light)[:, None] * normals - light


def _lobe_weights(spread: F64) -> F64:
    """Return (n, 4) weights of the bands for a heat-kernel lobe that peaks at 1."""
    bands = np.arange(4)
    decay = np.exp(-bands * (bands + 1) * spread[:, None])
    result: F64 = decay / (decay * (2 * bands + 1)).sum(axis=1, keepdims=True)
    return result


def _ambient(points: F64, normals: F64, occluders: Occluders) -> F64:
    """Return the unoccluded share of the hemisphere above each point, (n,)."""
    open_sky = np.ones(len(points))
    balls = [tuple(ball) for ball in occluders.balls]
    for x, y, z, hx, hy, hz, _ in occluders.boxes:
        balls.append((x, y, z, 1.15 * (hx * hy * hz) ** (1.0 / 3.0), 1.0))
    for x, y, z, radius, stopped in balls:
        dx, dy, dz = x - points[:, 0], y - points[:, 1], z - points[:, 2]
        squared = np.maximum(dx * dx + dy * dy + dz * dz, 1e-6)
        facing = dx * normals[:, 0] + dy * normals[:, 1] + dz * normals[:, 2]
        facing = np.maximum(facing / np.sqrt(squared), 0.0)
        open_sky *= 1.0 - 0.9 * stopped * facing * np.minimum(radius * radius / squared, 1.0)
    # Occlusion by the ground depends on height and on how far the surface faces down.
    near = np.exp(-2.2 * np.maximum(points[:, 1], 0.0))
    result: F64 = open_sky * (1.0 - 0.45 * near * np.maximum(0.35 - normals[:, 1], 0.0))
    return result


def _sunlight(points: F64, occluders: Occluders) -> F64:
    """Return the share of the sun that reaches each point, (n,), penumbra included."""
    share = np.ones(len(points))
    lx, ly, lz = SUN_DIRECTION
    for x, y, z, radius, stopped in occluders.balls:
        dx, dy, dz = x - points[:, 0], y - points[:, 1], z - points[:, 2]
        ahead = dx * lx + dy * ly + dz * lz
        aside = np.sqrt(np.maximum(dx * dx + dy * dy + dz * dz - ahead * ahead, 0.0))
        soft = 0.03 + 0.07 * np.maximum(ahead, 0.0)
        t = np.clip((aside - radius + soft) / (2.0 * soft), 0.0, 1.0)
        share *= np.where(ahead > 0.0, 1.0 - stopped * (1.0 - t * t * (3.0 - 2.0 * t)), 1.0)
    for *centre, hx, hy, hz, turn in occluders.boxes:
        c, s = np.cos(turn), np.sin(turn)
        to_box = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        local = _rotate(points - np.array(centre), to_box)
        ray = _rotate(SUN_DIRECTION[None, :], to_box)[0]
        enter, leave = np.full(len(points), -np.inf), np.full(len(points), np.inf)
        for axis, half in enumerate((hx, hy, hz)):
            slope = ray[axis] if abs(ray[axis]) > 1e-6 else 1e-6
            a, b = (-half - local[:, axis]) / slope, (half - local[:, axis]) / slope
            enter = np.maximum(enter, np.minimum(a, b))
            leave = np.minimum(leave, np.maximum(a, b))
        inside = np.where(leave > 0.0, leave - np.maximum(enter, 0.0), 0.0)
        share *= 1.0 - smoothstep(0.0, 0.12, inside)
    return share


def _rotate(vectors: F64, matrix: F64) -> F64:
    """Return ``vectors @ matrix.T`` summed in a fixed order."""
    return np.stack([dot(vectors, matrix[i]) for i in range(3)], axis=1)


def sky_light(direction: F64) -> F64:
    """Return the linear colour of the clear sky in (n, 3) unit directions, y up."""
    height = np.clip(direction[:, 1], 0.0, 1.0)[:, None]
    horizon, zenith = np.array([0.72, 0.95, 1.10]), np.array([0.05, 0.22, 0.80])
    sky = horizon + (zenith - horizon) * np.power(height, 0.45)
    towards_sun = np.clip(dot(unit(direction), SUN_DIRECTION), 0.0, 1.0)[:, None]
    result: F64 = sky + np.array([1.2, 0.95, 0.6]) * towards_sun**24
    return result
