"""Cottage of the synthetic scene, at the origin, with its front towards +z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .materials import Colour, Edges, Surfels, blend, concatenate, cover, split_count
from .patches import Patch, any_tangents, join_patches, noise, quad, smoothstep, unit

F64 = NDArray[np.float64]

# Half extents of the house's walls, their height, and the rise and overhang of the roof.
WALLS = (0.56, 0.44, 0.62)
ROOF_RISE, _OVERHANG = 0.50, 0.10
_BEAM: Colour = (0.10, 0.055, 0.03)
_BEAM_HALF_WIDTH = 0.027


def cottage(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of a half-timbered cottage with a tiled roof, lit windows and a chimney."""
    hx, hz, h = WALLS
    wall_areas = [2 * hx * h, 2 * hx * h, 2 * hz * h, 2 * hz * h]
    roof_area = 2 * (hx + _OVERHANG) * float(np.hypot(hz + _OVERHANG, ROOF_RISE * 1.2))
    gable = hz * ROOF_RISE
    counts = split_count(n, [*wall_areas, gable, gable, roof_area, roof_area, 0.2])
    walls = [
        ((-hx, 0.0, hz), (2 * hx, 0.0, 0.0)),
        ((hx, 0.0, -hz), (-2 * hx, 0.0, 0.0)),
        ((hx, 0.0, hz), (0.0, 0.0, -2 * hz)),
        ((-hx, 0.0, -hz), (0.0, 0.0, 2 * hz)),
    ]
    parts = []
    for i, (corner, along) in enumerate(walls):
        width = 2 * hx if i < 2 else 2 * hz
        parts.append(_wall(quad(corner, along, (0.0, h, 0.0), counts[i], rng), width, i == 0, rng))
    for i, (x, z) in enumerate(((hx, hz), (-hx, -hz))):
        patch = quad(
            (x, h, z), (0.0, 0.0, -2 * z), (0.0, ROOF_RISE, -z), counts[4 + i], rng, triangle=True
        )
        parts.append(_gable(patch, rng))
    slope = ROOF_RISE / hz
    low, wide = h - _OVERHANG * slope, hx + _OVERHANG
    for i, side in enumerate((1.0, -1.0)):
        patch = quad(
            (-side * wide, low + 0.02, side * (hz + _OVERHANG)),
            (side * 2 * wide, 0.0, 0.0),
            (0.0, ROOF_RISE + _OVERHANG * slope, -side * (hz + _OVERHANG)),
            counts[6 + i],
            rng,
        )
        parts.append(_tiles(patch, 2 * wide, rng))
    parts.append(_chimney(counts[8], rng))
    return concatenate(parts)


def _plaster(patch: Patch, middles: Edges, rng: np.random.Generator) -> Surfels:
    """Return surfels of a plastered wall with beams; `middles` are the beams' centre lines."""
    tone = noise(patch.points, 9.0, 4, 71)
    plaster = blend((0.66, 0.58, 0.44), (0.84, 0.79, 0.68), tone)
    beam = np.array(_BEAM) * (0.7 + 0.6 * noise(patch.points, 30.0, 2, 72))[:, None]
    from_beam = middles.distance - _BEAM_HALF_WIDTH
    albedo = blend(beam, plaster, smoothstep(-0.003, 0.003, from_beam))
    edges = Edges(np.abs(from_beam), middles.along)
    return cover(patch, rng, albedo, 0.03, 0.4, edges=edges)


def _sides(patch: Patch) -> tuple[F64, F64]:
    """Return unit vectors to the right and up along a wall, (n, 3) each."""
    return patch.tangents, np.cross(patch.normals, patch.tangents)


def _gable(patch: Patch, rng: np.random.Generator) -> Surfels:
    """Return surfels of a half-timbered gable."""
    right, up = _sides(patch)
    half = WALLS[1]
    lean = np.arctan2(ROOF_RISE, half)
    u, v = patch.uv[:, 0], patch.uv[:, 1]
    middles = Edges.none(patch).nearer(v * ROOF_RISE, right)
    middles = middles.nearer(np.abs(u + 0.5 * v - 0.5) * 2 * half, up)
    rafter = 2 * half * float(np.sin(lean))
    middles = middles.nearer(u * rafter, right * np.cos(lean) + up * np.sin(lean))
    middles = middles.nearer((1 - u - v) * rafter, up * np.sin(lean) - right * np.cos(lean))
    return _plaster(patch, middles, rng)


def _wall(patch: Patch, width: float, front: bool, rng: np.random.Generator) -> Surfels:
    """Return surfels of a half-timbered wall with windows, and a door in the front."""
    right, up = _sides(patch)
    height = WALLS[2]
    x, y = patch.uv[:, 0] * width, patch.uv[:, 1] * height
    bays = 4 if width > 1.0 else 3
    bay = width / bays
    middles = Edges.none(patch).nearer(np.minimum(y, height - y), right)
    middles = middles.nearer(np.abs((x / bay + 0.5) % 1.0 - 0.5) * bay, up)
    # A brace crosses the first bay, the mirrored one the last.
    diagonal = float(np.hypot(bay, height))
    for start, side in ((x, 1.0), (width - x, -1.0)):
        distance = np.abs(start * height - y * bay) / diagonal
        middles = middles.nearer(distance, (side * bay * right + height * up) / diagonal)
    wall = _plaster(patch, middles, rng)
    openings = [(bay * (i + 0.5), 0.37, 0.085, 0.125) for i in range(1, bays - 1)]
    for i, (centre, middle, half, tall) in enumerate(openings):
        if front and i == 1:
            wall = _door(wall, np.abs(x - centre), y, rng)
        else:
            wall = _window(wall, np.abs(x - centre), y - middle, half, tall)
    return wall


