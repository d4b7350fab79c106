"""Traces: poses at their times, and even movement between them."""

from itertools import pairwise

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.tools.lab.streaming.traces import dolly_trace, orbital_trace, recorded_trace
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

CAMERAS = synth_cameras(48, 64, 48)


def same(one: Camera, other: Camera) -> None:
    np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-6)
    np.testing.assert_allclose(one.position, other.position, atol=1e-6)


def test_a_recorded_path_has_its_poses_at_their_times() -> None:
    trace = recorded_trace(CAMERAS[:5], 0.5)
    assert trace.seconds == 2.0
    for number, camera in enumerate(CAMERAS[:5]):
        same(trace.camera_at(0.5 * number), camera)
    same(trace.camera_at(-1.0), CAMERAS[0])
    same(trace.camera_at(99.0), CAMERAS[4])


def test_between_poses_a_visitor_moves_and_turns_evenly() -> None:
    trace = dolly_trace(CAMERAS)
    assert trace.seconds == 20.0
    poses = [trace.camera_at(seconds) for seconds in np.linspace(0.0, 20.0, 9).tolist()]
    steps = [b.position - a.position for a, b in pairwise(poses)]
    np.testing.assert_allclose(steps, [steps[0]] * 8, atol=1e-6)
    turns = [
        np.arccos((np.trace(b.rotation @ a.rotation.T) - 1.0) / 2.0) for a, b in pairwise(poses)
    ]
    np.testing.assert_allclose(turns, turns[0], rtol=1e-4)
    for pose in poses:
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize(("cameras", "poses"), [(48, 40), (7, 7), (1, 1)])
def test_an_orbital_trace_has_forty_poses_at_most(cameras: int, poses: int) -> None:
    trace = orbital_trace(CAMERAS[:cameras])
    assert len(trace.cameras) == poses
    assert trace.seconds == pytest.approx(78.0 if poses > 1 else 0.0)


def test_a_trace_of_one_pose_stays_there() -> None:
    trace = dolly_trace(CAMERAS[:1])
    assert trace.seconds == 0.0
    same(trace.camera_at(3.0), CAMERAS[0])
