"""Synthetic house of many furnished rooms, of which each view shows a small part.

From inside a room, its walls and, through a door, a part of the next room are visible. So most of
the scene is hidden from any one position, as in captures of buildings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats

from .floor_plan import (
    CEILING,
    DOOR_HEIGHT,
    HALF_DOOR,
    HALF_WALL,
    MOST_ROOMS,
    Door,
    FloorPlan,
    Opening,
    Room,
    capture_poses,
    floor_plan,
    walk_poses,
)
from .furniture import (
    Paint,
    Piece,
    Point,
    books,
    box,
    bricks,
    earthenware,
    fabric,
    face,
    lampshade,
    lathe,
    painting,
    planks,
    plaster,
    rug,
    tiles,
    wallpaper,
    window_view,
)
from .lighting import TO_SCENE, Occluders
from .materials import Colour, Surfels, concatenate, split_count
from .patches import dot, unit
from .terrace import camera_at, splats_from_surfels

F64 = NDArray[np.float64]

VIEWS_PER_ROOM: Final = 8

# Pictures of 480 x 360 px, 75 degrees wide, as phones film rooms.
_WIDTH, _HEIGHT = 480, 360
_FOCAL = 0.5 * _WIDTH / float(np.tan(np.radians(37.5)))

# Ground and figure of wallpapers, plaster, bricks and fabrics.
_COLOURS: Final[tuple[tuple[Colour, Colour], ...]] = (
    ((0.62, 0.58, 0.48), (0.30, 0.40, 0.30)),
    ((0.36, 0.46, 0.52), (0.66, 0.62, 0.52)),
    ((0.60, 0.42, 0.30), (0.30, 0.10, 0.06)),
    ((0.34, 0.42, 0.26), (0.62, 0.58, 0.34)),
    ((0.58, 0.50, 0.56), (0.30, 0.16, 0.30)),
    ((0.64, 0.56, 0.36), (0.42, 0.24, 0.08)),
)
_WOOD: Final[tuple[tuple[Colour, Colour], ...]] = (
    ((0.42, 0.25, 0.12), (0.20, 0.10, 0.045)),
    ((0.58, 0.42, 0.24), (0.34, 0.22, 0.11)),
    ((0.28, 0.15, 0.09), (0.11, 0.055, 0.03)),
)
_WHITE: Final[Colour] = (0.72, 0.70, 0.66)

# Linear light of a room's lamp and windows at a distance of one metre, and ambient light.
_LAMP_LIGHT, _AMBIENT_LIGHT = np.array([1.7, 1.35, 0.9]), np.array([0.34, 0.33, 0.33])
_WINDOW_LIGHT = np.array([1.5, 1.8, 2.2])


@dataclass(frozen=True)
class _Footprint:
    """Floor area of a piece of furniture: x and z of opposite corners."""

    x0: float
    z0: float
    x1: float
    z1: float


def synth_rooms(rooms: int, splats: int, seed: int = 7, sh_degree: int = 3) -> Splats:
    """Generate a house of furnished rooms.

    Parameters
    ----------
    rooms : int
        Number of rooms, 1 to `floor_plan.MOST_ROOMS`, in a grid; doors connect all of them.
    splats : int
        Number of splats, at least 1; below about 20,000 per room its walls have gaps.
    seed : int
        Seed; equal seeds give equal bytes on one platform.
    sh_degree : int
        SH degree, 0 to 3; a lower degree truncates the same scene.

    Returns
    -------
    Splats
        In rows of no particular order, axes "RDF", scene units of a metre.

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """
    if not 0 <= sh_degree <= MAX_SH_DEGREE:
        raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
    if splats < 1:
        raise ValueError(f"{splats} splats, expected at least 1")
    plan = _plan(rooms, seed)
    rng = np.random.default_rng([seed, 1])
    furnished = [_furnish(room, rng) for room in plan.rooms]
    reveals = [_doorway(door) for door in plan.doors]
    pieces = [piece for made, _ in furnished for piece in made]
    pieces += [piece for made in reveals for piece in made]
    counts = split_count(splats, [piece.area for piece in pieces])
    parts = []
    start = 0
    for room, (made, footprints) in zip(plan.rooms, furnished, strict=True):
        here = _make_surfels(made, counts[start : start + len(made)], rng)
        start += len(made)
        if here is not None:
            parts.append(_bake_room_light(here, room, footprints))
    for door, made in zip(plan.doors, reveals, strict=True):
        here = _make_surfels(made, counts[start : start + len(made)], rng)
        start += len(made)
        if here is not None:
            parts.append(_bake_room_light(here, plan.rooms[door.first], []))
    surfels = concatenate(parts)
    parts.clear()
    order = rng.permutation(splats)
    nothing = Occluders(np.zeros((0, 5)), np.zeros((0, 7)))
    return splats_from_surfels(surfels, nothing, rng, sh_degree, order)


def rooms_cameras(rooms: int, seed: int = 7, views: int = VIEWS_PER_ROOM) -> list[Camera]:
    """Return the cameras of a capture that shows every room of a `synth_rooms` house.

    Parameters
    ----------
    rooms, seed : int
        Arguments of `synth_rooms`.
    views : int
        Views per room.

    Returns
    -------
    list of Camera
        480 x 360 px, 75 degrees wide, named ``room_000_view_0`` and so on.
    """
    poses = capture_poses(_plan(rooms, seed), views, np.random.default_rng([seed, 2]))
    return [
        _camera(position, forward, f"room_{room:03d}_view_{index % views}")
        for index, (room, position, forward) in enumerate(poses)
    ]


def rooms_walk(rooms: int, seed: int = 7) -> list[Camera]:
    """Return the cameras of a visitor who walks through a house of `synth_rooms`.

    Parameters
    ----------
    rooms, seed : int
        Arguments of `synth_rooms`.

    Returns
    -------
    list of Camera
        480 x 360 px, 75 degrees wide, at most half a metre and 20 degrees from one to the next,
        through every room; named ``walk_0000`` and so on.
    """
    return [
        _camera(eyes, np.array([np.cos(heading), -0.08, np.sin(heading)]), f"walk_{index:04d}")
        for index, (eyes, heading) in enumerate(walk_poses(_plan(rooms, seed)))
    ]


def _plan(rooms: int, seed: int) -> FloorPlan:
    """Return the floor plan of a house; all functions of a house share it by `seed`."""
    if not 1 <= rooms <= MOST_ROOMS:
        raise ValueError(f"{rooms} rooms, expected 1 to {MOST_ROOMS}")
    return floor_plan(rooms, np.random.default_rng([seed, 0]))


def _camera(position: F64, forward: F64, name: str) -> Camera:
    """Return a camera of 480 x 360 px, 75 degrees wide."""
    return camera_at(position * TO_SCENE, unit(forward) * TO_SCENE, _WIDTH, _HEIGHT, _FOCAL, name)


def _make_surfels(
    pieces: list[Piece], counts: list[int], rng: np.random.Generator
) -> Surfels | None:
    """Return the surfels of the pieces, or None if all counts are 0."""
    parts = [piece.make(count, rng) for piece, count in zip(pieces, counts, strict=True) if count]
    return concatenate(parts) if parts else None


def _furnish(room: Room, rng: np.random.Generator) -> tuple[list[Piece], list[_Footprint]]:
    """Return the pieces of a room, and the floor areas of its furniture."""
    salt = int(rng.integers(1, 10_000))
    ground, figure = _COLOURS[int(rng.integers(len(_COLOURS)))]
    paper: Paint = (
        wallpaper(ground, figure, salt),
        plaster(ground, salt),
        wallpaper(figure, ground, salt),
    )[int(rng.integers(3))]
    wood = _WOOD[int(rng.integers(len(_WOOD)))]
    ceiling_light = _LAMP_LIGHT / _LAMP_LIGHT.max() * 2.0
    floor: Paint = (
        planks(*wood, salt + 20),
        planks(*wood, salt + 20, turned_by=True),
        tiles((0.66, 0.62, 0.55), (0.12, 0.11, 0.11), salt + 20),
    )[int(rng.integers(3))]
    width, depth = room.x1 - room.x0, room.z1 - room.z0
    x, z = room.middle
    pieces = [
        face((room.x0, 0.0, room.z0), (0.0, 0.0, depth), (width, 0.0, 0.0), floor),
        face((room.x0, CEILING, room.z0), (width, 0.0, 0.0), (0.0, 0.0, depth), plaster(_WHITE, 3)),
        face(
            (x - 0.8, 0.012, z - 0.6),
            (0.0, 0.0, 1.2),
            (1.6, 0.0, 0.0),
            rug(figure, ground, salt),
            1.5,
        ),
        lathe(
            [(0.03, 0.42), (0.10, 0.36), (0.24, 0.16), (0.27, 0.03), (0.01, 0.0)][::-1],
            (x, CEILING - 0.45, z),
            lampshade((float(ceiling_light[0]), float(ceiling_light[1]), float(ceiling_light[2]))),
        ),
    ]
    bare = int(rng.integers(4))
    for number in range(4):
        paint = bricks((0.42, 0.17, 0.10), salt) if number == bare else paper
        pieces += _wall(room, number, paint, salt + number)
    footprints: list[_Footprint] = []
    for number in range(4):
        if not any(opening.low == 0.0 for opening in room.walls[number]):
            added, footprint = _along_wall(room, number, (wood, figure), salt + 40 + number, rng)
            pieces += added
            footprints.append(footprint)
    for corner in range(4):
        added, spot = _in_corner(room, corner, wood, salt + 60 + corner, rng)
        if spot is not None and not any(_overlap(spot, other) for other in footprints):
            pieces += added
            footprints.append(spot)
    return pieces, footprints


def _overlap(one: _Footprint, other: _Footprint) -> bool:
    """Tell whether two floor areas overlap."""
    return one.x0 < other.x1 and other.x0 < one.x1 and one.z0 < other.z1 and other.z0 < one.z1


def _wall(room: Room, number: int, paint: Paint, salt: int) -> list[Piece]:
    """Return the pieces of a wall around its openings, and of its windows."""
    start, along, length = room.wall(number)

    def pane(s0: float, s1: float, low: float, high: float, with_paint: Paint) -> Piece:
        x, z = start + along * s0
        run = along * (s1 - s0)
        corner: Point = (float(x), low, float(z))
        return face(corner, (float(run[0]), 0.0, float(run[1])), (0.0, high - low, 0.0), with_paint)

    pieces = []
    done = 0.0
    for opening in sorted(room.walls[number], key=lambda opening: opening.middle):
        left, right = opening.middle - opening.half, opening.middle + opening.half
        pieces.append(pane(done, left, 0.0, CEILING, paint))
        pieces.append(pane(left, right, opening.high, CEILING, paint))
        if opening.low > 0.0:
            pieces.append(pane(left, right, 0.0, opening.low, paint))
            pieces.append(pane(left, right, opening.low, opening.high, window_view(salt)))
        done = right
    pieces.append(pane(done, length, 0.0, CEILING, paint))
    return pieces


def _doorway(door: Door) -> list[Piece]:
    """Return the pieces inside a doorway: two sides, top and threshold."""
    paint = plaster(_WHITE, 11)
    ax, az = door.across
    # Along the wall, to the left of somebody who walks through.
    lx, lz = az, -ax
    thick: Point = (2.0 * HALF_WALL * ax, 0.0, 2.0 * HALF_WALL * az)
    back: Point = (-thick[0], 0.0, -thick[2])
    up: Point = (0.0, DOOR_HEIGHT, 0.0)
    wide: Point = (2.0 * HALF_DOOR * lx, 0.0, 2.0 * HALF_DOOR * lz)

    def corner(side: float, depth: float, y: float) -> Point:
        return (
            door.x + side * HALF_DOOR * lx + depth * HALF_WALL * ax,
            y,
            door.z + side * HALF_DOOR * lz + depth * HALF_WALL * az,
        )

    return [
        face(corner(1.0, -1.0, 0.0), thick, up, paint),
        face(corner(-1.0, 1.0, 0.0), back, up, paint),
        face(corner(-1.0, -1.0, DOOR_HEIGHT), wide, thick, paint),
        face(corner(-1.0, -1.0, 0.004), thick, wide, planks(*_WOOD[0], 12)),
    ]


def _along_wall(
    room: Room,
    number: int,
    colours: tuple[tuple[Colour, Colour], Colour],
    salt: int,
    rng: np.random.Generator,
) -> tuple[list[Piece], _Footprint]:
    """Return furniture at the middle of a wall, perhaps with a picture, and its floor area."""
    wood, cloth = colours
    start, along, length = room.wall(number)
    inwards = np.array([-along[1], along[0]])
    middle = 0.5 * length
    has_window = bool(room.walls[number])
    kind = int(rng.integers(2 if has_window else 3))
    half, deep, tall = ((0.9, 0.8, 0.42), (0.7, 0.42, 0.78), (0.8, 0.34, 1.93))[kind]

    def block(s0: float, s1: float, d1: float, y0: float, y1: float) -> tuple[Point, Point]:
        one, other = start + along * s0, start + along * s1 + inwards * d1
        low, high = np.minimum(one, other), np.maximum(one, other)
        return (float(low[0]), y0, float(low[1])), (float(high[0]), y1, float(high[1]))

    low, high = block(middle - half, middle + half, deep, 0.0, tall)
    footprint = _Footprint(low[0], low[2], high[0], high[2])
    if kind == 0:
        pieces = box(low, high, fabric(cloth, salt))
        pieces += box(*block(middle - half, middle + half, 0.22, tall, 0.85), fabric(cloth, salt))
        for side in (middle - half, middle + half - 0.18):
            pieces += box(*block(side, side + 0.18, deep, tall, 0.6), fabric(cloth, salt))
    elif kind == 1:
        pieces = box(low, high, planks(*wood, salt))
        x, z = start + along * (middle + rng.uniform(-0.4, 0.4)) + inwards * 0.2
        pieces.append(_vase((float(x), tall, float(z)), salt, rng))
    else:
        pieces = box(low, high, books(salt), 3.0)
    if not has_window and kind < 2:
        wide, y = float(rng.uniform(0.35, 0.6)), float(rng.uniform(1.15, 1.3))
        x, z = start + along * (middle - wide) + inwards * 0.015
        run = along * (2.0 * wide)
        corner: Point = (float(x), y, float(z))
        edge: Point = (float(run[0]), 0.0, float(run[1]))
        pieces.append(face(corner, edge, (0.0, 0.8, 0.0), painting(salt), 2.5))
    return pieces, footprint


def _in_corner(
    room: Room,
    corner: int,
    wood: tuple[Colour, Colour],
    salt: int,
    rng: np.random.Generator,
) -> tuple[list[Piece], _Footprint | None]:
    """Return a plant, lamp, table or nothing in a room's corner, and its floor area if any."""
    x = room.x0 + 0.36 if corner in (0, 3) else room.x1 - 0.36
    z = room.z0 + 0.36 if corner < 2 else room.z1 - 0.36
    footprint = _Footprint(x - 0.3, z - 0.3, x + 0.3, z + 0.3)
    kind = int(rng.integers(4))
    if kind == 0:
        pot = [(0.0, 0.0), (0.15, 0.01), (0.20, 0.30), (0.17, 0.32), (0.15, 0.28)]
        pieces = [lathe(pot, (x, 0.0, z), earthenware((0.40, 0.16, 0.08), salt))]
        pieces += [_leaf((x, 0.28, z), rng, salt + i) for i in range(11)]
    elif kind == 1:
        foot = [(0.0, 0.0), (0.16, 0.0), (0.15, 0.025), (0.02, 0.05), (0.016, 1.0), (0.016, 1.35)]
        shade = [(0.23, 0.0), (0.19, 0.14), (0.14, 0.30)]
        pieces = [
            lathe(foot, (x, 0.0, z), earthenware((0.10, 0.09, 0.08), salt)),
            lathe(shade, (x, 1.32, z), lampshade((1.5, 1.1, 0.6))),
        ]
    elif kind == 2:
        low: Point = (x - 0.26, 0.0, z - 0.26)
        pieces = box(low, (x + 0.26, 0.55, z + 0.26), planks(*wood, salt))
        pieces.append(_vase((x, 0.55, z), salt, rng))
    else:
        return [], None
    return pieces, footprint


