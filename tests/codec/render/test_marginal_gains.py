import numpy as np
import oracle
import pytest

from cogsplat.codec.render.marginal_gains import marginal_gains
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.render.shading import row_colours
from cogsplat.codec.splats import concatenate


def _measure(splats, present, camera, target):
    footprints = project(splats, camera)
    colours = row_colours(splats, footprints.index, camera)
    size = camera.width, camera.height
    gains, error = marginal_gains(footprints, colours, present[footprints.index], size, target)
    return footprints.index, gains, error


def _error(splats, camera, target):
    drawn = render(splats, camera).astype(np.float64)
    return np.sum((drawn - target) ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_gains_equal_pictures_with_and_without_each_splat(seed):
    splats, camera = oracle.scene(seed, n=60), oracle.camera(angle=seed)
    rng = np.random.default_rng(seed)
    present = rng.random(len(splats)) < 0.5
    target = render(splats, camera) * np.float32(0.9) + np.float32(0.05)

    rows, gains, error = _measure(splats, present, camera, target)

    before = _error(splats.take(np.flatnonzero(present)), camera, target)
    np.testing.assert_allclose(error, before, rtol=1e-4)
    found = dict(zip(rows.tolist(), gains.tolist(), strict=True))
    assert len(found) > 20
    for row in range(len(splats)):
        other = present.copy()
        other[row] = not other[row]
        after = _error(splats.take(np.flatnonzero(other)), camera, target)
        assert found.get(row, 0.0) == pytest.approx(before - after, rel=2e-3, abs=2e-4 * before)


def test_nothing_is_gained_where_the_pixel_has_ended():
    splats, camera = oracle.scene(3, n=40), oracle.camera()
    wall = splats.take(np.zeros(3, np.int64))
    wall.means[:] = camera.position + camera.rotation[2] * np.array([[0.5], [0.6], [0.7]])
    wall.scales[:] = 3.0
    wall.opacities[:] = np.inf
    scene = concatenate([splats, wall])
    present = np.arange(len(scene)) >= len(splats)
    target = np.full((camera.height, camera.width, 3), 0.5, np.float32)
    rows, gains, _ = _measure(scene, present, camera, target)
    behind = rows < len(splats)
    assert behind.any()
    # One capped splat of the wall leaves 1 %; the second ends the pixel.
    assert np.all(np.abs(gains[behind]) < 0.02 * 0.25 * target.size)


def test_no_splat_in_view_is_the_error_of_black():
    splats, camera = oracle.scene(1, n=10), oracle.camera()
    splats.means[:] = np.nan
    target = np.full((camera.height, camera.width, 3), 0.5, np.float32)
    rows, gains, error = _measure(splats, np.ones(10, bool), camera, target)
    assert len(rows) == len(gains) == 0
    assert error == pytest.approx(0.25 * target.size)
