"""Walls, floors and furniture of rooms: flat and lathed pieces with their paint.

Lengths are metres, y is up. Paint is a function of the position in the house, so that pieces of one
wall join without a seam.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .materials import Colour, Edges, Surfels, blend, cover
from .patches import Patch, noise, quad, revolve, smooth_curve, smoothstep

F64 = NDArray[np.float64]
Point = tuple[float, float, float]
Paint = Callable[[Patch, Edges, np.random.Generator], Surfels]


@dataclass(frozen=True)
class Piece:
    """A part of a room from which surfels are made.

    Parameters
    ----------
    area : float
        Weight for the number of splats: surface in m² times a factor for detail.
    make : callable
        ``make(count, rng)`` returns `count` surfels.
    """

    area: float
    make: Callable[[int, np.random.Generator], Surfels]


def face(corner: Point, u: Point, v: Point, paint: Paint, detail: float = 1.0) -> Piece:
    """Return a parallelogram that faces the direction u × v.

    Its splats do not cross its edges.
    """
    sides = np.array([u, v])
    lengths = np.sqrt((sides * sides).sum(axis=1))
    across = sides / lengths[:, None]
    area = float(np.linalg.norm(np.cross(sides[0], sides[1])))

    def make(n: int, rng: np.random.Generator) -> Surfels:
        patch = quad(corner, u, v, n, rng)
        edges = Edges.none(patch)
        for axis in range(2):
            share = patch.uv[:, axis]
            edges = edges.nearer(np.minimum(share, 1.0 - share) * lengths[axis], across[1 - axis])
        return paint(patch, edges, rng)

    return Piece(area * detail, make)


def box(low: Point, high: Point, paint: Paint, detail: float = 2.0) -> list[Piece]:
    """Return the five visible sides of a box; its bottom is left out."""
    pieces = []
    size = [b - a for a, b in zip(low, high, strict=True)]
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        u = _along(first, size[first])
        v = _along(second, size[second])
        far = (
            high[0] if axis == 0 else low[0],
            high[1] if axis == 1 else low[1],
            high[2] if axis == 2 else low[2],
        )
        pieces.append(face(far, u, v, paint, detail))
        if axis != 1:
            pieces.append(face(low, v, u, paint, detail))
    return pieces


def _along(axis: int, length: float) -> Point:
    """Return a vector of given length along an axis."""
    return (
        length if axis == 0 else 0.0,
        length if axis == 1 else 0.0,
        length if axis == 2 else 0.0,
    )


def lathe(
    outline: list[tuple[float, float]], foot: Point, paint: Paint, detail: float = 2.0
) -> Piece:
    """Return a surface of revolution; `outline` is (radius, height), `foot` the axis' lower end."""
    profile = smooth_curve([*outline])
    steps = np.diff(profile, axis=0)
    rings = np.pi * (profile[:-1, 0] + profile[1:, 0])
    area = float((rings * np.hypot(steps[:, 0], steps[:, 1])).sum())

    def make(n: int, rng: np.random.Generator) -> Surfels:
        patch = revolve(profile, n, rng).move(0.0, foot)
        return paint(patch, Edges.none(patch), rng)

    return Piece(area * detail, make)


def _distance_along_wall(patch: Patch) -> F64:
    """Return the horizontal distance of each point along its wall, metres, from any origin."""
    return np.asarray(patch.points[:, 0] + patch.points[:, 2])


def plaster(colour: Colour, salt: int) -> Paint:
    """Return the paint of a wall of one colour, slightly uneven."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        tone = 0.88 + 0.24 * noise(patch.points, 2.5, 3, salt)
        return cover(patch, rng, np.array(colour) * tone[:, None], 0.02, 0.4, edges=edges)

    return paint


def wallpaper(ground: Colour, figure: Colour, salt: int) -> Paint:
    """Return a wallpaper with stripes and rows of dots."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        along, height = _distance_along_wall(patch) / 0.36, patch.points[:, 1] / 0.36
        stripe = smoothstep(0.30, 0.34, np.abs(along % 1.0 - 0.5))
        across = np.hypot((along + 0.5) % 1.0 - 0.5, (height + salt * 0.13) % 1.0 - 0.5)
        dot = smoothstep(0.20, 0.16, across)
        albedo = blend(ground, figure, np.maximum(0.35 * stripe, dot))
        albedo = albedo * (0.92 + 0.16 * noise(patch.points, 3.0, 2, salt))[:, None]
        return cover(patch, rng, albedo, 0.03, 0.4, edges=edges)

    return paint


