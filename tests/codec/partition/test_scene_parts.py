"""Planes that cut a scene into parts, and the cameras of a part."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.cameras import Camera
from cogsplat.codec.partition.nested_cells import WHOLE_SCENE, Region
from cogsplat.codec.partition.scene_parts import (
    FAR_CAMERAS,
    count_parts,
    divide,
    halving_planes,
    part_cameras,
    part_regions,
    refined,
)


def centres(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, (50.0, 9.0, 1.0), (count, 3))


@given(st.integers(0, 400), st.integers(1, 90), st.integers(0, 99))
def test_each_centre_is_in_one_part_and_no_part_has_too_many(
    count: int, most: int, seed: int
) -> None:
    means = centres(count, seed)
    parts = divide(halving_planes(means, 1.0, most), means)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(count))
    assert all((np.diff(part) > 0).all() for part in parts)
    assert max(map(len, parts)) <= max(most, 1)
    # A part is halved only where it is too large.
    assert max(map(len, parts)) <= 2 * min(map(len, parts)) + 1


def test_planes_cut_across_the_longest_side_without_outliers() -> None:
    means = centres(1000, 1)
    means[:10, 2] = 1e6
    tree = halving_planes(means, 1.0, 500)
    assert (tree.axis, count_parts(tree)) == (0, 2)
    assert tree.plane == np.sort(means[:, 0])[500]


def test_a_sample_stands_for_the_scene() -> None:
    assert count_parts(halving_planes(centres(64, 2), 1000.0, 8000)) == 8
    assert halving_planes(centres(64, 2), 1000.0, 64_000) is WHOLE_SCENE


def test_coincident_centres_share_a_part() -> None:
    assert halving_planes(np.ones((50, 3)), 1.0, 5) is WHOLE_SCENE
    means = np.repeat(centres(4, 3), 25, axis=0)
    assert sorted(map(len, divide(halving_planes(means, 1.0, 5), means))) == [25, 25, 25, 25]


def rectangle(count: int) -> np.ndarray:
    return np.random.default_rng(count).uniform(-1.0, 1.0, (count, 3)) * [90.0, 20.0, 60.0]


def around(count: int, radius: float) -> np.ndarray:
    points = np.random.default_rng(count).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1)[:, None]


def test_surroundings_are_the_last_part_and_leave_the_boxes_of_others_tight() -> None:
    means = np.concatenate([around(40, 4000.0), rectangle(4000)])
    first, *others, last = divide(part_regions(means, 1.0, 1000), means)
    np.testing.assert_array_equal(last, np.arange(40))
    assert max(np.ptp(means[part], axis=0).max() for part in (first, *others)) < 500.0
    assert sum(map(len, (first, *others))) == 4000


def test_surroundings_are_cut_where_a_part_cannot_hold_them() -> None:
    means = np.concatenate([rectangle(60_000), around(1200, 4000.0)])
    parts = divide(part_regions(means, 1.0, 800), means)
    assert max(map(len, parts)) <= 800
    assert sum(len(part) for part in parts if part.min() >= 60_000) == 1200


def test_few_far_centres_and_scenes_of_one_part_have_no_surroundings() -> None:
    means = np.concatenate([around(15, 4000.0), rectangle(4000)])
    assert count_parts(part_regions(means, 1.0, 1000)) == count_parts(
        halving_planes(means, 1.0, 1000)
    )
    assert part_regions(means, 1.0, 5000) is WHOLE_SCENE


def test_nan_belongs_to_the_first_part_and_infinity_to_an_outer_one() -> None:
    means = np.concatenate([rectangle(100), around(20, 4000.0)])
    tree = part_regions(means, 1.0, 25)
    means[7] = means[99]
    means[[3, 50, 98]] = [
        [np.inf, np.nan, 0.0],
        [1e9, 1e9, np.nan],
        [np.nan, np.nan, np.nan],
    ]
    means[[4, 5]] = [[-np.inf] * 3, [np.inf] * 3]
    first, *_, last = divide(tree, means)
    assert {3, 50, 98} <= set(first.tolist())
    assert {4, 5} <= set(last.tolist())
    assert np.isnan(means[[3, 50, 98]]).any(axis=1).all()


def test_parts_are_cut_further_one_by_one() -> None:
    tree = Region(0, 0.0, (WHOLE_SCENE, Region(1, 5.0, (WHOLE_SCENE, WHOLE_SCENE))))
    finer = refined(tree, {1: Region(2, 7.0, (WHOLE_SCENE, WHOLE_SCENE)), 2: WHOLE_SCENE})
    assert count_parts(finer) == 4
    points = np.array([[-1.0, 9, 9], [1, 4, 6], [1, 4, 7], [1, 5, 0]])
    assert [part.tolist() for part in divide(finer, points)] == [[0], [1], [2], [3]]


def looking(position: tuple[float, float, float], along: float, name: str) -> Camera:
    """Return a camera that looks along +x (1) or -x (-1)."""
    rotation = np.array([[0.0, -along, 0.0], [0.0, 0.0, -1.0], [along, 0.0, 0.0]])
    return Camera(100, 100, 50.0, 50.0, 50.0, 50.0, rotation, -rotation @ position, name)


@pytest.fixture
def block() -> np.ndarray:
    return np.random.default_rng(5).uniform(0, 10, (5000, 3))


def test_cameras_inside_the_enlarged_box_belong_to_a_part(block: np.ndarray) -> None:
    # The box without outliers is about 0.2 to 9.8, enlarged by 2.4.
    inside = [looking((x, 5, 5), -1.0, f"in {x}") for x in (1.0, 5.0, 12.0)]
    away = [looking((-2.0, 5, 5), -1.0, "turned away"), looking((12.5, 5, 5), 1.0, "away")]
    assert part_cameras(block, [away[0], *inside, away[1]]) == inside


def test_cameras_over_the_roofs_belong_to_a_flat_part(block: np.ndarray) -> None:
    # A quarter of its longest side counts, not of its height.
    flat = block * [1.0, 0.1, 1.0]
    heights = np.linspace(1.0, 3.2, FAR_CAMERAS + 4)
    over = [looking((3.0, y, 5.0), 1.0, f"{y} above") for y in heights]
    assert part_cameras(flat, over) == over


def test_cameras_that_see_much_of_a_part_from_far_join_spread_out(block: np.ndarray) -> None:
    seeing = [looking((-20 - x, 5, 5), 1.0, f"far {x}") for x in range(100)]
    others = [
        looking((-20, 5, 5), -1.0, "turned away"),
        looking((-20, 90, 5), 1.0, "past it"),
        # Its picture has less than a quarter of the part.
        looking((-20, 35, 5), 1.0, "aside"),
    ]
    inside = looking((5, 5, 5), 1.0, "inside")
    found = part_cameras(block, [*seeing[::-1], *others, inside])
    assert len(found) == FAR_CAMERAS + 1
    assert found[-1] == inside
    places = [-camera.position[0] for camera in found[:-1]]
    assert places == sorted(places, reverse=True)
    assert (places[-1], places[0]) == (20, 119)
    # The part sees little difference between far places.
    gaps = -np.diff(places)
    assert gaps.min() > 1
    assert gaps[0] > 5 * gaps[-1]
    assert part_cameras(block, seeing[:3]) == seeing[:3]


def test_a_part_that_no_camera_sees_has_none(block: np.ndarray) -> None:
    away = [looking((-20, 5, 5), -1.0, "away")]
    assert part_cameras(block, away) == []
    assert part_cameras(block, []) == []
    assert part_cameras(block[:0], away) == []
    assert part_cameras(np.full((3, 3), np.nan), away) == []
