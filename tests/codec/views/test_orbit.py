"""Orbits: poses around an object, about level, beyond the near plane."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.views.orbit import OrbitTarget, bounding_ball, orbit, orbit_target, turntable

DOWN = np.array([0.0, 1.0, 0.0])
BALL = OrbitTarget(np.array([3.0, -1.0, 2.0]), 1.0, 1.2)


def test_an_orbit_target_is_the_bulk_of_the_scene() -> None:
    rng = np.random.default_rng(1)
    means = rng.normal(size=(2000, 3))
    means *= rng.uniform(0, 1, (2000, 1)) ** (1 / 3) / np.linalg.norm(means, axis=1, keepdims=True)
    means[:100] *= 1e4
    found = orbit_target(means + np.array([5.0, 0.0, -5.0]), np.ones(2000))
    np.testing.assert_allclose(found.centre, [5.0, 0.0, -5.0], atol=0.05)
    assert 0.9 < found.radius < 1.05
    assert found.reach > 100.0


def test_rows_are_weighted_by_their_counts() -> None:
    means = np.array([[0.0, 0, 0], [1.0, 0, 0], [9.0, 0, 0]])
    found = orbit_target(means, np.array([50.0, 49.0, 1.0]))
    np.testing.assert_allclose(found.centre, [49 / 99, 0.0, 0.0])


@pytest.mark.parametrize("down", [DOWN, np.array([0.0, 0.0, -1.0]), np.zeros(3)])
def test_poses_look_at_the_middle_from_rather_above(down: np.ndarray) -> None:
    poses = orbit(BALL, 200, down, 0.01)
    away = np.array([pose.position for pose in poses]) - BALL.centre
    distances = np.linalg.norm(away, axis=1)
    assert ((distances > 1.49) & (distances < 3.01)).all()
    assert all(pose.zoom == 1.0 for pose in poses)
    np.testing.assert_allclose(
        [pose.forward for pose in poses], -away / distances[:, None], atol=1e-12
    )
    up = -down if down.any() else DOWN
    rise = away @ up / distances
    assert rise.min() >= -0.15
    assert rise.max() <= 0.6
    level = away - np.outer(away @ up, up)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    assert np.linalg.norm(level.mean(axis=0)) < 0.1, "from no side alone"
    assert np.linalg.norm(level[:50].mean(axis=0)) < 0.15, "nor the first of them"


def test_small_objects_stay_beyond_the_near_plane() -> None:
    small = OrbitTarget(np.zeros(3), 0.01, 0.02)
    for row, pose in enumerate(orbit(small, 64, DOWN, 0.2)):
        distance = float(np.linalg.norm(pose.position))
        assert distance >= 0.2 + (0.02 if row % 2 else 0.005) - 1e-12
        assert 0.0149 < distance / pose.zoom < 0.0301, "as large in the picture"


def test_turntable_poses_show_the_whole_object_and_differ_from_the_orbit() -> None:
    around = np.array([pose.position for pose in orbit(BALL, 64, DOWN, 0.01)])
    whole = replace(BALL, radius=BALL.reach)
    turned = np.array([pose.position for pose in turntable(whole, 16, DOWN, 0.01)])
    distances = np.linalg.norm(turned - BALL.centre, axis=1)
    assert ((distances > 1.2 * BALL.reach) & (distances < 2.2 * BALL.reach)).all()
    apart = np.linalg.norm(turned[:, None] - around[None], axis=2)
    assert apart.min() > 0.02
    small = turntable(OrbitTarget(np.zeros(3), 0.02, 0.02), 16, DOWN, 0.2)
    np.testing.assert_allclose([np.linalg.norm(pose.position) for pose in small], 0.22)
    rise = (turned - BALL.centre) @ -DOWN / distances
    assert ((rise >= -0.3) & (rise <= 0.9)).all()
    assert rise.min() < -0.2
    assert rise.max() > 0.8


def test_a_bounding_ball_reaches_thin_parts_that_stand_far_out() -> None:
    rng = np.random.default_rng(2)
    body, staff = rng.uniform(-1.0, 1.0, (950, 3)), np.zeros((50, 3))
    staff[:, 1] = np.linspace(1.0, 9.0, 50)
    means, counts = np.concatenate([body, staff]), np.ones(1000)
    whole, most = bounding_ball(means, counts), orbit_target(means, counts)
    assert whole.radius == whole.reach
    assert whole.centre[1] == pytest.approx(3.2, abs=0.6), "the middle of it all"
    far = np.linalg.norm(means - whole.centre, axis=1)
    assert (far <= whole.reach).mean() == pytest.approx(0.99, abs=0.005)
    assert whole.reach < most.reach
