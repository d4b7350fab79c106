"""Free lengths of rays and occlusion of points against plain geometry."""

import math

import numpy as np
import oracle
import pytest
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.views.low_discrepancy import even_directions
from cogsplat.codec.views.occlusion import Occluders


def walls(points: NDArray[np.float64], size: float) -> Splats:
    """Return round, opaque splats."""
    splats = empty(0, len(points))
    splats.means[:] = points
    splats.scales[:] = math.log(size)
    splats.opacities[:] = 8.0
    return splats


def test_rays_end_at_a_wall() -> None:
    ticks = np.linspace(-2.0, 2.0, 41)
    x, y = np.meshgrid(ticks, ticks)
    wall = walls(np.stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)], axis=1), 0.1)
    occluders = Occluders(wall)
    origins = np.zeros((4, 3))
    towards = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    lengths, starts = np.array([6.0, 6.0, 6.0, 2.0]), np.zeros(4)
    free = occluders.free_lengths(origins, towards, lengths, starts)
    # Bins are a 64th of the length; splats blur the wall by a few of their sizes.
    assert free[0] == pytest.approx(3.0, abs=0.4)
    assert free[1] == 6.0, "nothing in that direction"
    assert free[2] == 6.0, "past its edge"
    assert free[3] == 2.0, "it stands further away"
    behind = occluders.free_lengths(origins[:1], towards[:1], lengths[:1], np.array([4.0]))
    assert behind[0] == 6.0, "what lies nearer than the start does not count"


def test_faint_splats_block_by_their_optical_depth() -> None:
    haze = walls(np.stack([np.zeros(40), np.zeros(40), np.linspace(1.0, 5.0, 40)], axis=1), 0.3)
    # Twenty crossings at 3.4 % each take half of the light.
    haze.opacities[:] = math.log(0.034 / 0.966)
    free = Occluders(haze).free_lengths(
        np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([6.0]), np.zeros(1)
    )
    assert free[0] == pytest.approx(3.0, abs=0.25)


def test_occlusion_is_the_share_of_directions_that_are_blocked() -> None:
    # 3,000 splats on a shell of radius 2, then on its lower half alone.
    points = even_directions(3000) * 2.0
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    reaches = np.array([np.inf, 1.0, np.inf])
    whole = Occluders(walls(points, 0.1)).occlusion(places, reaches)
    np.testing.assert_array_equal(whole, [1.0, 0.0, 0.0])
    half = Occluders(walls(points[points[:, 1] > 0.0], 0.1)).occlusion(places[:1], reaches[:1])
    assert half[0] == pytest.approx(0.5, abs=0.07)


def test_threads_change_nothing() -> None:
    splats = oracle.scene(1, n=200)
    rng = np.random.default_rng(5)
    origins, towards = rng.normal(size=(50, 3)), even_directions(50)
    lengths, starts = rng.uniform(1.0, 5.0, 50), np.full(50, 0.1)
    one, two = Occluders(splats, 1), Occluders(splats, 2)
    np.testing.assert_array_equal(
        one.free_lengths(origins, towards, lengths, starts),
        two.free_lengths(origins, towards, lengths, starts),
    )
    np.testing.assert_array_equal(one.occlusion(origins, lengths), two.occlusion(origins, lengths))
