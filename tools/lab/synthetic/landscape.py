"""Surroundings in the synthetic scene: terrace, meadow, hills, sky, and floaters in mid-air."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .lighting import sky_light
from .materials import COVER, Edges, Surfels, blend, concatenate, cover, split_count
from .object_models import object_pose
from .patches import Patch, annulus, any_tangents, lattice, noise, smoothstep, unit

F64 = NDArray[np.float64]

TERRACE_RADIUS = 3.3
_MEADOW_RADIUS = 12.0
_HILLS_RADIUS = 27.0
_SKY_RADIUS = 40.0


def terrace(n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of a round terrace: a chequerboard of two stones, a kerb, and petals."""
    stone, kerb, petals = split_count(n, (0.84, 0.14, 0.02))
    patch = annulus(0.0, TERRACE_RADIUS - 0.3, stone, rng)
    x, z = patch.points[:, 0], patch.points[:, 2]
    a, b = (x + z) / 0.62, (x - z) / 0.62
    column, row = np.floor(a), np.floor(b)
    to_a, to_b = (0.31 - 0.62 * np.abs(v - np.floor(v) - 0.5) for v in (a, b))
    to_a, to_b = to_a / np.sqrt(2.0), to_b / np.sqrt(2.0)
    edge = np.minimum(to_a, to_b)
    edges = Edges.none(patch)
    for distance, way in ((to_a, (1.0, 0.0, -1.0)), (to_b, (1.0, 0.0, 1.0))):
        edges = edges.nearer(np.abs(distance - 0.014), unit(np.array(way)))
    dark = (column + row) % 2.0
    ids = np.stack([column + 0.5, np.zeros(stone), row + 0.5], axis=1)
    grain = noise(patch.points, 3.1, 4, 1)
    veins = np.abs(noise(patch.points, 1.7, 4, 2) - 0.5) * 2.0
    light = blend((0.52, 0.40, 0.27), (0.80, 0.68, 0.52), 0.5 * noise(ids, 1.0, 1, 3) + 0.5 * grain)
    slate = blend((0.06, 0.11, 0.13), (0.16, 0.24, 0.25), 0.4 * noise(ids, 1.0, 1, 4) + 0.6 * grain)
    slate = blend((0.55, 0.6, 0.58), slate, smoothstep(0.0, 0.09, veins))
    albedo = np.where(dark[:, None] > 0.5, slate, light)
    # A joint narrower than a splat is drawn in proportion, so that few splats still show it.
    width = np.maximum(0.014, 0.35 * np.sqrt(patch.areas))
    joint = np.clip(1.0 - edge / width, 0.0, 1.0) * np.minimum(1.0, 0.02 / width)
    albedo = blend(albedo, (0.12, 0.10, 0.08), joint)
    shine = (0.10 + 0.30 * dark) * (1.0 - joint) * (0.6 + 0.8 * grain)
    tinted = shine[:, None] * np.array([1.0, 0.97, 0.92])
    parts = [cover(patch, rng, albedo, tinted, 0.14, edges=edges)]

    patch = annulus(TERRACE_RADIUS - 0.3, TERRACE_RADIUS, kerb, rng)
    block = patch.uv[:, 1] * (48.0 / (2.0 * np.pi))
    to_block = (0.5 - np.abs(block % 1.0 - 0.5)) * (2.0 * np.pi * TERRACE_RADIUS / 48.0)
    to_rim = 0.15 - np.abs(patch.uv[:, 0] - TERRACE_RADIUS + 0.15)
    edge = np.minimum(to_block, to_rim)
    edges = Edges(to_block, np.cross(patch.normals, patch.tangents))
    edges = edges.nearer(to_rim, patch.tangents)
    tint = noise(np.stack([np.floor(block)] * 3, axis=1) * 1.7, 1.0, 1, 5)
    albedo = blend((0.42, 0.20, 0.13), (0.62, 0.38, 0.26), tint)
    albedo *= (0.7 + 0.6 * noise(patch.points, 9.0, 3, 6))[:, None]
    albedo = blend((0.12, 0.10, 0.08), albedo, smoothstep(0.0, 0.02, edge))
    points = patch.points + np.array([0.0, 0.03, 0.0]) * smoothstep(0.0, 0.04, edge)[:, None]
    patch = Patch(points, patch.normals, patch.tangents, patch.areas, patch.uv)
    parts.append(cover(patch, rng, albedo, 0.06, 0.3, edges=edges))

    _, tree = object_pose("tree")
    spot = rng.standard_normal((petals, 3)) * np.array([0.5, 0.0, 0.5]) + np.array(tree)
    spot *= np.minimum(1.0, (TERRACE_RADIUS - 0.1) / np.hypot(spot[:, 0], spot[:, 2]))[:, None]
    parts.append(
        _petals(spot + np.array([0.0, 0.012, 0.0]), 0.020 * (450.0 / max(petals, 1)) ** 0.45, rng)
    )
    return concatenate(parts)


