import math
from dataclasses import replace

import numpy as np
import oracle
import pytest
from scipy.spatial.transform import Rotation

from cogsplat.codec.geometry.bounds import CUT_SIGMA, box


def surface(splats, row, count=4000, seed=0):
    """Points where the opacity of an opaque splat falls to 1/255, from scipy's rotations."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points = np.concatenate([points, np.eye(3), -np.eye(3)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    quat = splats.quats[row].astype(np.float64)
    turn = Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()
    reach = math.sqrt(2 * math.log(255)) * np.exp(splats.scales[row].astype(np.float64))
    return splats.means[row] + (points * reach) @ turn.T


def test_the_cut_is_where_opaque_splats_fade():
    assert math.exp(-0.5 * CUT_SIGMA**2) <= 1 / 255
    assert math.exp(-0.5 * (CUT_SIGMA - 0.01) ** 2) > 1 / 255


@pytest.mark.parametrize("seed", range(4))
def test_the_box_holds_every_ellipsoid(seed):
    splats = oracle.scene(seed, n=25)
    corners = box(splats)
    assert corners.shape == (6,)
    assert corners.dtype == np.float64
    for row in range(25):
        points = surface(splats, row, seed=row)
        assert (points >= corners[:3] - 1e-9).all()
        assert (points <= corners[3:] + 1e-9).all()


def test_the_box_of_one_splat_is_tight():
    for row in range(10):
        one = oracle.scene(9, n=10).take(slice(row, row + 1))
        points, corners = surface(one, 0, 60_000), box(one)
        size = corners[3:] - corners[:3]
        assert (points.min(axis=0) - corners[:3] <= 0.02 * size).all()
        assert (corners[3:] - points.max(axis=0) <= 0.02 * size).all()


def test_a_box_is_the_union_of_its_parts():
    splats = oracle.scene(6, n=30)
    parts = np.array([box(splats.take(slice(a, a + 1))) for a in range(30)])
    expected = np.concatenate([parts[:, :3].min(axis=0), parts[:, 3:].max(axis=0)])
    np.testing.assert_array_equal(box(splats), expected)


def test_the_norm_of_quaternions_does_not_matter():
    splats = oracle.scene(7, n=20)
    for factor in (np.float32(2.0**-100), np.float32(2.0**60), np.float32(-1)):
        scaled = replace(splats, quats=splats.quats * factor)
        np.testing.assert_allclose(box(scaled), box(splats), rtol=1e-6)


@pytest.mark.parametrize("scale", [-1e30, -500.0, 80.0, 500.0, 1e30])
def test_extreme_scales_give_finite_boxes(scale):
    splats = oracle.scene(8, n=3)
    splats.scales[1] = scale
    splats.means[2] = [1e30, -1e30, 0]
    corners = box(splats)
    assert np.isfinite(corners).all()
    assert (corners[:3] <= splats.means.min(axis=0)).all()
    assert (corners[3:] >= splats.means.max(axis=0)).all()
