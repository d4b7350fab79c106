"""Quick looks against the brute-force oracle, free paths and enclosure against plain geometry."""

import math

import numpy as np
import oracle
import pytest
from numpy.typing import NDArray

from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.views.occlusion import Matter, even_directions
from cogsplat.codec.views.subsample import subsample


def walls(points: NDArray[np.float64], size: float) -> Splats:
    """Return round, opaque splats."""
    splats = empty(0, len(points))
    splats.means[:] = points
    splats.scales[:] = math.log(size)
    splats.opacities[:] = 8.0
    return splats


def test_directions_are_unit_vectors_spread_evenly() -> None:
    ways = even_directions(32)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0)
    assert np.linalg.norm(ways.mean(axis=0)) < 0.02
    cosines = ways @ ways.T - 2.0 * np.eye(32)
    assert math.degrees(math.acos(cosines.max())) > 20.0, "no two close together"


def test_ways_end_at_a_wall() -> None:
    ticks = np.linspace(-2.0, 2.0, 41)
    x, y = np.meshgrid(ticks, ticks)
    wall = walls(np.stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)], axis=1), 0.1)
    matter = Matter(wall)
    origins = np.zeros((4, 3))
    towards = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    lengths, starts = np.array([6.0, 6.0, 6.0, 2.0]), np.zeros(4)
    free = matter.free_paths(origins, towards, lengths, starts)
    # Bins are a 64th of the length; splats blur the wall by a few of their sizes.
    assert free[0] == pytest.approx(3.0, abs=0.4)
    assert free[1] == 6.0, "nothing that way"
    assert free[2] == 6.0, "past its edge"
    assert free[3] == 2.0, "it stands further away"
    behind = matter.free_paths(origins[:1], towards[:1], lengths[:1], np.array([4.0]))
    assert behind[0] == 6.0, "what lies nearer than the start does not count"


def test_faint_matter_blocks_by_its_depth() -> None:
    haze = walls(np.stack([np.zeros(40), np.zeros(40), np.linspace(1.0, 5.0, 40)], axis=1), 0.3)
    # Twenty crossings at 3.4 % each take half of the light.
    haze.opacities[:] = math.log(0.034 / 0.966)
    free = Matter(haze).free_paths(
        np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([6.0]), np.zeros(1)
    )
    assert free[0] == pytest.approx(3.0, abs=0.25)


def test_enclosure_is_the_share_of_directions_that_end_on_something() -> None:
    # 3,000 splats on a shell of radius 2, then on its lower half alone.
    points = even_directions(3000) * 2.0
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    reaches = np.array([np.inf, 1.0, np.inf])
    whole = Matter(walls(points, 0.1)).enclosed(places, reaches)
    np.testing.assert_array_equal(whole, [1.0, 0.0, 0.0])
    half = Matter(walls(points[points[:, 1] > 0.0], 0.1)).enclosed(places[:1], reaches[:1])
    assert half[0] == pytest.approx(0.5, abs=0.07)


def test_threads_change_nothing() -> None:
    splats = oracle.scene(1, n=200)
    rng = np.random.default_rng(5)
    origins, towards = rng.normal(size=(50, 3)), even_directions(50)
    lengths, starts = rng.uniform(1.0, 5.0, 50), np.full(50, 0.1)
    one, two = Matter(splats, 1), Matter(splats, 2)
    np.testing.assert_array_equal(
        one.free_paths(origins, towards, lengths, starts),
        two.free_paths(origins, towards, lengths, starts),
    )
    np.testing.assert_array_equal(one.enclosed(origins, lengths), two.enclosed(origins, lengths))


def test_subsamples_of_small_scenes_are_all_of_it() -> None:
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


def test_spatial_order_keeps_neighbours_together_beside_outliers() -> None:
    rng = np.random.default_rng(7)
    means = rng.uniform(-1.0, 1.0, (2000, 3)).astype(np.float32)
    means[:5] *= 1e7
    ordered = means[spatial_order(means)]
    near_plane = np.abs(ordered).max(axis=1) <= 1.0
    steps = np.linalg.norm(np.diff(ordered[near_plane], axis=0), axis=1)
    assert np.median(steps) < 0.25, "shuffled, it would be about 1.3"
