"""Poses and their cameras."""

import math

import numpy as np
import pytest

from cogsplat.codec.views.pose import Lens, Pose, down_direction

LENS = Lens(80, 60, math.tan(math.radians(30.0)))
DOWN = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("zoom", [1.0, 2.5])
def test_cameras_stand_where_the_pose_does_and_look_along_it(zoom: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        position, forward = rng.normal(size=3), rng.normal(size=3)
        forward /= np.linalg.norm(forward)
        camera = Pose(position, forward, zoom).camera(LENS, DOWN, "a")
        np.testing.assert_allclose(camera.position, position, atol=1e-12)
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(camera.rotation[2], forward, atol=1e-12)
        # 60° across the width without zoom: the edge lies at half the width over the focal length.
        assert 40.0 / camera.fx == pytest.approx(math.tan(math.radians(30.0)) / zoom)
        assert camera.fx == camera.fy
        assert (camera.width, camera.height, camera.cx, camera.cy) == (80, 60, 40.0, 30.0)
        assert camera.name == "a"
        assert camera.rotation[0] @ DOWN == pytest.approx(0.0, abs=1e-12), "no roll"
        assert camera.rotation[1] @ DOWN >= 0.0, "not upside down"


@pytest.mark.parametrize("down", [DOWN, -DOWN, np.zeros(3)])
def test_cameras_that_look_straight_down_have_a_roll(down: np.ndarray) -> None:
    rotation = Pose(np.zeros(3), DOWN, 1.0).camera(LENS, down).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[2], DOWN, atol=1e-12)


@pytest.mark.parametrize(
    ("axes", "expected"),
    [("RDF", [0, 1, 0]), ("RUB", [0, -1, 0]), ("RFU", [0, 0, -1]), ("DRF", [1, 0, 0])],
)
def test_down_is_where_the_axes_say(axes: str, expected: list[int]) -> None:
    assert down_direction(axes).tolist() == expected


def test_unknown_axes_have_no_down() -> None:
    assert not down_direction("").any()
