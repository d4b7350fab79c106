"""Frusta, held against the projection of a pinhole camera written out for one point at a time."""

from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.geometry.frustum import NEAR, in_frustum, in_picture


def projected(mean, camera):
    """Return x and y in pixels and the depth of one mean."""
    x, y, z = camera.rotation @ mean + camera.translation
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


@pytest.fixture(scope="module")
def scene():
    return oracle.scene(3, n=500), oracle.camera(angle=20)


def test_a_mean_is_in_the_picture_where_it_projects_into_it(scene):
    splats, camera = scene
    found = in_picture(splats.means.astype(np.float64), camera, 0.5)
    expected = []
    for mean in splats.means.astype(np.float64):
        x, y, z = projected(mean, camera)
        expected.append(z > 0.5 and 0 < x < camera.width and 0 < y < camera.height)
    np.testing.assert_array_equal(found, expected)
    assert 0 < found.sum() < len(found)


@pytest.mark.parametrize("margin", [0.0, 0.25, -0.2])
def test_the_margin_widens_the_image_by_its_share(scene, margin):
    splats, camera = scene
    found = in_frustum(splats, camera, margin)
    expected = []
    for mean in splats.means.astype(np.float64):
        x, y, z = projected(mean, camera)
        inside = -margin < x / camera.width < 1 + margin
        inside &= -margin < y / camera.height < 1 + margin
        expected.append(z > NEAR and inside)
    np.testing.assert_array_equal(found, expected)


def test_means_behind_the_camera_or_not_finite_are_outside(scene):
    splats, camera = scene
    means = splats.means[:3].copy()
    eye = -camera.rotation.T @ camera.translation
    means[0] = eye - 2.0 * camera.rotation[2]
    means[1] = np.nan
    means[2] = eye + 2.0 * camera.rotation[2]
    few = replace(splats.take(np.arange(3)), means=means.astype(np.float32))
    assert in_frustum(few, camera, 0.5).tolist() == [False, False, True]