def bricks(brick: Colour, salt: int) -> Paint:
    """Return the paint of a bare brick wall."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        course = patch.points[:, 1] / 0.14
        along = _distance_along_wall(patch) / 0.30 + 0.5 * (np.floor(course) % 2.0)
        gap = np.minimum(
            0.14 * np.minimum(course % 1.0, 1.0 - course % 1.0),
            0.30 * np.minimum(along % 1.0, 1.0 - along % 1.0),
        )
        ids = np.stack([np.floor(along), np.floor(course), np.full(len(along), 0.5)], axis=1)
        tone = 0.6 + 0.8 * noise(ids + 0.5, 1.0, 1, salt)
        stone = np.array(brick) * tone[:, None]
        albedo = blend((0.50, 0.48, 0.44), stone, smoothstep(0.006, 0.014, gap))
        return cover(patch, rng, albedo, 0.02, 0.4, edges=edges)

    return paint


def planks(light: Colour, dark: Colour, salt: int, turned_by: bool = False) -> Paint:
    """Return the paint of wooden boards, 14 cm wide, for floors and furniture."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        x, y, z = patch.points.T
        across, along = (x + y, z) if turned_by else (z + y, x)
        board = across / 0.14
        joint = along / 1.1 + 0.37 * np.floor(board)
        ids = np.stack([np.floor(board), np.floor(joint), np.zeros(len(x))], axis=1)
        grain = np.stack([across * 24.0, along * 2.0, 3.0 * ids[:, 0] + 7.0 * ids[:, 1]], axis=1)
        tone = 0.5 * noise(ids + 0.5, 1.0, 1, salt) + 0.5 * noise(grain, 1.0, 3, salt + 1)
        gap = 0.14 * np.minimum(board % 1.0, 1.0 - board % 1.0)
        albedo = blend(dark, light, tone) * (0.45 + 0.55 * smoothstep(0.0, 0.006, gap))[:, None]
        return cover(patch, rng, albedo, 0.22, 0.16, edges=edges)

    return paint


def tiles(one: Colour, other: Colour, salt: int) -> Paint:
    """Return the paint of a floor of square tiles in two colours."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        x, z = patch.points[:, 0] / 0.42, patch.points[:, 2] / 0.42
        odd = (np.floor(x) + np.floor(z)) % 2.0
        veins = np.abs(noise(patch.points, 4.0, 4, salt) - 0.5) * 2.0
        albedo = blend(one, other, odd) * (0.75 + 0.25 * smoothstep(0.0, 0.3, veins))[:, None]
        gap = 0.42 * np.minimum(
            np.minimum(x % 1.0, 1.0 - x % 1.0), np.minimum(z % 1.0, 1.0 - z % 1.0)
        )
        albedo *= (0.55 + 0.45 * smoothstep(0.003, 0.009, gap))[:, None]
        return cover(patch, rng, albedo, 0.30, 0.12, edges=edges)

    return paint


def rug(ground: Colour, figure: Colour, salt: int) -> Paint:
    """Return the paint of a woven rug with a border and lozenges, scaled to its face."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        u, v = patch.uv[:, 0], patch.uv[:, 1]
        rim = np.minimum(np.minimum(u, 1.0 - u), np.minimum(v, 1.0 - v))
        lozenge = np.abs((6.0 * u) % 1.0 - 0.5) + np.abs((4.0 * v) % 1.0 - 0.5)
        inside = smoothstep(0.46, 0.40, lozenge)
        border = smoothstep(0.05, 0.06, rim) * smoothstep(0.12, 0.11, rim)
        share = np.where(rim > 0.13, inside, border)
        woven = 0.75 + 0.5 * noise(patch.points, 40.0, 1, salt)
        albedo = blend(ground, figure, share) * woven[:, None]
        return cover(patch, rng, albedo, 0.0, 0.4, edges=edges)

    return paint