def _vase(foot: Point, salt: int, rng: np.random.Generator) -> Piece:
    """Return a vase of random size and colour."""
    wide, tall = float(rng.uniform(0.07, 0.11)), float(rng.uniform(0.22, 0.34))
    outline = [(0.0, 0.0), (0.6 * wide, 0.0), (wide, 0.35 * tall), (0.5 * wide, 0.8 * tall)]
    hue = rng.uniform(0.05, 0.6, 3)
    colour: Colour = (float(hue[0]), float(hue[1]), float(hue[2]))
    return lathe([*outline, (0.62 * wide, tall)], foot, earthenware(colour, salt), 3.0)


def _leaf(foot: Point, rng: np.random.Generator, salt: int) -> Piece:
    """Return a long leaf of a potted plant."""
    angle, lean = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(0.1, 0.5))
    long = float(rng.uniform(0.5, 1.0))
    rise = np.array([lean * np.cos(angle), 1.0, lean * np.sin(angle)]) * long
    side = 0.06 * np.array([-np.sin(angle), 0.0, np.cos(angle)])
    corner = np.array(foot) - 0.5 * side
    return face(
        (float(corner[0]), float(corner[1]), float(corner[2])),
        (float(side[0]), 0.0, float(side[2])),
        (float(rise[0]), float(rise[1]), float(rise[2])),
        fabric((0.10, 0.26, 0.06), salt),
        2.0,
    )


