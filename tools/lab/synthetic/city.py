"""Synthetic city of any size, made block by block.

Its streets, houses, towers, parks and trees show what captures of cities show: most of the scene is
hidden from any place on the ground, half of it from above, and far away a house is a few pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, empty

from . import city_outdoors as outdoors
from . import city_surfaces as surfaces
from . import landscape
from .city_light import Elements, bake_elements, light_map
from .city_panels import Kind, block_panels, panel_table
from .city_plan import HALF_ROAD, City, plan_city
from .lighting import Occluders
from .materials import Surfels, blend, concatenate, cover, split_count
from .patches import Patch, any_tangents, noise, smoothstep
from .terrace import splats_from_surfels

F64 = NDArray[np.float64]

# Splats of the land around the city and of the sky: a share of small cities, and a limit.
_AROUND_SHARE: Final = 0.08
_AROUND_LIMIT: Final = 120_000

# Radius of the dome of `landscape.sky`, and where its hills begin.
_DOME, _HILLS = 40.0, 11.0


def city_parts(splats: int, seed: int = 7, sh_degree: int = 3) -> Iterator[Splats]:
    """Generate a city in parts: the land around it and the sky, then one block at a time.

    Parameters
    ----------
    splats : int
        Number of splats in all parts together, at least 1; the city grows by a block of 64 m for
        each `city_plan.SPLATS_PER_BLOCK`.
    seed : int
        Seed; equal seeds give equal bytes on one platform.
    sh_degree : int
        SH degree, 0 to 3; a lower degree truncates the same scene.

    Yields
    ------
    Splats
        Rows of a part, in no particular order, axes "RDF", scene units of a metre. About 150,000
        splats are in memory at a time, whatever the size of the city.

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """
    if not 0 <= sh_degree <= MAX_SH_DEGREE:
        raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
    if splats < 1:
        raise ValueError(f"{splats} splats, expected at least 1")
    city = plan_city(splats, seed)
    around = min(round(_AROUND_SHARE * splats), _AROUND_LIMIT)
    yield _surroundings(city, around, np.random.default_rng([seed, 1]), sh_degree)
    counts = split_count(splats - around, [block.weight for block in city.blocks])
    for number, count in enumerate(counts):
        if count:
            yield _block(city, number, count, seed, sh_degree)


def _block(city: City, number: int, count: int, seed: int, sh_degree: int) -> Splats:
    """Return the splats of a block."""
    rng = np.random.default_rng([seed, 2, number])
    noise = [np.random.default_rng([seed, 2, number, band]) for band in range(1, 4)]
    block = city.blocks[number]
    maps = light_map(city.around(number))
    table = panel_table(block_panels(block))
    walled = table.kind == Kind.WALL
    parts: list[Elements] = [outdoors.sticks(block, rng)]
    if walled.any():
        parts += surfaces.windows(table, rng)
    fixed = sum(len(part.points) for part in parts)
    if fixed > count // 3:
        # Few splats leave room for a part of the windows, trunks and lamps only.
        share = (count // 3) / fixed
        parts = [part.take(np.flatnonzero(rng.random(len(part.points)) < share)) for part in parts]
        fixed = sum(len(part.points) for part in parts)
    open_ground = float((~maps.built).mean()) * 64.0**2
    crowns = sum(tree.radius**2 for tree in block.trees)
    weights = (
        0.8 * float((table.width * table.height)[walled].sum()),
        surfaces.panel_area(table),
        0.8 * open_ground,
        12.0 * crowns,
    )
    walls, panels, ground, leaves = split_count(count - fixed, weights)
    if walls:
        parts.append(surfaces.walls(table, walls, rng))
    if panels:
        parts += surfaces.panels(table, panels, rng)
    if ground:
        parts.append(outdoors.ground(block, maps, ground, rng))
    if leaves:
        parts.append(outdoors.leaves(block, leaves, rng))
    made = empty(sh_degree, count)
    order = rng.permutation(count)
    start = 0
    for part in parts:
        rows = slice(start, start + len(part.points))
        bake_elements(part, maps, made.take(rows), city.corner(number), rng, noise)
        start += len(part.points)
    return made.take(order)


def _surroundings(city: City, n: int, rng: np.random.Generator, sh_degree: int) -> Splats:
    """Return the splats of the fields and hills around a city, and of the sky."""
    reach = float(np.hypot(city.half_x, city.half_z)) + 60.0
    grow = 1.6 * reach / _HILLS
    fields, hills, sky = split_count(n, (0.3, 0.3, 0.4))
    parts = []
    if fields:
        parts.append(_fields(city, 1.02 * grow * _HILLS, fields, rng))
    if hills:
        # Low hills: those of the landscape are as high as mountains at this size.
        parts.append(_grown(landscape.hills(hills, rng), np.array([grow, 0.25 * grow, grow])))
    if sky:
        parts.append(_grown(landscape.sky(sky, rng), np.full(3, grow)))
    if not parts:
        return empty(sh_degree, 0)
    surfels = concatenate(parts)
    nothing = Occluders(np.zeros((0, 5)), np.zeros((0, 7)))
    return splats_from_surfels(surfels, nothing, rng, sh_degree, rng.permutation(n))


def _grown(surfels: Surfels, by: F64) -> Surfels:
    """Return surfels scaled about the origin, positions and sizes."""
    patch = replace(surfels.patch, points=surfels.patch.points * by)
    return replace(surfels, patch=patch, sizes=surfels.sizes * by[0])


def _fields(city: City, outer: float, n: int, rng: np.random.Generator) -> Surfels:
    """Return surfels of the fields from the city's edge to the hills."""
    half = np.array([city.half_x, city.half_z])
    # Rings of the city's shape, closer together near the city.
    uv = rng.random((n, 2))
    ring = (outer / half.min()) ** uv[:, 0]
    around = 4.0 * uv[:, 1]
    along = 2.0 * (around % 1.0) - 1.0
    side = np.floor(around)
    x = np.where(side == 0, 1.0, np.where(side == 1, -1.0, along)) * half[0] * ring
    z = np.where(side < 2, along, np.where(side == 2, 1.0, -1.0)) * half[1] * ring
    points = np.stack([x, np.full(n, -0.05), z], axis=1)
    normals = np.tile([0.0, 1.0, 0.0], (n, 1))
    per_point = 8.0 * half[0] * half[1] * np.log(outer / half.min()) * ring**2 / n
    patch = Patch(points, normals, any_tangents(normals), 1.6 * per_point, uv)
    field = noise(np.floor(points / 37.0) * 1.7, 1.0, 1, 5)
    albedo = blend((0.06, 0.12, 0.03), (0.30, 0.28, 0.09), smoothstep(0.2, 0.8, field))
    albedo *= (0.85 + 0.3 * rng.random(n))[:, None]
    # The outer halves of the last streets.
    beyond = np.maximum(np.abs(x) - half[0], np.abs(z) - half[1])
    albedo = np.where((beyond < HALF_ROAD)[:, None], 0.08, albedo)
    return cover(patch, rng, albedo)