def fabric(colour: Colour, salt: int) -> Paint:
    """Return the paint of cloth of one colour with folds."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        fold = noise(patch.points, 6.0, 2, salt)
        weave = noise(patch.points, 45.0, 1, salt + 3)
        albedo = np.array(colour) * (0.55 + 0.6 * fold + 0.25 * weave)[:, None]
        return cover(patch, rng, albedo, 0.04, 0.4, edges=edges)

    return paint


def books(salt: int) -> Paint:
    """Return the paint of book spines on shelves 32 cm apart."""
    spines = np.array(
        [[0.45, 0.07, 0.05], [0.06, 0.16, 0.34], [0.10, 0.26, 0.12], [0.58, 0.44, 0.20]]
    )

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        shelf, along = patch.points[:, 1] / 0.32, _distance_along_wall(patch) / 0.055
        ids = np.stack([np.floor(along), np.floor(shelf), np.zeros(len(along))], axis=1) + 0.5
        which = noise(ids, 1.0, 1, salt)
        albedo = spines[np.minimum((which * 4.0).astype(int), 3)]
        albedo = albedo * (0.6 + 0.8 * noise(ids, 1.0, 1, salt + 9))[:, None]
        height = 0.62 + 0.3 * noise(ids, 1.0, 1, salt + 5)
        dark = smoothstep(0.0, 0.02, shelf % 1.0 - height)
        seam = smoothstep(0.10, 0.0, along % 1.0)
        albedo = blend(albedo, (0.02, 0.015, 0.01), np.maximum(dark, 0.7 * seam))
        board = smoothstep(0.94, 0.95, shelf % 1.0)
        return cover(patch, rng, blend(albedo, (0.30, 0.18, 0.09), board), 0.08, 0.3, edges=edges)

    return paint


def painting(salt: int) -> Paint:
    """Return the paint of a framed picture, a landscape of bands of colour."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        u, v = patch.uv[:, 0], patch.uv[:, 1]
        place = np.stack([u + salt, v * 1.3, np.full(len(u), 0.37 * salt)], axis=1)
        rise = v + 0.35 * (noise(place, 3.0, 3, salt) - 0.5)
        sky = blend((0.78, 0.52, 0.30), (0.16, 0.30, 0.55), smoothstep(0.5, 1.0, rise))
        land = blend((0.07, 0.13, 0.06), (0.36, 0.30, 0.10), noise(place, 9.0, 3, salt + 1))
        albedo = np.where((rise < 0.45)[:, None], land, sky)
        rim = np.minimum(np.minimum(u, 1.0 - u), np.minimum(v, 1.0 - v))
        albedo = blend((0.34, 0.22, 0.07), albedo, smoothstep(0.05, 0.051, rim))
        return cover(patch, rng, albedo, 0.10, 0.2, edges=edges)

    return paint


def window_view(salt: int) -> Paint:
    """Return the paint of a window: self-luminous sky above a hedge, with a cross of bars."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        u, v = patch.uv[:, 0], patch.uv[:, 1]
        place = np.stack([6.0 * u, 6.0 * v, np.full(len(u), 0.7 * salt)], axis=1)
        cloud = noise(place, 0.5, 3, salt)
        sky = blend((0.9, 1.3, 1.9), (2.2, 2.2, 2.2), smoothstep(0.4, 0.7, cloud))
        hedge = blend((0.05, 0.12, 0.03), (0.25, 0.42, 0.10), noise(place, 3.0, 3, salt + 1))
        light = np.where((v < 0.25 + 0.2 * noise(place, 1.0, 2, salt + 2))[:, None], hedge, sky)
        bar = np.minimum(np.abs(u - 0.5), np.abs(v - 0.6)) < 0.02
        bar |= np.minimum(np.minimum(u, 1.0 - u), np.minimum(v, 1.0 - v)) < 0.03
        albedo = np.where(bar[:, None], np.array([0.75, 0.72, 0.66]), light)
        return cover(patch, rng, albedo, 0.25, 0.12, glow=1.0, edges=edges)

    return paint


def lampshade(colour: Colour) -> Paint:
    """Return the paint of a self-luminous lampshade."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        tone = 0.9 + 0.2 * noise(patch.points, 20.0, 2, 5)
        return cover(patch, rng, np.array(colour) * tone[:, None], 0.0, glow=1.0, edges=edges)

    return paint


def earthenware(colour: Colour, salt: int) -> Paint:
    """Return the paint of glossy earthenware."""

    def paint(patch: Patch, edges: Edges, rng: np.random.Generator) -> Surfels:
        tone = 0.6 + 0.8 * noise(patch.points, 9.0, 3, salt)
        return cover(patch, rng, np.array(colour) * tone[:, None], 0.5, 0.08, edges=edges)

    return paint
