from dataclasses import replace

import numpy as np
import oracle
import pytest
from scipy.spatial.transform import Rotation

from cogsplat.codec.render.projection import (
    FLAT,
    HALF_HEIGHT,
    HALF_WIDTH,
    NARROW,
    OPACITY,
    SHEAR,
    X,
    Y,
    fill_rotation,
    project,
)
from cogsplat.codec.splats import SceneInfo, empty


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
@pytest.mark.parametrize("shift", [0.0, 6.5])
def test_footprints_are_the_projected_gaussians(info, shift):
    splats, camera = oracle.scene(1, info=info), oracle.camera(shift=shift)
    footprints = project(splats, camera)
    assert len(footprints) > 30
    for row, index in enumerate(footprints.index):
        bare, centre, _ = oracle.covariance(splats, camera, index)
        thickness, blur = oracle.added(splats, camera, index)
        np.testing.assert_allclose(footprints.added[row], [thickness, blur], rtol=1e-6)
        trained = bare + thickness * np.eye(2)
        wide = trained + blur * np.eye(2)
        values = footprints.ellipse[row].astype(np.float64)
        np.testing.assert_allclose(values[[X, Y]], centre, rtol=1e-6, atol=1e-5)
        narrow, shear, flat = values[NARROW], values[SHEAR], values[FLAT]
        completed = np.array([[1.0, -shear], [0.0, 1.0]])
        half_inverse = completed.T @ np.diag([narrow**2, 0.0]) @ completed + np.diag([0.0, flat])
        np.testing.assert_allclose(2 * half_inverse, np.linalg.inv(wide), rtol=1e-4, atol=1e-7)
        opacity = 1 / (1 + np.exp(-float(splats.opacities[index])))
        if blur:
            opacity *= np.sqrt(np.linalg.det(trained) / np.linalg.det(wide))
        assert values[OPACITY] == pytest.approx(opacity, rel=1e-5)
        reach = 2 * np.log(opacity * 255)
        assert values[HALF_HEIGHT] ** 2 == pytest.approx(reach * wide[1, 1], rel=1e-4)
        assert values[HALF_WIDTH] ** 2 == pytest.approx(
            reach * np.linalg.det(wide) / wide[1, 1], rel=1e-4
        )


def test_rotations_of_splats_are_those_of_their_quaternions_of_any_length():
    quats = np.random.default_rng(3).normal(0.0, 5.0, (100, 4)).astype(np.float32)
    found = np.empty((3, 3))
    for quat in quats:
        assert fill_rotation(*quat.tolist(), found) == pytest.approx(2.0 / np.square(quat).sum())
        expected = Rotation.from_quat(quat[[1, 2, 3, 0]].astype(np.float64)).as_matrix()
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_nearest_comes_first_and_ties_keep_their_rows():
    splats = empty(0, 6)
    splats.means[:, 2] = [0.0, -1.0, 0.0, 1.0, -1.0, 0.0]
    camera = replace(oracle.camera(), rotation=np.eye(3))
    assert project(splats, camera).index.tolist() == [
        1, 4, 0, 2, 5, 3,
    ]  # fmt: skip


def test_near_plane_is_open():
    splats = empty(0, 3)
    splats.scales[:] = -3.0
    splats.means[:, 2] = np.array([-0.5, 0.0, 0.5], np.float32)
    camera = replace(oracle.camera(), rotation=np.eye(3), translation=np.array([0.0, 0.0, 1.0]))
    assert project(splats, camera, near_plane=1.0).index.tolist() == [2]


def test_rows_that_cannot_be_drawn_are_left_out():
    splats = oracle.scene(2, n=20)
    camera = oracle.camera()
    splats.opacities[0] = np.nan
    splats.opacities[1] = -np.inf
    splats.means[2] = np.nan
    splats.means[3] = np.inf
    splats.scales[4] = np.nan
    splats.scales[5] = np.inf
    splats.quats[6] = 0.0
    splats.quats[7] = np.nan
    splats.opacities[8] = -6.0  # below 1/255
    footprints = project(splats, camera)
    assert footprints.index.min() > 8
    assert np.isfinite(footprints.ellipse).all()


def test_without_a_kernel_flat_splats_vanish_instead_of_dividing_by_zero():
    splats = empty(0, 2)
    splats.scales[0] = -200.0
    splats.scales[1] = -2.0
    splats = replace(splats, info=SceneInfo(kernel_px=0.0))
    footprints = project(splats, oracle.camera())
    assert footprints.index.tolist() == [1]


def test_visible_rows_are_sorted():
    splats = oracle.scene(6, n=60)
    footprints = project(splats, oracle.camera())
    rows = footprints.sorted_rows()
    np.testing.assert_array_equal(rows, np.sort(footprints.index))
    np.testing.assert_array_equal(rows[footprints.order], footprints.index)
    np.testing.assert_array_equal(footprints.index[footprints.row_order()], rows)
    assert (rows != footprints.index).any()


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_every_splat_that_reaches_into_the_picture_from_beside_it_is_found(info):
    # A picture with little of the scene in it, and splats from thin to as large as the scene.
    splats, camera = oracle.scene(4, n=400, info=info), oracle.camera(focal=400.0)
    scales = np.random.default_rng(6).uniform(-7.0, -0.5, splats.scales.shape)
    splats = replace(splats, scales=scales.astype(np.float32))
    found = set(project(splats, camera).index.tolist())
    size = np.array([camera.width, camera.height])
    beside = 0
    for index in range(len(splats)):
        bare, centre, _ = oracle.covariance(splats, camera, index)
        thickness, blur = oracle.added(splats, camera, index)
        trained = bare + thickness * np.eye(2)
        wide = trained + blur * np.eye(2)
        opacity = 1 / (1 + np.exp(-float(splats.opacities[index])))
        if blur:
            opacity *= np.sqrt(np.linalg.det(trained) / np.linalg.det(wide))
        if opacity < 1 / 255:
            continue
        reach = np.sqrt(2 * np.log(opacity * 255) * np.diag(wide))
        if ((centre + reach > 0.6) & (centre - reach < size - 0.6)).all():
            assert index in found
            beside += not ((centre > 0.0) & (centre < size)).all()
    assert beside > 20


def test_some_footprints_are_those_of_their_splats_alone():
    splats, camera = oracle.scene(5, n=60), oracle.camera()
    whole = project(splats, camera)
    kept = np.arange(len(whole)) % 3 == 1
    few = whole.only(kept)
    alone = project(splats.take(np.sort(whole.index[kept])), camera)
    for name in ("order", "ellipse", "rows", "added"):
        np.testing.assert_array_equal(getattr(few, name), getattr(alone, name))
    np.testing.assert_array_equal(few.index, whole.index[kept])
    np.testing.assert_array_equal(few.sorted_rows(), np.sort(whole.index[kept]))
