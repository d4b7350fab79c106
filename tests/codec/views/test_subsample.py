"""Subsamples: number, area and sizes of the splats they keep."""

import math

import numpy as np
import oracle
import pytest
from numpy.typing import NDArray

from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.views.subsample import MAX_LOG_SCALE, subsample


def walls(points: NDArray[np.float64], size: float) -> Splats:
    """Return round, opaque splats."""
    splats = empty(0, len(points))
    splats.means[:] = points
    splats.scales[:] = math.log(size)
    splats.opacities[:] = 8.0
    return splats


def test_small_scenes_are_not_thinned() -> None:
    splats = oracle.scene(2)
    whole = subsample(splats, 100)
    order = spatial_order(splats.means)
    np.testing.assert_array_equal(whole.splats.means, splats.means[order])
    np.testing.assert_array_equal(whole.splats.scales, splats.scales[order])
    assert (whole.counts == 1.0).all()
    assert whole.splats.sh_degree == 0


def test_subsamples_keep_the_largest_the_count_and_the_area() -> None:
    rng = np.random.default_rng(6)
    splats = walls(rng.normal(size=(5000, 3)), 0.05)
    splats.scales[:7] = 1.0
    thin = subsample(splats, 400)
    assert len(thin) == 400
    assert thin.counts.sum() == pytest.approx(5000.0)
    large = thin.splats.scales[:, 0] == 1.0
    assert large.sum() == 7
    assert (thin.counts[large] == 1.0).all()
    area = np.exp(2.0 * thin.splats.scales[~large, 0].astype(float)).sum()
    assert area == pytest.approx(4993 * 0.05**2, rel=1e-4)


def test_sizes_are_means_over_the_neighbourhood() -> None:
    splats = walls(np.stack([np.linspace(0.0, 1.0, 400)] + 2 * [np.zeros(400)], axis=1), 0.5)
    splats.scales[::2] = math.log(2.0)
    sizes = subsample(splats, 400).sizes
    # Half of the splats are of size 0.5, half of 2: the geometric mean is 1.
    np.testing.assert_allclose(sizes[40:-40], 1.0, rtol=0.1)


def test_extreme_scales_stay_finite() -> None:
    splats = walls(np.zeros((3, 3)), 1.0)
    splats.scales[0] = 1e6
    splats.scales[1] = -1e6
    sizes = subsample(splats, 3).sizes
    assert np.isfinite(sizes).all()
    assert sizes.max() <= math.exp(MAX_LOG_SCALE)
