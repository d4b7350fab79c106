"""Floaters: distances against brute force, and both conditions."""

import numpy as np

from cogsplat.codec.geometry.floaters import NEIGHBOURS, floaters, neighbour_distances


def test_distances_are_those_of_brute_force() -> None:
    means = np.random.default_rng(1).normal(size=(60, 3)).astype(np.float32)
    pairs = np.linalg.norm(means[:, None].astype(np.float64) - means[None], axis=2)
    expected = np.sort(pairs, axis=1)[:, 1 : NEIGHBOURS + 1].mean(axis=1)
    np.testing.assert_allclose(neighbour_distances(means), expected, rtol=1e-12)
    np.testing.assert_array_equal(neighbour_distances(means, 1), neighbour_distances(means, 2))


def test_few_splats_use_all_neighbours() -> None:
    line = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]], np.float32)
    np.testing.assert_allclose(neighbour_distances(line), [2, 1.5, 2.5])
    np.testing.assert_array_equal(neighbour_distances(line[:1]), [0])
    assert floaters(line[:0], np.zeros(0), 2.0).shape == (0,)
    assert not floaters(np.zeros((5, 3), np.float32), np.zeros(5), 2.0).any()


def test_isolated_splats_are_floaters_unless_they_contribute() -> None:
    rng = np.random.default_rng(2)
    cloud = rng.normal(size=(500, 3))
    means = np.concatenate([cloud, [[90, 0, 0], [0, -90, 0]]]).astype(np.float32)
    contribution = np.concatenate([rng.uniform(1, 2, 500), [0.0, 5.0]])
    # A normal cloud's own outskirts lie within 6 deviations of log distance.
    np.testing.assert_array_equal(np.flatnonzero(floaters(means, contribution, 6.0)), [500])
