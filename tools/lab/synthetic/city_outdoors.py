"""Ground, trees and lamps of a city block as elements."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .city_cover import hashed, normal_numbers, sheet, uneven
from .city_light import Elements, LightMap
from .city_panels import frames_of
from .city_plan import BLOCK_SIDE, HALF_ROAD, HALF_STREET, KERB, Block, Use
from .materials import split_count
from .patches import R2, any_tangents, unit

F32 = NDArray[np.float32]

_FLAT: Final = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0], np.float32)


def ground(block: Block, maps: LightMap, n: int, rng: np.random.Generator) -> Elements:
    """Return n elements of roads, pavements and the ground between the houses."""
    more, start = 1.3, rng.random(2)
    while True:
        number = np.arange(int(more * n) + 64)
        x = ((number * R2[0] + start[0]) % 1.0 * BLOCK_SIDE).astype(np.float32)
        z = ((number * R2[1] + start[1]) % 1.0 * BLOCK_SIDE).astype(np.float32)
        free = np.flatnonzero(~maps.built.ravel()[maps.cells(x, z)])
        if len(free) >= n:
            break
        more *= 1.3
    side = BLOCK_SIDE / float(np.sqrt(len(number)))
    kept = free[(np.arange(n) * (len(free) / n)).astype(np.int64)]
    x, z = x[kept], z[kept]
    near_x, near_z = np.minimum(x, BLOCK_SIDE - x), np.minimum(z, BLOCK_SIDE - z)
    near = np.minimum(near_x, near_z)
    road, street = near < HALF_ROAD, near < HALF_STREET
    mottle, grain = uneven(x, z), normal_numbers(n, rng)
    slow = np.sin(0.19 * x + 0.31 * z) * np.sin(0.23 * z - 0.11 * x + 1.0)
    grey = 0.075 + 0.012 * mottle + 0.006 * grain + 0.012 * slow
    # Tyres polish two tracks in each lane.
    grey = np.where(road, grey - 0.014 * np.exp(-((near % 1.6 - 0.8) ** 2) / 0.06), grey)
    albedo = grey[:, None] * np.array([1.0, 1.0, 1.04], np.float32)
    slab = hashed(np.floor(x / 1.2), np.floor(z / 1.2))
    paved = (0.30 + 0.10 * slab + 0.03 * mottle + 0.015 * grain)[:, None] * np.array(
        [1.0, 0.95, 0.86], np.float32
    )
    joint = np.minimum(np.abs(x % 1.2 - 0.6), np.abs(z % 1.2 - 0.6)) > 0.52
    paved = np.where(joint[:, None], 0.7 * paved, paved)
    grass = (
        np.array([0.07, 0.13, 0.03], np.float32)
        * (1.0 + 0.35 * mottle + 0.2 * grain + 0.25 * slow)[:, None]
    )
    path_distance = np.minimum(
        np.minimum(np.abs(x - 32.0), np.abs(z - 32.0)),
        np.abs(np.hypot(x - 32.0, z - 32.0) - 14.0),
    )
    sand = (0.42 + 0.05 * mottle + 0.02 * grain)[:, None] * np.array([1.0, 0.82, 0.6], np.float32)
    if block.use is Use.TOWER:
        wide = hashed(np.floor(x / 3.0), np.floor(z / 3.0))
        inner = (0.34 + 0.16 * wide + 0.03 * mottle)[:, None] * np.array(
            [1.0, 0.97, 0.92], np.float32
        )
    elif block.use is Use.PARK:
        inner = np.where((path_distance < 1.5)[:, None], sand, grass)
    elif block.use is Use.ROWS:
        inner = np.where((np.abs(x % 12.0 - 1.5) < 0.7)[:, None], paved, grass)
    else:
        inner = np.where((path_distance < 0.9)[:, None], sand, grass)
    kerb = np.abs(near - HALF_ROAD - 0.15) < 0.15
    albedo = np.where(street[:, None], np.where(road[:, None], albedo, paved), inner)
    albedo = np.where(kerb[:, None], np.float32(0.46) + 0.03 * grain[:, None], albedo)
    y = np.where(road, np.float32(0.0), np.float32(KERB))
    edge = np.minimum(np.abs(near - HALF_ROAD), np.abs(near - HALF_ROAD - 0.3))
    edge = np.minimum(edge, np.abs(near - HALF_STREET))
    angle = np.where(near_x < near_z, np.float32(0.5 * np.pi), np.float32(0.0))
    up = np.zeros((n, 3), np.float32)
    up[:, 1] = 1.0
    return sheet(
        np.stack([x, y, z], axis=1).astype(np.float32),
        np.broadcast_to(_FLAT, (n, 4)),
        up,
        side,
        np.clip(albedo, 0.01, 0.9).astype(np.float32),
        rng,
        edge,
        angle,
    )


def leaves(block: Block, n: int, rng: np.random.Generator) -> Elements:
    """Return n elements of the crowns of a block's trees, in clumps of leaves."""
    trees = np.array([(t.x, t.middle, t.z, t.radius, t.hue) for t in block.trees], np.float32)
    counts = np.array(split_count(n, [float(r * r) for r in trees[:, 3]]), np.int64)
    of = np.repeat(np.arange(len(trees)), counts)
    clump = rng.integers(0, 9, n)
    # A golden spiral of clumps, turned for each tree.
    rise = 1.0 - 2.0 * (clump + 0.5) / 9.0
    angle = clump * 2.399963 + 40.0 * trees[of, 4]
    ring = np.sqrt(1.0 - rise * rise)
    middle = 0.58 * np.stack([ring * np.cos(angle), 0.8 * rise, ring * np.sin(angle)], axis=1)
    away = rng.standard_normal((n, 3), dtype=np.float32)
    away /= np.sqrt((away * away).sum(axis=1, keepdims=True)) + np.float32(1e-6)
    depth = np.cbrt(0.2 + 0.8 * rng.random(n, dtype=np.float32))
    local = (middle + 0.46 * away * depth[:, None]).astype(np.float32)
    points = trees[of, :3] + local * trees[of, 3:4]
    normals = away + np.float32(0.8) * local
    normals += np.float32(0.4) * rng.standard_normal((n, 3), dtype=np.float32)
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True)) + np.float32(1e-6)
    frames = rng.standard_normal((n, 4), dtype=np.float32)
    frames /= np.sqrt((frames * frames).sum(axis=1, keepdims=True)) + np.float32(1e-6)
    green = np.array([0.055, 0.125, 0.022], np.float32)
    other = np.array([0.16, 0.19, 0.03], np.float32)
    albedo = green + (other - green) * (0.7 * trees[of, 4:5] + 0.3 * rng.random((n, 1)))
    inside = np.sqrt((local * local).sum(axis=1))
    albedo = albedo * (0.35 + 0.75 * inside + 0.25 * local[:, 1])[:, None]
    area = float((trees[:, 3] ** 2).sum()) * 4.0 * np.pi
    size = np.float32(0.62 * np.sqrt(area / n)) * np.exp(0.3 * normal_numbers(n, rng))
    sizes = size[:, None] * np.array([0.8, 0.5, 0.14], np.float32)
    return Elements(
        points,
        frames,
        sizes.astype(np.float32),
        normals,
        np.clip(albedo * 1.3, 0.01, 0.9).astype(np.float32),
        (0.96 - 0.4 * rng.random(n, dtype=np.float32) ** 2).astype(np.float32),
    )


