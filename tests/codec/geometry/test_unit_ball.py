import numpy as np
import pytest

from cogsplat.codec.geometry.unit_ball import into_unit_ball

MEANS = np.random.default_rng(4).normal([50.0, 0.0, 0.0], 2.0, (501, 3))


def test_directions_are_kept_and_distances_end_below_one() -> None:
    middle = np.median(MEANS, axis=0)
    away = np.random.default_rng(5).normal(size=(40, 3)) * np.logspace(-3, 9, 40)[:, None]
    places = into_unit_ball(middle + away, MEANS)
    lengths = np.linalg.norm(places, axis=1)
    assert np.all(np.diff(lengths[np.linalg.norm(away, axis=1).argsort()]) > 0)
    assert lengths.max() < 1
    np.testing.assert_allclose(
        places / lengths[:, None], away / np.linalg.norm(away, axis=1)[:, None], atol=1e-6
    )


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_units_do_not_matter(scale: float) -> None:
    positions = np.random.default_rng(6).normal(0.0, 30.0, (20, 3))
    np.testing.assert_allclose(
        into_unit_ball(scale * positions, scale * MEANS), into_unit_ball(positions, MEANS)
    )


def test_a_scene_of_one_point_tells_directions() -> None:
    assert into_unit_ball(np.eye(3), np.zeros((1, 3))) == pytest.approx(np.eye(3))
    assert into_unit_ball(np.zeros((1, 3)), np.zeros((1, 3))).tolist() == [[0.0, 0.0, 0.0]]
