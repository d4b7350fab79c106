"""Visible depths, held against the projection of a pinhole camera written out for single points."""

from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.splats import concatenate, empty


def test_the_visible_depth_is_the_median_of_what_is_in_the_image():
    splats, camera = oracle.scene(3, n=500), oracle.camera(angle=20)
    depths = []
    for mean in splats.means.astype(np.float64):
        x, y, z = camera.rotation @ mean + camera.translation
        x, y = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        if z > NEAR and 0 <= x < camera.width and 0 <= y < camera.height:
            depths.append(z)
    assert visible_depth(splats, camera) == pytest.approx(np.median(depths), rel=1e-6)
    assert visible_depth(splats.take(np.zeros(0, np.int64)), camera) == 0.0


def test_every_mean_in_the_picture_counts_once():
    splats = empty(0, 6)
    camera = replace(oracle.camera(), rotation=np.eye(3), translation=np.zeros(3))
    splats.means[:] = [[0, 0, 1], [0, 0, 2], [0.1, 0, 9], [5, 0, 3], [0, 0, -4], [0, 0, 0.1]]
    assert visible_depth(splats, camera) == 2.0


def test_means_that_are_not_finite_are_ignored():
    splats = oracle.scene(0, n=9)
    expected = visible_depth(splats, oracle.camera())
    broken = splats.take(np.arange(9))
    broken.means[:] = np.nan
    broken.means[4] = np.inf
    assert visible_depth(concatenate([splats, broken]), oracle.camera()) == expected
    assert visible_depth(broken, oracle.camera()) == 0.0
    assert visible_depth(empty(0), oracle.camera()) == 0.0
