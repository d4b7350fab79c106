import numpy as np
import pytest

from cogsplat.tools.lab.scheduling.poses import LOOKAHEAD, Pose, extrapolate, predicted_poses
from cogsplat.tools.lab.synthetic.terrace import synth_cameras


def turned(angle, position=(0.0, 0.0, 0.0)):
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return Pose(np.array(position), rotation, 0.7, 0.5)


def test_a_camera_becomes_the_pose_of_its_picture():
    camera = synth_cameras(1)[0]
    pose = Pose.from_camera(camera)
    np.testing.assert_allclose(pose.rotation @ pose.position + camera.translation, 0, atol=1e-12)
    corner = np.array([pose.tan_x, pose.tan_y, 1.0])
    assert camera.fx * corner[0] + camera.cx == pytest.approx(camera.width)
    assert camera.fy * corner[1] + camera.cy == pytest.approx(camera.height)


def test_motion_is_extrapolated():
    now, before = turned(0.1, (1.0, 0.0, 2.0)), turned(0.0, (0.8, 0.0, 2.1))
    soon = extrapolate(now, before, 0.1, 0.2)
    np.testing.assert_allclose(soon.position, [1.4, 0.0, 1.8])
    np.testing.assert_allclose(soon.rotation @ soon.rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(soon.rotation), 1.0)
    # Linear extrapolation turns a little less than a rotation would.
    np.testing.assert_allclose(soon.rotation[2], turned(0.3).rotation[2], atol=0.01)
    # At most four times the observed motion is extrapolated.
    np.testing.assert_allclose(extrapolate(now, before, 0.1, 9.0).position, [1.8, 0.0, 1.6])


def test_without_elapsed_time_the_pose_stays():
    now, before = turned(0.1), turned(0.0, (5.0, 0.0, 0.0))
    assert extrapolate(now, before, 0.0, 1.0) is now
    assert extrapolate(now, before, 1.0, 0.0) is now
    # An extrapolated rotation of zero has no direction.
    mirrored = Pose(now.position, -now.rotation, 0.7, 0.5)
    still = extrapolate(mirrored, Pose(now.position, -2.0 * now.rotation, 0.7, 0.5), 1.0, 1.0)
    np.testing.assert_allclose(np.abs(still.rotation @ now.rotation.T), np.eye(3), atol=1e-12)


def test_the_current_pose_has_the_largest_weight():
    now, before = turned(0.1), turned(0.0)
    poses = predicted_poses(now, before, 0.5)
    assert poses[0][0] is now
    assert [weight for _, weight in poses] == [weight for _, weight in LOOKAHEAD]
    assert np.all(np.diff([weight for _, weight in poses]) < 0)
