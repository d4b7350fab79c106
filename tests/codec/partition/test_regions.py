"""Regions: planes between parts of a scene that no view sees together."""

import numpy as np
import pytest

from cogsplat.codec.partition.nested_cells import WHOLE_SCENE, Region
from cogsplat.codec.partition.regions import split_regions
from cogsplat.codec.scoring.splat_groups import measure_shares
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms

SIZES = {"smallest": 100, "saving": 100}


def leaves(region: Region) -> int:
    return 1 if region.halves is None else sum(leaves(half) for half in region.halves)


def rooms(count: int, groups: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return groups of rooms in a row along y, and the shares of two views in each room."""
    rng = np.random.default_rng(2)
    room = np.repeat(np.arange(count), groups)
    centres = rng.uniform(0.0, 1.0, (len(room), 3))
    centres[:, 1] += room
    shares = np.repeat(np.arange(count), 2)[:, None] == room
    return centres, np.full(len(room), 200), np.where(shares, 1.0 / groups, 0.0)


def test_rooms_are_told_apart() -> None:
    centres, splats, shares = rooms(4)
    found = split_regions(centres, splats, shares, smallest=100, saving=100)
    assert leaves(found) == 4
    assert found.axis == 1
    assert found.halves is not None
    assert sorted(
        [found.plane, *(half.plane for half in found.halves if half.halves)]
    ) == pytest.approx([1.0, 2.0, 3.0], abs=0.2)


def test_a_scene_that_every_view_sees_is_one_region() -> None:
    centres, splats, shares = rooms(4)
    assert split_regions(centres, splats, np.full_like(shares, 0.03), **SIZES) is WHOLE_SCENE


def test_parts_that_hardly_show_are_hardly_fetched() -> None:
    centres, splats, shares = rooms(2)
    # Each view sees a trace of the other room, or a glimpse through a door, or much of it.
    for share, count in ((1e-6, 2), (0.005, 2), (0.03, 1)):
        seen = np.where(shares > 0.0, shares, share)
        assert leaves(split_regions(centres, splats, seen, smallest=200, saving=400)) == count


def test_small_regions_are_not_split() -> None:
    centres, splats, shares = rooms(4)
    assert split_regions(centres, splats, shares, smallest=100, saving=3300) is WHOLE_SCENE
    assert split_regions(centres, splats, shares, smallest=3300, saving=100) is WHOLE_SCENE
    halves = split_regions(centres, splats, shares, smallest=3200, saving=100)
    assert leaves(halves) == 2
    assert halves.plane == pytest.approx(2.0, abs=0.2)


def test_groups_in_one_place_are_one_region() -> None:
    _, splats, shares = rooms(4)
    assert split_regions(np.ones((32, 3)), splats, shares, **SIZES) is WHOLE_SCENE


def test_the_order_of_groups_does_not_matter() -> None:
    centres, splats, shares = rooms(5)
    mixed = np.random.default_rng(3).permutation(len(splats))
    first = split_regions(centres, splats, shares, **SIZES)
    other = split_regions(centres[mixed], splats[mixed], shares[:, mixed], **SIZES)

    def planes(region: Region) -> list[tuple[int, float]]:
        if region.halves is None:
            return []
        below = [plane for half in region.halves for plane in planes(half)]
        return [(region.axis, region.plane), *below]

    assert planes(first) == planes(other)


def test_planes_follow_the_walls_of_a_house() -> None:
    splats = synth_rooms(4, 12_000, sh_degree=0)
    cameras = [camera.downscaled(8) for camera in rooms_cameras(4, views=4)]
    seen = measure_shares(splats, cameras)
    centres, counts = seen.groups.centres, np.bincount(seen.groups.numbers)
    found = split_regions(centres, counts, seen.shares, smallest=500, saving=500)
    assert leaves(found) >= 4
    # Splats that are not stored cost a view nothing, and no view fetches any.
    none = np.zeros_like(counts)
    assert split_regions(centres, none, seen.shares, smallest=500, saving=500) is WHOLE_SCENE
    assert split_regions(centres, counts, seen.shares[:0], smallest=500, saving=500) is WHOLE_SCENE