def _door(wall: Surfels, dx: F64, y: F64, rng: np.random.Generator) -> Surfels:
    """Return the wall with a door painted on it."""
    inside = (dx < 0.105) & (y < 0.45)
    planks = np.array([0.05, 0.17, 0.11]) * (0.75 + 0.25 * np.sign(np.sin(dx * 150.0)))[:, None]
    albedo = np.where(inside[:, None], planks * (0.9 + 0.2 * rng.random((len(y), 1))), wall.albedo)
    return replace(wall, albedo=albedo, gloss=np.where(inside[:, None], 0.25, wall.gloss))


def _window(wall: Surfels, dx: F64, dy: F64, half: float, tall: float) -> Surfels:
    """Return the wall with a lit window painted on it."""
    frame = ((dx < half) & (np.abs(dy) < tall))[:, None]
    pane = (dx < half - 0.016) & (np.abs(dy) < tall - 0.016)
    pane &= (dx > 0.007) & (np.abs(dy - 0.03) > 0.007)
    light = np.array([1.10, 0.62, 0.16]) * (1.0 - 1.6 * np.abs(dy))[:, None]
    albedo = np.where(frame, np.array([0.80, 0.76, 0.68]), wall.albedo)
    return replace(
        wall,
        albedo=np.where(pane[:, None], light, albedo),
        gloss=np.where(pane[:, None], 0.5, wall.gloss),
        glow=np.where(pane, 1.0, wall.glow),
    )


def _tiles(patch: Patch, width: float, rng: np.random.Generator) -> Surfels:
    """Return surfels of a tiled roof slope."""
    rows, columns = 11, 22
    row = np.floor(patch.uv[:, 1] * rows)
    down = patch.uv[:, 1] * rows - row
    column = patch.uv[:, 0] * columns + 0.5 * (row % 2.0)
    across = np.abs(column % 1.0 - 0.5) * 2.0
    ids = np.stack([np.floor(column), row, patch.normals[:, 2] * 40.0], axis=1)
    albedo = blend((0.30, 0.075, 0.035), (0.62, 0.22, 0.09), noise(ids + 0.5, 1.0, 1, 73))
    albedo *= (0.35 + 0.65 * smoothstep(0.0, 0.35, down) * smoothstep(1.02, 0.80, across))[:, None]
    moss = smoothstep(0.58, 0.75, noise(patch.points, 4.0, 3, 74))
    albedo = blend(albedo, (0.14, 0.17, 0.045), 0.7 * moss)
    raised = patch.points + patch.normals * (0.02 * (1.0 - down))[:, None]
    uphill = np.cross(patch.normals, patch.tangents)
    bent = unit(
        patch.normals + patch.tangents * (0.5 * np.sign(column % 1.0 - 0.5) * across**2)[:, None]
    )
    patch = Patch(raised, bent, any_tangents(bent), patch.areas, patch.uv)
    edges = Edges(width / columns * 0.5 * (1.0 - across), uphill)
    return cover(patch, rng, albedo, 0.16, 0.22, edges=edges)


def _chimney(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of the chimney."""
    x, z, r, low, high = 0.30, -0.16, 0.085, 0.78, 1.34
    tall = high - low
    counts = split_count(n, [tall, tall, tall, tall, 2 * r])
    sides = [
        quad((x - r, low, z + r), (2 * r, 0.0, 0.0), (0.0, tall, 0.0), counts[0], rng),
        quad((x + r, low, z - r), (-2 * r, 0.0, 0.0), (0.0, tall, 0.0), counts[1], rng),
        quad((x + r, low, z + r), (0.0, 0.0, -2 * r), (0.0, tall, 0.0), counts[2], rng),
        quad((x - r, low, z - r), (0.0, 0.0, 2 * r), (0.0, tall, 0.0), counts[3], rng),
        quad((x - r, high, z + r), (2 * r, 0.0, 0.0), (0.0, 0.0, -2 * r), counts[4], rng),
    ]
    patch = join_patches(sides)
    course = patch.points[:, 1] * 22.0
    brick = (patch.uv[:, 0] * 2.0 + 0.5 * (np.floor(course) % 2.0)) % 1.0
    mortar = smoothstep(0.12, 0.22, np.minimum(course % 1.0, brick))
    albedo = blend((0.45, 0.42, 0.38), (0.36, 0.11, 0.06), mortar)
    top = patch.normals[:, 1] > 0.5
    albedo[top] = (0.02, 0.02, 0.02)
    return cover(patch, rng, albedo * (0.7 + 0.6 * noise(patch.points, 20.0, 2, 75))[:, None])
