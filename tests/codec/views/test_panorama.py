import numpy as np

from cogsplat.codec.views.panorama import FACE_ROTATIONS, panorama


def test_each_direction_is_in_exactly_one_picture():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(2000, 3))
    position = np.array([4.0, -2.0, 7.0], np.float32)
    seen = np.zeros(len(points), np.int64)
    for camera in panorama(position, 64):
        np.testing.assert_allclose(camera.position, position)
        right, down, forward = ((points + position) @ camera.rotation.T + camera.translation).T
        x, y = camera.fx * right / forward + camera.cx, camera.fy * down / forward + camera.cy
        seen += (forward > 0) & (x >= 0) & (x < 64) & (y >= 0) & (y < 64)
    assert (seen == 1).all()


def test_pictures_look_along_the_axes_and_are_not_mirrored():
    axes = np.concatenate([[axis, -axis] for axis in np.eye(3)])
    np.testing.assert_array_equal(FACE_ROTATIONS[:, 2], axes)
    np.testing.assert_allclose(np.linalg.det(FACE_ROTATIONS), 1.0)