def _petals(points: F64, size: float, rng: np.random.Generator) -> Surfels:
    """Return surfels of fallen petals at given points."""
    n = len(points)
    normals = unit(rng.standard_normal((n, 3)) * 0.35 + np.array([0.0, 1.0, 0.0]))
    patch = Patch(points, normals, any_tangents(normals), np.full(n, size**2), points[:, :2])
    return cover(patch, rng, blend((0.80, 0.30, 0.42), (0.95, 0.72, 0.78), rng.random(n)))


def _height(x: F64, z: F64) -> F64:
    """Return the height of the ground beyond the terrace."""
    radius = np.hypot(x, z)
    flat = np.stack([x, np.zeros_like(x), z], axis=1)
    swell = smoothstep(TERRACE_RADIUS, TERRACE_RADIUS + 2.5, radius)
    bumps = (noise(flat, 0.55, 2, 11) - 0.45) * 0.30 * swell - 0.02
    return bumps + smoothstep(10.5, 22.0, radius) * (0.6 + 6.5 * noise(flat, 0.16, 3, 12) ** 1.6)


def _land(patch: Patch) -> Patch:
    """Return a flat ring lifted to the height of the ground."""
    x, z = patch.points[:, 0], patch.points[:, 2]
    y, step = _height(x, z), 0.05
    slope_x, slope_z = (_height(x + step, z) - y) / step, (_height(x, z + step) - y) / step
    normals = unit(np.stack([-slope_x, np.ones_like(x), -slope_z], axis=1))
    points = np.stack([x, y, z], axis=1)
    return Patch(points, normals, any_tangents(normals), patch.areas, patch.uv)


