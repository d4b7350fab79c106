"""Depth order against numpy's stable sort."""

import numpy as np
import pytest

from cogsplat.codec.render.depth_order import depth_order


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_depths_are_sorted(count):
    depths = np.exp(np.random.default_rng(count).normal(0.0, 20.0, count))
    np.testing.assert_array_equal(depth_order(depths), np.argsort(depths, kind="stable"))


def test_equal_depths_keep_their_order():
    depths = np.random.default_rng(0).choice([0.01, 1.0, np.nextafter(1.0, 2.0), 1e300], 500)
    np.testing.assert_array_equal(depth_order(depths), np.argsort(depths, kind="stable"))


def test_depths_are_not_changed():
    depths = np.array([3.0, 1.0, 2.0])
    assert depth_order(depths).tolist() == [1, 2, 0]
    assert depths.tolist() == [3.0, 1.0, 2.0]
