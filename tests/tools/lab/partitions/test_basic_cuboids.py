"""Grids of nearly cubic boxes: all splats counted once, views count what they see."""

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.tools.lab.partitions.basic_cuboids import basic_cuboids

AHEAD = Camera(
    width=100,
    height=100,
    fx=50.0,
    fy=50.0,
    cx=50.0,
    cy=50.0,
    rotation=np.eye(3),
    translation=np.zeros(3),
    name="ahead",
)


@pytest.mark.parametrize(
    ("size", "cuboids"), [((4.0, 2.0, 1.0), 64), ((1.0, 1.0, 1.0), 1000), ((9.0, 0.0, 0.0), 7)]
)
def test_cuboids_are_nearly_cubic_and_near_the_requested_number(
    size: tuple[float, float, float], cuboids: int
) -> None:
    means = np.random.default_rng(0).random((5000, 3)) * np.array(size)
    grid = basic_cuboids(means, [], cuboids)
    shape = grid.splats.shape
    assert cuboids // 2 <= np.prod(shape) <= cuboids
    sides = np.array([edges[1] - edges[0] for edges in grid.edges])
    used = np.array(size) > 0.0
    assert sides[used].max() / sides[used].min() < 1.6
    assert grid.splats.sum() == 5000


def test_floaters_do_not_widen_the_grid() -> None:
    means = np.random.default_rng(1).random((2000, 3))
    means[:3] *= 1e6
    grid = basic_cuboids(means, [], 27)
    assert grid.splats.shape == (3, 3, 3)
    assert grid.splats.sum() == 2000
    assert (grid.splats > 0).all()


def test_visible_splats_have_their_mean_in_the_frustum() -> None:
    rng = np.random.default_rng(2)
    means = rng.uniform(-4.0, 4.0, (3000, 3))
    grid = basic_cuboids(means, [AHEAD], 200)
    x, y, z = means.T
    inside = (z > 0.2) & (np.abs(x) < z) & (np.abs(y) < z)
    assert grid.visible.sum() == inside.sum()
    assert (grid.visible[0] <= grid.splats).all()
    behind = grid.edges[2][1:] <= 0.2
    assert not grid.visible[0][:, :, behind].any()


def test_empty_inputs_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        basic_cuboids(np.zeros((0, 3)), [], 10)
    with pytest.raises(ValueError, match="at least one"):
        basic_cuboids(np.zeros((5, 3)), [], 0)


def test_coincident_splats_give_one_cuboid() -> None:
    assert basic_cuboids(np.ones((5, 3)), [], 10).splats.tolist() == [[[5]]]