def meadow(n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of the grass around the terrace: turf, upright blades and flowers."""
    turf, blades, flowers = split_count(n, (0.52, 0.40, 0.08))
    patch = _land(annulus(TERRACE_RADIUS - 0.02, _MEADOW_RADIUS, turf, rng, 0.75))
    # Wider turf splats would look like fog in front of a low camera.
    patch = replace(patch, areas=np.minimum(patch.areas, (0.055 * patch.uv[:, 0] / COVER) ** 2))
    tone = noise(patch.points, 0.8, 4, 21)
    albedo = blend((0.055, 0.115, 0.02), (0.20, 0.27, 0.055), tone)
    albedo *= (0.75 + 0.5 * rng.random(turf))[:, None]
    parts = [cover(patch, rng, albedo, 0.05, 0.35)]

    patch = _land(annulus(TERRACE_RADIUS + 0.02, 8.0, blades, rng, 0.95))
    length = 0.055 * (12000.0 / max(blades, 1)) ** 0.25 * np.exp(0.35 * rng.standard_normal(blades))
    length *= np.sqrt(patch.uv[:, 0] / TERRACE_RADIUS)
    lean = unit(rng.standard_normal((blades, 3)) * 0.33 + np.array([0.0, 1.0, 0.0]))
    sideways = any_tangents(lean)
    albedo = blend((0.09, 0.17, 0.025), (0.34, 0.40, 0.09), noise(patch.points, 0.8, 3, 22))
    albedo *= (0.6 + 0.8 * rng.random(blades))[:, None]
    # A blade is lit like the surrounding turf, independent of its orientation.
    upright = unit(np.cross(sideways, lean) * 0.4 + np.array([0.0, 1.0, 0.0]))
    standing = Patch(
        patch.points + lean * (0.8 * length)[:, None], upright, lean, patch.areas, patch.uv
    )
    grass = cover(standing, rng, albedo, 0.08, 0.3)
    width = length * 0.13 * np.exp(0.3 * rng.standard_normal(blades))
    parts.append(
        Surfels(
            standing,
            np.stack([length, width, 0.3 * width], axis=1),
            grass.albedo,
            grass.gloss,
            grass.spread,
            grass.opacities_unit,
            grass.glow,
        )
    )

    patch = _land(annulus(TERRACE_RADIUS + 0.2, 7.5, flowers, rng, 0.9))
    drift = noise(patch.points, 0.45, 2, 23)
    angle = rng.random(flowers)
    spot = patch.points + np.array([0.0, 1.0, 0.0]) * (0.09 + 0.07 * angle)[:, None]
    palette = np.array(
        [[0.85, 0.10, 0.05], [0.95, 0.75, 0.10], [0.92, 0.90, 0.95], [0.38, 0.25, 0.80]]
    )
    kind = np.clip((drift - 0.2) * 6.6 + 0.7 * rng.standard_normal(flowers), 0.0, 3.99).astype(int)
    normals = unit(rng.standard_normal((flowers, 3)) * 0.5 + np.array([0.0, 1.0, 0.0]))
    size = 0.030 * (1500.0 / max(flowers, 1)) ** 0.45
    patch = Patch(
        spot, normals, any_tangents(normals), np.full(flowers, (size / COVER) ** 2), patch.uv
    )
    parts.append(cover(patch, rng, palette[kind] * (0.7 + 0.3 * angle)[:, None], 0.05, 0.3))
    return concatenate(parts)


def soil(n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of the soil under terrace and meadow, hidden like many real splats."""
    patch = annulus(0.0, 5.5, n, rng)
    # Deep enough that a splat nearer to the eye does not reach over the stones behind it.
    depth = max(0.32, 2.8 * float(np.sqrt(patch.areas[0])))
    points = patch.points - np.array([0.0, depth, 0.0])
    points[:, 1] += np.minimum(_height(points[:, 0], points[:, 2]), 0.0)
    earth = blend((0.09, 0.07, 0.045), (0.20, 0.16, 0.11), noise(points, 2.0, 2, 7))
    return cover(replace(patch, points=points, areas=1.2 * patch.areas), rng, earth)


def hills(n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of the surrounding hills, with fields and woods that fade into haze."""
    patch = _land(annulus(_MEADOW_RADIUS - 1.0, _HILLS_RADIUS, n, rng, 1.0))
    field = noise(patch.points * np.array([1.0, 0.0, 1.0]), 0.35, 1, 81)
    albedo = blend((0.10, 0.17, 0.035), (0.32, 0.30, 0.09), smoothstep(0.35, 0.65, field))
    wood = smoothstep(0.50, 0.58, noise(patch.points, 0.30, 3, 82))
    leaves = 0.6 + 0.8 * noise(patch.points, 3.0, 2, 83)
    albedo = blend(albedo, (0.035, 0.075, 0.025), wood) * leaves[:, None]
    haze = 0.75 * smoothstep(9.0, 30.0, patch.uv[:, 0])
    albedo = blend(albedo, (0.42, 0.50, 0.60), haze)
    return cover(patch, rng, albedo)


def sky(n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of the sky: a dome of large ones, and faint clouds in front of it."""
    dome, clouds = split_count(n, (0.55, 0.45))
    parts = []
    for count, radius, lowest, highest in (
        (dome, _SKY_RADIUS, -0.06, 1.0),
        (clouds, 0.9 * _SKY_RADIUS, 0.02, 0.75),
    ):
        uv = lattice(count, rng)
        y = lowest + (highest - lowest) * uv[:, 0]
        ring, angle = np.sqrt(1.0 - y * y), 2.0 * np.pi * uv[:, 1]
        away = np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1)
        # Far-off splats overlap more: nothing behind them fills a gap.
        area = 3.2 * np.pi * (highest - lowest) * radius**2 / max(count, 1)
        points = away * radius
        patch = Patch(points, -away, any_tangents(away), np.full(count, area), uv)
        light = sky_light(away)
        if radius == _SKY_RADIUS:
            parts.append(cover(patch, rng, light, glow=1.0))
            continue
        # Clouds lie in a flat layer, so they crowd towards the horizon.
        layer = away / (0.25 + y)[:, None] * np.array([1.0, 0.0, 1.0])
        density = smoothstep(0.47, 0.70, noise(layer, 0.9, 4, 84))
        white = blend(light, (2.0, 1.95, 1.9), 0.5 + 0.5 * density)
        faint = cover(patch, rng, white, glow=1.0)
        opacities_unit = np.clip(faint.opacities_unit * density * 0.6, 0.012, 0.99)
        parts.append(replace(faint, opacities_unit=opacities_unit))
    return concatenate(parts)


def floaters(n: int, rng: np.random.Generator) -> Surfels:
    """Return faint surfels in mid-air, like the floaters that training leaves."""
    radius, angle = 6.0 * np.sqrt(rng.random(n)), 2.0 * np.pi * rng.random(n)
    height = 0.1 + 2.6 * rng.random(n) ** 1.5
    points = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1)
    normals = unit(rng.standard_normal((n, 3)))
    areas = (0.08 * np.exp(0.8 * rng.standard_normal(n))) ** 2
    patch = Patch(points, normals, any_tangents(normals), areas, points[:, :2])
    albedo = 0.2 + 0.5 * rng.random((n, 1)) + 0.1 * rng.standard_normal((n, 3))
    dust = cover(patch, rng, np.clip(albedo, 0.02, 1.0), 0.05, 0.3)
    return replace(dust, opacities_unit=0.006 + 0.05 * rng.random(n) ** 3)
