"""Floor plan of a house of many rooms: walls, doors, windows, and poses of its visitors.

Lengths are metres, y is up. Rooms stand in rows and columns on the floor of the house, x to the
right and z towards the front.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

CEILING: Final = 2.7
"""Height of all rooms."""

DOOR_HEIGHT: Final = 2.1
HALF_DOOR: Final = 0.48
HALF_WALL: Final = 0.07
"""Half the width of a door, and half the thickness of a wall."""

MOST_ROOMS: Final = 400
SPLATS_PER_ROOM: Final = 100_000
"""Rooms of a house at most, and splats per room that resolve the wallpaper's pattern. With more
rooms, a scene of 20 million splats has gaps in its walls."""

EYES: Final = 1.55
"""Height of a visitor's eyes."""

# Width and depth of a room, at least and at most.
_WIDTHS, _DEPTHS = (3.7, 5.2), (3.5, 4.8)
# Distance of a door's middle from a room's corners at least: corners hold furniture, metres.
_DOOR_TO_CORNER = 1.3
# Probability of a door between neighbours that are already connected.
_EXTRA_DOOR_PROBABILITY = 0.2
# Largest step (metres) and turn (radians) between two poses, as of a visitor who films a house.
_STEP, _TURN = 0.5, np.radians(20.0)
# Distance from a door within which a visitor walks straight through it, metres.
_BEFORE_DOOR = 0.55


@dataclass(frozen=True)
class Opening:
    """A door or a window in one wall of a room.

    Parameters
    ----------
    middle : float
        Position of its middle along the wall, from the wall's left end seen from inside, metres.
    half : float
        Half its width, metres.
    low, high : float
        Heights of its lower and upper edge, metres.
    to_room : int
        Number of the room behind a door; -1 for a window.
    """

    middle: float
    half: float
    low: float
    high: float
    to_room: int


@dataclass(frozen=True)
class Room:
    """A room: its floor, and the doors and windows in its walls.

    Parameters
    ----------
    x0, z0, x1, z1 : float
        Opposite corners of the floor, metres.
    walls : tuple of list of Opening
        Openings of the walls at z0, x1, z1 and x0, in this order.
    """

    x0: float
    z0: float
    x1: float
    z1: float
    walls: tuple[list[Opening], list[Opening], list[Opening], list[Opening]] = field(
        default_factory=lambda: ([], [], [], [])
    )

    @property
    def middle(self) -> F64:
        """The middle of the floor as x and z."""
        return np.array([0.5 * (self.x0 + self.x1), 0.5 * (self.z0 + self.z1)])

    def wall(self, number: int) -> tuple[F64, F64, float]:
        """Return a wall's left end as seen from inside, its direction (x, z), and its length."""
        width, depth = self.x1 - self.x0, self.z1 - self.z0
        start, along, length = (
            ((self.x0, self.z0), (1.0, 0.0), width),
            ((self.x1, self.z0), (0.0, 1.0), depth),
            ((self.x1, self.z1), (-1.0, 0.0), width),
            ((self.x0, self.z1), (0.0, -1.0), depth),
        )[number]
        return np.array(start), np.array(along), length


@dataclass(frozen=True)
class Door:
    """A door between two rooms.

    Parameters
    ----------
    first, second : int
        Numbers of the rooms.
    x, z : float
        Position of its middle, halfway through the wall, metres.
    across : tuple of float
        Unit vector (x, z) through the door from the first room to the second.
    """

    first: int
    second: int
    x: float
    z: float
    across: tuple[float, float]


@dataclass(frozen=True)
class FloorPlan:
    """Rooms of a house and the doors between neighbouring rooms, which connect the whole house.

    Parameters
    ----------
    rooms : list of Room
    doors : list of Door
    """

    rooms: list[Room]
    doors: list[Door]


