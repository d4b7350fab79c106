import numpy as np
import pytest

from cogsplat.codec.geometry.rotations import matrices
from cogsplat.tools.lab.scheduling.boxes import in_pyramid, middle_depths, picture_shares
from cogsplat.tools.lab.scheduling.poses import Pose

AHEAD = Pose(np.zeros(3), np.eye(3), 1.0, 0.5)


def test_a_box_takes_the_rectangle_around_its_corners():
    boxes = np.array(
        [
            [-1.0, -1.0, 2.0, 1.0, 1.0, 4.0],
            [-9.0, -9.0, 2.0, 9.0, 9.0, 4.0],
            [5.0, -1.0, 2.0, 6.0, 1.0, 3.0],
            [-1.0, -1.0, -4.0, 1.0, 1.0, -2.0],
            [-1.0, -1.0, -4.0, 1.0, 1.0, 4.0],
        ]
    )
    found = picture_shares(boxes, AHEAD)
    # Half as wide as the picture, and higher than it.
    np.testing.assert_allclose(found, [0.5, 1.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(middle_depths(boxes, AHEAD), [3.0, 3.0, 2.5, -3.0, 0.0])


@pytest.mark.parametrize("seed", range(5))
def test_what_a_picture_shows_is_in_the_pyramid_and_has_a_share(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-6.0, 6.0, (300, 3))
    boxes = np.concatenate([low, low + rng.uniform(0.0, 3.0, (300, 3))], axis=1)
    quat = rng.normal(size=4)
    rotation = matrices(quat[None] / np.linalg.norm(quat))[0]
    pose = Pose(rng.normal(size=3), rotation, 0.8, 0.6)
    places = rng.random((2000, 1, 3))
    points = boxes[:, :3] + places * (boxes[:, 3:] - boxes[:, :3])
    local = (points - pose.position) @ pose.rotation.T
    depth = local[:, :, 2]
    seen = (
        (depth > 0.3)
        & (np.abs(local[:, :, 0]) < pose.tan_x * depth)
        & (np.abs(local[:, :, 1]) < pose.tan_y * depth)
    ).any(axis=0)
    assert 20 < seen.sum() < 280
    assert in_pyramid(boxes, pose)[seen].all()
    assert (picture_shares(boxes, pose)[seen] > 0.0).all()
    # Both tests are generous, and still leave out much of what is not seen.
    assert in_pyramid(boxes, pose)[~seen].mean() < 0.6
    assert (picture_shares(boxes, pose)[~seen] > 0.0).mean() < 0.6
