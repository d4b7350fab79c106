import numpy as np
import pytest

from cogsplat.codec.geometry.rotations import matrices
from cogsplat.tools.lab.scheduling.box_projections import (
    centre_depths,
    intersects_frustum,
    screen_coverage,
)
from cogsplat.tools.lab.scheduling.poses import Pose

FORWARD = Pose(np.zeros(3), np.eye(3), 1.0, 0.5)


def test_coverage_is_that_of_the_rectangle_around_the_corners():
    boxes = np.array(
        [
            [-1.0, -1.0, 2.0, 1.0, 1.0, 4.0],
            [-9.0, -9.0, 2.0, 9.0, 9.0, 4.0],
            [5.0, -1.0, 2.0, 6.0, 1.0, 3.0],
            [-1.0, -1.0, -4.0, 1.0, 1.0, -2.0],
            [-1.0, -1.0, -4.0, 1.0, 1.0, 4.0],
        ]
    )
    found = screen_coverage(boxes, FORWARD)
    # The first box covers half the width and the full height.
    np.testing.assert_allclose(found, [0.5, 1.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(centre_depths(boxes, FORWARD), [3.0, 3.0, 2.5, -3.0, 0.0])


@pytest.mark.parametrize("seed", range(5))
def test_boxes_with_visible_points_pass_both_tests(seed):
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
    assert intersects_frustum(boxes, pose)[seen].all()
    assert (screen_coverage(boxes, pose)[seen] > 0.0).all()
    # Both tests are conservative and still reject many invisible boxes.
    assert intersects_frustum(boxes, pose)[~seen].mean() < 0.6
    assert (screen_coverage(boxes, pose)[~seen] > 0.0).mean() < 0.6