def floor_plan(rooms: int, rng: np.random.Generator) -> FloorPlan:
    """Generate a random floor plan.

    Parameters
    ----------
    rooms : int
        Number of rooms, at least 1.
    rng : numpy.random.Generator
        Source of the sizes of the rooms, their doors and their windows.

    Raises
    ------
    ValueError
        The number of rooms is below 1.
    """
    if rooms < 1:
        raise ValueError(f"{rooms} rooms, expected at least 1")
    columns = int(np.ceil(np.sqrt(rooms)))
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(*_WIDTHS, columns))])
    z = np.concatenate([[0.0], np.cumsum(rng.uniform(*_DEPTHS, -(-rooms // columns)))])
    made = []
    for number in range(rooms):
        row, column = divmod(number, columns)
        made.append(
            Room(
                float(x[column] + HALF_WALL),
                float(z[row] + HALF_WALL),
                float(x[column + 1] - HALF_WALL),
                float(z[row + 1] - HALF_WALL),
            )
        )
    doors = []
    for first, second in _choose_doors(rooms, columns, rng):
        # The second of two neighbours is to the right of the first, or in front of it.
        beside = second == first + 1
        one, other = made[first], made[second]
        low, high = (one.z0, one.z1) if beside else (one.x0, one.x1)
        at = float(rng.uniform(low + _DOOR_TO_CORNER, high - _DOOR_TO_CORNER))
        for room, number, to_room in ((one, 1 if beside else 2, second), (other, -1, first)):
            number = number if number > 0 else 3 if beside else 0
            start, along, _ = room.wall(number)
            place = (at - start[1 if beside else 0]) * along[1 if beside else 0]
            room.walls[number].append(Opening(float(place), HALF_DOOR, 0.0, DOOR_HEIGHT, to_room))
        if beside:
            doors.append(Door(first, second, one.x1 + HALF_WALL, at, (1.0, 0.0)))
        else:
            doors.append(Door(first, second, at, one.z1 + HALF_WALL, (0.0, 1.0)))
    _add_windows(made, columns, rng)
    return FloorPlan(made, doors)


def _choose_doors(rooms: int, columns: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Return pairs of neighbours to connect by doors: a spanning tree, and a few random pairs."""
    pairs = [(i, i + 1) for i in range(rooms - 1) if (i + 1) % columns]
    pairs += [(i, i + columns) for i in range(rooms - columns)]
    group = list(range(rooms))
    chosen = []
    for index in rng.permutation(len(pairs)):
        first, second = pairs[index]
        if group[first] != group[second]:
            joined = group[second]
            group = [group[first] if of == joined else of for of in group]
            chosen.append(pairs[index])
        elif rng.random() < _EXTRA_DOOR_PROBABILITY:
            chosen.append(pairs[index])
    return sorted(chosen)


def _add_windows(rooms: list[Room], columns: int, rng: np.random.Generator) -> None:
    """Add a window to each outer wall."""
    for number, room in enumerate(rooms):
        row, column = divmod(number, columns)
        outside = (
            row == 0,
            column == columns - 1 or number == len(rooms) - 1,
            number + columns >= len(rooms),
            column == 0,
        )
        for wall, is_outside in enumerate(outside):
            if is_outside:
                _, _, length = room.wall(wall)
                middle = 0.5 * length + float(rng.uniform(-0.3, 0.3))
                room.walls[wall].append(Opening(middle, float(rng.uniform(0.5, 0.8)), 0.9, 2.2, -1))


def walk_poses(plan: FloorPlan) -> list[tuple[F64, float]]:
    """Return the poses of a visitor who walks through all rooms by their doors.

    Returns
    -------
    list of (position, heading)
        Position of the eyes, (3,) float64; the heading is the angle from +x towards +z, radians.
    """
    poses: list[tuple[F64, float]] = []
    corners = _corners(plan)
    heading: float | None = None
    for start, end in pairwise(corners):
        away = end - start
        length = float(np.hypot(*away))
        towards = float(np.arctan2(away[1], away[0]))
        if heading is None:
            heading = towards
        turn = (towards - heading + np.pi) % (2.0 * np.pi) - np.pi
        turns = int(np.ceil(abs(turn) / _TURN))
        poses += [(_eyes(start), heading + turn * i / turns) for i in range(1, turns)]
        steps = max(1, int(np.ceil(length / _STEP)))
        poses += [(_eyes(start + away * (i / steps)), towards) for i in range(steps)]
        heading = towards
    poses.append((_eyes(corners[-1]), heading or 0.0))
    return poses


def _eyes(place: F64) -> F64:
    """Return the position of a visitor's eyes above a point (x, z)."""
    return np.array([place[0], EYES, place[1]])


def _corners(plan: FloorPlan) -> list[F64]:
    """Return the (x, z) corners of a depth-first walk, with backtracking from dead ends."""
    beside: dict[int, list[tuple[int, Door]]] = {i: [] for i in range(len(plan.rooms))}
    for door in plan.doors:
        beside[door.first].append((door.second, door))
        beside[door.second].append((door.first, door))
    corners = [plan.rooms[0].middle]
    seen, trail = {0}, [0]
    while trail and len(seen) < len(plan.rooms):
        here = trail[-1]
        onward = [way for way in beside[here] if way[0] not in seen]
        if onward:
            there, door = onward[0]
            seen.add(there)
            trail.append(there)
        else:
            trail.pop()
            there = trail[-1]
            door = next(door for room, door in beside[here] if room == there)
        middle = np.array([door.x, door.z])
        across = np.array(door.across) * (1.0 if there == door.second else -1.0)
        corners += [middle - _BEFORE_DOOR * across, middle + _BEFORE_DOOR * across]
        corners.append(plan.rooms[there].middle)
    if len(corners) == 1:
        corners.append(corners[0] + np.array([1.0, 0.0]))
    return corners


def capture_poses(
    plan: FloorPlan, views: int, rng: np.random.Generator
) -> list[tuple[int, F64, F64]]:
    """Return the poses of a capture that shows each room from several positions.

    Parameters
    ----------
    plan : FloorPlan
    views : int
        Views per room.
    rng : numpy.random.Generator
        Source of the random offsets of the poses.

    Returns
    -------
    list of (room, position, forward)
        Position (3,) float64; forward is a unit vector.
    """
    poses = []
    for number, room in enumerate(plan.rooms):
        reach = 0.22 * np.array([room.x1 - room.x0, room.z1 - room.z0])
        for view in range(views):
            angle = 2.0 * np.pi * (view + 0.5 * rng.random()) / views
            # The position is opposite the viewing direction, so that much of the room is visible.
            place = room.middle - reach * np.array([np.cos(angle), np.sin(angle)])
            eyes = _eyes(place) + np.array([0.0, rng.uniform(-0.35, 0.25), 0.0])
            sink = rng.uniform(-0.35, 0.02)
            forward = np.array([np.cos(angle), sink, np.sin(angle)])
            poses.append((number, eyes, forward / np.sqrt(1.0 + sink * sink)))
    return poses
