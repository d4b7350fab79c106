"""The plan of a house: connected, doors where both rooms have them, and a walk that keeps clear."""

from itertools import pairwise

import numpy as np
import pytest

from cogsplat.tools.lab.synthetic.floor_plan import (
    EYES,
    HALF_DOOR,
    HALF_WALL,
    FloorPlan,
    capture_poses,
    floor_plan,
    walk_poses,
)


def planned(rooms: int, seed: int = 3) -> FloorPlan:
    return floor_plan(rooms, np.random.default_rng(seed))


def room_at(plan: FloorPlan, x: float, z: float) -> int | None:
    for number, room in enumerate(plan.rooms):
        if room.x0 <= x <= room.x1 and room.z0 <= z <= room.z1:
            return number
    return None


@pytest.mark.parametrize("rooms", [1, 2, 3, 5, 12, 31])
def test_every_room_is_reached_through_doors(rooms: int) -> None:
    plan = planned(rooms)
    assert len(plan.rooms) == rooms
    reached = {0}
    for _ in range(rooms):
        for door in plan.doors:
            if reached & {door.first, door.second}:
                reached |= {door.first, door.second}
    assert reached == set(range(rooms))


def test_a_door_is_at_the_same_place_in_both_walls() -> None:
    plan = planned(12)
    assert plan.doors
    openings = [
        (number, opening.to_room, start + along * opening.middle)
        for number, room in enumerate(plan.rooms)
        for start, along, opening in (
            (*room.wall(wall)[:2], opening) for wall in range(4) for opening in room.walls[wall]
        )
        if opening.to_room >= 0
    ]
    assert len(openings) == 2 * len(plan.doors)
    for door in plan.doors:
        middle, across = np.array([door.x, door.z]), np.array(door.across)
        for room, to_room, side in (
            (door.first, door.second, -HALF_WALL),
            (door.second, door.first, HALF_WALL),
        ):
            (place,) = (at for one, other, at in openings if (one, other) == (room, to_room))
            np.testing.assert_allclose(place, middle + side * across, atol=1e-9)


def test_openings_lie_in_their_walls_and_apart() -> None:
    for room in planned(20).rooms:
        for number in range(4):
            _, _, length = room.wall(number)
            ends = sorted((o.middle - o.half, o.middle + o.half) for o in room.walls[number])
            assert all(0.0 < left < right < length for left, right in ends)
            assert all(a[1] < b[0] for a, b in pairwise(ends))


@pytest.mark.parametrize("rooms", [1, 2, 7, 12])
def test_a_walk_visits_all_rooms_and_no_wall(rooms: int) -> None:
    plan = planned(rooms)
    poses = walk_poses(plan)
    visited = {room_at(plan, place[0], place[2]) for place, _ in poses}
    assert visited - {None} == set(range(rooms))
    for place, _ in poses:
        assert place[1] == EYES
        if room_at(plan, place[0], place[2]) is None:
            near = [np.hypot(door.x - place[0], door.z - place[2]) for door in plan.doors]
            assert min(near) < HALF_DOOR + HALF_WALL, "between rooms only in a doorway"
    for (one, before), (other, after) in pairwise(poses):
        assert np.linalg.norm(other - one) <= 0.5 + 1e-9
        turn = (after - before + np.pi) % (2 * np.pi) - np.pi
        assert abs(turn) <= np.radians(20.0) + 1e-9


def test_looks_around_stay_in_their_rooms_and_go_to_all_sides() -> None:
    plan = planned(4)
    poses = capture_poses(plan, 8, np.random.default_rng(0))
    assert len(poses) == 32
    for room, place, forward in poses:
        assert room_at(plan, place[0], place[2]) == room
        assert np.linalg.norm(forward) == pytest.approx(1.0)
    angles = np.sort([np.arctan2(f[2], f[0]) for _, _, f in poses[:8]])
    assert np.diff(angles).max() < np.radians(70.0)


def test_no_rooms_are_misuse() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        planned(0)
