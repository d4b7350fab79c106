import numpy as np
import pytest

from cogsplat.codec.geometry.rotations import matrices
from cogsplat.codec.views.panorama import FACE_ROTATIONS
from cogsplat.tools.lab.scheduling.box_projections import (
    centre_depths,
    intersects_frustum,
    panorama_coverage,
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


def test_coverage_is_that_of_the_part_of_a_box_that_is_ahead() -> None:
    boxes = np.array(
        [
            # Beside the eye and out of view, though some corners are ahead.
            [-16.0, -2.0, -9.0, -3.0, 2.0, 1.9],
            # Its side at x = 1 leaves the picture at depth 1, and its far end stands at depth 4.
            [1.0, -1.0, -9.0, 3.0, 1.0, 4.0],
        ]
    )
    found = screen_coverage(boxes, FORWARD)
    np.testing.assert_allclose(found, [0.0, (1.0 - 0.25) / 2.0])


@pytest.mark.parametrize("seed", range(5))
def test_coverage_is_at_least_the_share_of_rays_that_meet_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.normal(size=(400, 3)) * 3.0
    boxes = np.concatenate([low, low + rng.exponential(3.0, (400, 3))], axis=1)
    quat = rng.normal(size=4)
    rotation = matrices(quat[None] / np.linalg.norm(quat))[0]
    pose = Pose(np.zeros(3), rotation, 0.7, 0.5)
    across, down = (a.ravel() for a in np.meshgrid(*[(np.arange(60) + 0.5) / 30.0 - 1.0] * 2))
    rays = np.stack([0.7 * across, 0.5 * down, np.ones(3600)], axis=1) @ rotation
    one, other = boxes[:, None, :3] / rays, boxes[:, None, 3:] / rays
    near, far = np.minimum(one, other).max(axis=2), np.maximum(one, other).min(axis=2)
    rays_met = ((far >= near) & (far > 0.2)).mean(axis=1)
    found = screen_coverage(boxes, pose)
    assert (rays_met > 0.0).sum() > 40
    # The rectangle is larger than what it surrounds, by less than a cell of the rays at each edge.
    assert (found >= rays_met - 0.05).all()
    assert ((rays_met == 0.0) & (found > 0.0)).mean() < 0.05


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


def test_coverage_of_a_panorama_is_the_mean_of_its_pictures_to_the_bit() -> None:
    rng = np.random.default_rng(8)
    low = rng.uniform(-4.0, 3.0, (4000, 3)).astype(np.float32).astype(np.float64)
    boxes = np.concatenate([low, low + rng.choice([0.0, 0.1, 1.0, 3.0], (4000, 3))], axis=1)
    for position in (np.zeros(3), np.array([0.3, -1.0, 2.0])):
        total = np.zeros(len(boxes))
        for rotation in FACE_ROTATIONS:
            total += screen_coverage(boxes, Pose(position, rotation, 1.0, 1.0))
        found = panorama_coverage(boxes, position)
        np.testing.assert_array_equal(found, total / 6.0)
        assert (found > 0.0).mean() > 0.9


def test_a_box_around_a_viewpoint_covers_its_panorama() -> None:
    boxes = np.array([[-1.0, -1.0, -1.0, 1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 2.0, 1.0, 1.0]])
    np.testing.assert_allclose(panorama_coverage(boxes, np.zeros(3)), [1.0, 1.0 / 6.0])