def _bake_room_light(surfels: Surfels, room: Room, footprints: list[_Footprint]) -> Surfels:
    """Bake the light of a room into its surfels, which become self-luminous."""
    points, normals = surfels.patch.points, surfels.patch.normals
    x, z = room.middle
    light = _AMBIENT_LIGHT * _ambient_occlusion(points, normals, room, footprints)[:, None]
    lamp = np.array([x, CEILING - 0.35, z]) - points
    light = light + _LAMP_LIGHT * _light_share(lamp, normals, 0.5)[:, None]
    for number in range(4):
        start, along, _ = room.wall(number)
        for opening in room.walls[number]:
            if opening.to_room < 0:
                light = light + _window_light(opening, start, along, points, normals)
    shown = np.where(surfels.glow[:, None] > 0.5, surfels.albedo, surfels.albedo * light)
    return replace(surfels, albedo=shown, glow=np.ones(len(points)))


def _light_share(towards: F64, normals: F64, soft: float) -> F64:
    """Return the share of a small lamp's light that each point receives, by distance and angle."""
    squared = dot(towards, towards)
    facing = dot(towards, normals) / np.sqrt(np.maximum(squared, 1e-6))
    # Walls reflect light, so it falls off more slowly than from a point source.
    share: F64 = np.maximum(0.25 + 0.75 * facing, 0.0) / (soft + np.sqrt(squared))
    return share


