from dataclasses import replace

import numpy as np
import oracle
import pytest
from scipy.spatial.transform import Rotation

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError


def refused(**changes):
    with pytest.raises(DataError, match=r"camera '.*expected") as caught:
        replace(oracle.camera(), **changes)
    assert caught.value.code == "bad-camera"


def test_the_position_is_what_the_pose_sends_to_zero():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        camera = replace(
            oracle.camera(),
            rotation=Rotation.random(random_state=seed).as_matrix(),
            translation=rng.normal(size=3) * 100,
        )
        origin = camera.rotation @ camera.position + camera.translation
        np.testing.assert_allclose(origin, 0, atol=1e-12)


def test_poses_become_c_ordered_float64():
    camera = replace(
        oracle.camera(),
        rotation=np.asfortranarray(np.eye(3, dtype=np.float32)),
        translation=np.array([1, 2, 3]),
    )
    for array in (camera.rotation, camera.translation):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    assert camera.position.tolist() == [-1, -2, -3]


@pytest.mark.parametrize("size", [0, -1, 65536, float("nan")])
def test_sizes_out_of_range_are_refused(size):
    refused(width=size)
    refused(height=size)
    assert replace(oracle.camera(), width=1, height=65535).height == 65535


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_not_finite_are_refused(value):
    for name in ("fx", "fy", "cx", "cy"):
        refused(**{name: value})
    translation = np.array([0.0, value, 0.0])
    refused(translation=translation)
    rotation = np.eye(3)
    rotation[1, 2] = value
    refused(rotation=rotation)


@pytest.mark.parametrize("focal", [0.0, -1.0])
def test_focal_lengths_must_be_positive(focal):
    refused(fx=focal)
    refused(fy=focal)
    assert replace(oracle.camera(), cx=-50.0, cy=1e6).cx == -50.0


def test_what_is_no_rotation_is_refused():
    for rotation in (
        np.diag([1.0, 1.0, -1.0]),
        -np.eye(3),
        1.001 * np.eye(3),
        np.zeros((3, 3)),
        np.eye(3) + np.array([[0, 2e-3, 0], [0, 0, 0], [0, 0, 0]]),
        np.full((3, 3), 1e200),
        np.full((3, 3), -1e308),
        1e200 * np.array([[1, 1, 0], [1, -1, 0], [0, 0, 1]]),
    ):
        refused(rotation=rotation)


def test_rotations_of_rounded_decimals_are_taken():
    rotation = np.round(Rotation.random(random_state=3).as_matrix(), 4)
    camera = replace(oracle.camera(), rotation=rotation)
    np.testing.assert_array_equal(camera.rotation, rotation)


@pytest.mark.parametrize("shape", [(3,), (3, 4), (4, 4), (2, 3), (1, 3, 3), (0,)])
def test_poses_of_another_shape_are_refused(shape):
    refused(rotation=np.ones(shape))
    if shape != (3,):
        refused(translation=np.ones(shape))


def test_errors_name_the_camera():
    with pytest.raises(DataError, match=r"camera 'IMG_7\.jpg': size 0x4"):
        Camera(0, 4, 1.0, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3), "IMG_7.jpg")


def test_a_target_lies_in_front_of_the_camera():
    camera = oracle.camera()
    ahead = camera.position + 2.0 * camera.rotation[2]
    kept = replace(camera, target=ahead.astype(np.float32)).target
    assert kept is not None
    assert kept.dtype == np.float64
    for target in (
        camera.position - camera.rotation[2],
        ahead[:2],
        ahead * np.nan,
    ):
        refused(target=target)


def test_a_resized_camera_shows_the_same_picture():
    camera = oracle.camera()
    point = camera.rotation.T @ (np.array([0.3, -0.2, 2.0]) - camera.translation)

    def seen(view):
        x, y, z = view.rotation @ point + view.translation
        return (view.fx * x / z + view.cx) / view.width, (view.fy * y / z + view.cy) / view.height

    for small in (camera.resized(37), camera.resized(37, 5), camera.resized(3 * camera.width)):
        np.testing.assert_allclose(seen(small), seen(camera))
    assert camera.resized(37).height == round(37 * camera.height / camera.width)
    assert camera.resized(1).height == 1
