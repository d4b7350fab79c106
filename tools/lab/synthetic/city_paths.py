"""Cameras of a synthetic city: in streets, over roofs and from far, and a way through it."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

from .city_plan import BLOCK_SIDE, City, plan_city
from .lighting import TO_SCENE
from .materials import split_count
from .patches import unit
from .terrace import camera_at

F64 = NDArray[np.float64]
Pose = tuple[F64, F64]

# Shares of the views in streets, over roofs and from far.
_SHARES: Final = (0.6, 0.25, 0.15)
_KINDS: Final = ("street", "roof", "far")
_LEAST_VIEWS: Final = 48
_VIEWS_PER_BLOCK: Final = 6

# Pictures of 480 x 360 px, 75 degrees wide, as those of houses.
_WIDTH, _HEIGHT = 480, 360
_FOCAL = 0.5 * _WIDTH / float(np.tan(np.radians(37.5)))

_EYES: Final = 1.65

# Heights of flights over roofs: between those of houses and of towers.
_LOW, _HIGH = 26.0, 40.0

# Metres of the way on foot, a block and a half, and over the roofs, higher than any tower.
_WALK: Final = 1.5 * BLOCK_SIDE
_FLIGHT: Final = 400.0
_ALTITUDE: Final = 56.0

# Metres from one camera of the way to the next: on foot, in flight, away from the city.
_STEP, _FLIGHT_STEP, _FAR_STEP = 0.5, 2.0, 5.0


def city_cameras(splats: int, seed: int = 7) -> list[Camera]:
    """Return the cameras of a capture of a city of `city_parts`.

    Parameters
    ----------
    splats, seed : int
        Arguments of `city_parts`.

    Returns
    -------
    list of Camera
        480 x 360 px, 75 degrees wide, six for each block and at least 48: 60 % in the streets, 25 %
        over the roofs and 15 % from far, named ``street_0000``, ``roof_0000``, ``far_0000`` and so
        on.
    """
    city = plan_city(splats, seed)
    rng = np.random.default_rng([seed, 3])
    views = max(_LEAST_VIEWS, _VIEWS_PER_BLOCK * len(city.blocks))
    makers = (_street_pose, _roof_pose, _far_pose)
    cameras = []
    for kind, make, count in zip(_KINDS, makers, split_count(views, _SHARES), strict=True):
        for i in range(count):
            position, forward = make(city, i / count, rng)
            cameras.append(_camera(position, forward, f"{kind}_{i:04d}"))
    return cameras


def _street_pose(city: City, share: float, rng: np.random.Generator) -> Pose:
    """Return a view from a street of the block at a share of all blocks."""
    x, z = city.corner(int(share * len(city.blocks)))
    along = rng.uniform(10.0, BLOCK_SIDE - 10.0)
    # In a lane, or on the pavement between trees and houses.
    across = float(rng.choice([1.5, 6.9]))
    place = (x + along, z + across) if rng.random() < 0.5 else (x + across, z + along)
    down_street = 0.0 if place == (x + along, z + across) else 0.5 * np.pi
    turn = down_street + np.pi * float(rng.integers(2)) + rng.uniform(-0.7, 0.7)
    forward = np.array([np.cos(turn), rng.uniform(-0.05, 0.25), np.sin(turn)])
    return np.array([place[0], _EYES, place[1]]), forward


def _roof_pose(city: City, share: float, rng: np.random.Generator) -> Pose:
    """Return a view over the roofs, from above a street: towers never hide all of it."""
    x, z = city.corner(int(share * len(city.blocks)))
    place = np.array([x, rng.uniform(_LOW, _HIGH), z])
    place[0 if rng.random() < 0.5 else 2] += rng.uniform(0.0, BLOCK_SIDE)
    # Views from the edge turn inwards: there is no city behind them.
    inwards = np.arctan2(-place[2], -place[0])
    turn = inwards + rng.uniform(-1.2, 1.2)
    return place, np.array([np.cos(turn), rng.uniform(-0.75, -0.25), np.sin(turn)])


def _far_pose(city: City, share: float, rng: np.random.Generator) -> Pose:
    """Return a view of the whole city from beyond its edge."""
    reach = float(np.hypot(city.half_x, city.half_z))
    turn = 2.0 * np.pi * share + rng.uniform(-0.1, 0.1)
    height = 35.0 + reach * rng.uniform(0.25, 0.7)
    away = 1.35 * reach + 30.0
    place = np.array([away * np.cos(turn), height, away * np.sin(turn)])
    target = np.array([rng.uniform(-0.2, 0.2) * reach, 5.0, rng.uniform(-0.2, 0.2) * reach])
    return place, target - place


def city_walk(splats: int, seed: int = 7) -> list[Camera]:
    """Return the cameras of a way through a city: on foot, up, over the roofs, and away.

    Parameters
    ----------
    splats, seed : int
        Arguments of `city_parts`.

    Returns
    -------
    list of Camera
        480 x 360 px, 75 degrees wide; from one to the next at most half a metre on foot, two
        metres in flight and five beyond the city. Their names tell the part of the way:
        ``street_0000``, ``roof_0000``, ``far_0000`` and so on.
    """
    city = plan_city(splats, seed)
    ways = (_on_foot(city), _over_roofs(city), _away(city))
    cameras = []
    for kind, poses in zip(_KINDS, ways, strict=True):
        for i, (position, forward) in enumerate(poses):
            cameras.append(_camera(position, forward, f"{kind}_{i:04d}"))
    return cameras


def _start(city: City) -> F64:
    """Return the crossing from which the walk starts: the middle one, on the ground."""
    x, z = city.corner((city.rows // 2) * city.columns + city.columns // 2)
    return np.array([x, 0.0, z])


def _on_foot(city: City) -> list[Pose]:
    """Return the walk along two streets, which glances to both sides."""
    start = _start(city)
    poses = []
    for step in range(int(_WALK / _STEP)):
        gone = _STEP * step
        first = min(gone, BLOCK_SIDE)
        rest = gone - first
        # The corner is turned over eight metres.
        turn = 0.5 * np.pi * float(np.clip((gone - BLOCK_SIDE + 4.0) / 8.0, 0.0, 1.0))
        look = turn + 0.6 * np.sin(gone / 9.0)
        place = start + np.array([first, _EYES, rest])
        poses.append((place, np.array([np.cos(look), 0.08, np.sin(look)])))
    return poses


def _over_roofs(city: City) -> list[Pose]:
    """Return the flight that rises from the end of the walk and circles over the roofs."""
    place, forward = _on_foot(city)[-1]
    heading = float(np.arctan2(forward[2], forward[0]))
    poses = []
    steps = int(min(_FLIGHT, 4.0 * (city.half_x + city.half_z)) / _FLIGHT_STEP)
    for step in range(steps):
        rise = min(1.0, step / 25.0)
        heading += 0.035 * rise
        over = np.array([np.cos(heading), 0.0, np.sin(heading)])
        up = min(1.5, 0.08 * (_ALTITUDE - float(place[1])))
        place = place + over * float(np.sqrt(max(0.0, _FLIGHT_STEP**2 - up * up))) + [0.0, up, 0.0]
        poses.append((place, over + np.array([0.0, 0.08 - 0.5 * rise, 0.0])))
    return poses


def _away(city: City) -> list[Pose]:
    """Return the flight backwards and up, until the whole city is seen."""
    place, forward = _over_roofs(city)[-1]
    back = -unit(forward * np.array([1.0, 0.0, 1.0])) * 0.8 + np.array([0.0, 0.6, 0.0])
    steps = int(min(1.6 * np.hypot(city.half_x, city.half_z), 2000.0) / _FAR_STEP)
    target = place + 60.0 * forward
    ways = [place + back * (_FAR_STEP * (step + 1)) for step in range(steps)]
    return [(here, target - here) for here in ways]


def _camera(position: F64, forward: F64, name: str) -> Camera:
    """Return a camera of 480 x 360 px, 75 degrees wide."""
    return camera_at(position * TO_SCENE, unit(forward) * TO_SCENE, _WIDTH, _HEIGHT, _FOCAL, name)