def _window_light(opening: Opening, start: F64, along: F64, points: F64, normals: F64) -> F64:
    """Return the light of a window at each point, (n, 3)."""
    x, z = start + along * opening.middle
    towards = np.array([x, 0.5 * (opening.low + opening.high), z]) - points
    inwards = np.array([-along[1], 0.0, along[0]])
    distance = np.sqrt(np.maximum(dot(towards, towards), 1e-6))
    sideways = np.maximum(-dot(towards, inwards) / distance, 0.0)
    received: F64 = _light_share(towards, normals, 0.8) * sideways
    return _WINDOW_LIGHT * (2.0 * opening.half / 1.3 * received)[:, None]


def _ambient_occlusion(points: F64, normals: F64, room: Room, footprints: list[_Footprint]) -> F64:
    """Return the ambient light share of each point, lower in corners and under furniture."""
    share = np.ones(len(points))
    for axis, low, high in ((0, room.x0, room.x1), (1, 0.0, CEILING), (2, room.z0, room.z1)):
        near = np.minimum(points[:, axis] - low, high - points[:, axis])
        along = 1.0 - np.abs(normals[:, axis])
        share *= 1.0 - 0.45 * along * np.exp(-np.maximum(near, 0.0) / 0.25)
    on_floor = points[:, 1] < 0.03
    for spot in footprints:
        dx = np.maximum(np.maximum(spot.x0 - points[:, 0], points[:, 0] - spot.x1), 0.0)
        dz = np.maximum(np.maximum(spot.z0 - points[:, 2], points[:, 2] - spot.z1), 0.0)
        share *= np.where(on_floor, 1.0 - 0.6 * np.exp(-np.hypot(dx, dz) / 0.15), 1.0)
    return share