def sticks(block: Block, rng: np.random.Generator) -> Elements:
    """Return the elements of trunks and lamps, each a chain of long thin ones."""
    ends: list[tuple[float, ...]] = []
    for tree in block.trees:
        top, thick = tree.middle, 0.05 + 0.03 * tree.radius
        ends.append((tree.x, KERB, tree.z, tree.x, top, tree.z, thick, 0.09, 0.06, 0.04))
        for i in range(3):
            angle = 2.1 * i + 30.0 * tree.hue
            reach = 0.55 * tree.radius
            tip = (tree.x + reach * np.cos(angle), top + 0.2, tree.z + reach * np.sin(angle))
            ends.append((tree.x, 0.6 * top, tree.z, *tip, 0.5 * thick, 0.09, 0.06, 0.04))
    for lamp in block.lamps:
        x, z, top = lamp.x, lamp.z, 6.0
        tip_x, tip_z = x + 1.4 * lamp.arm_x, z + 1.4 * lamp.arm_z
        ends.append((x, KERB, z, x, top, z, 0.05, 0.06, 0.08, 0.07))
        ends.append((x, top, z, tip_x, top + 0.3, tip_z, 0.04, 0.06, 0.08, 0.07))
        inner_x, inner_z = x + 0.9 * lamp.arm_x, z + 0.9 * lamp.arm_z
        ends.append((inner_x, top + 0.12, inner_z, tip_x, top + 0.2, tip_z, 0.10, 0.9, 0.9, 0.85))
    rows = np.array(ends).reshape(-1, 10)
    first, last = rows[:, :3], rows[:, 3:6]
    length = np.linalg.norm(last - first, axis=1)
    links = np.maximum(2, np.ceil(length / 0.45)).astype(np.int64)
    of = np.repeat(np.arange(len(rows)), 2 * links)
    number = np.arange(len(of)) - np.repeat(np.cumsum(2 * links) - 2 * links, 2 * links)
    share = (number // 2 + 0.5) / links[of]
    along = unit(last - first)[of]
    across = any_tangents(along)
    angle = np.pi * (number % 2) + 2.4 * (number // 2)
    out = unit(across * np.cos(angle)[:, None] + np.cross(along, across) * np.sin(angle)[:, None])
    thick = rows[of, 6]
    points = first[of] + (last - first)[of] * share[:, None] + out * (0.4 * thick)[:, None]
    n = len(of)
    tone = 1.0 + 0.15 * rng.standard_normal((n, 1))
    sizes = np.stack([0.75 * length[of] / links[of], 0.6 * thick, 0.4 * thick], axis=1)
    return Elements(
        points.astype(np.float32),
        frames_of(along, np.cross(out, along), out),
        sizes.astype(np.float32),
        out.astype(np.float32),
        np.clip(rows[of, 7:10] * tone, 0.01, 0.95).astype(np.float32),
        (0.97 - 0.15 * rng.random(n, dtype=np.float32) ** 2).astype(np.float32),
    )
