"""Candidate views: the splats seen from a pose, and their exposure."""

import pickle

import numpy as np
import oracle

from cogsplat.codec.render.peak_weights import peak_weights
from cogsplat.codec.views.candidates import CandidateInputs, draw_candidate
from cogsplat.codec.views.pose import Lens, Pose
from cogsplat.codec.views.subsample import subsample

DOWN = np.array([0.0, 1.0, 0.0])


def drawing(near_plane=0.2):
    scene = subsample(oracle.scene(4, n=300, degree=0), 300)
    return CandidateInputs(scene, 0.05, Lens(48, 36, 0.6), DOWN, near_plane)


def test_seen_splats_have_a_weight_in_the_picture():
    given = drawing()
    pose = Pose(np.array([0.0, 0.0, -4.0]), np.array([0.0, 0.0, 1.0]), 1.0)
    found = draw_candidate(pose, given)
    index, peaks = peak_weights(given.scene.splats, pose.camera(given.lens, DOWN), 0.2)
    np.testing.assert_array_equal(found.index, index[peaks > 0.02])
    assert len(found.index) > 10
    # Exposure is at most the peak weight.
    assert (found.exposure <= found.peaks).all()
    assert found.exposure.max() > 0


def test_steep_views_count_less_than_level_ones():
    given = drawing()
    level = Pose(np.array([0.0, 0.0, -4.0]), np.array([0.0, 0.0, 1.0]), 1.0)
    above = Pose(np.array([0.0, -4.0, 0.0]), np.array([0.0, 1.0, 0.0]), 1.0)
    shares = [
        float(found.exposure.sum() / found.peaks.sum())
        for found in (draw_candidate(level, given), draw_candidate(above, given))
    ]
    assert shares[1] < 0.5 * shares[0]


def test_a_candidate_can_be_drawn_in_another_process():
    pose = Pose(np.array([0.0, 0.0, -4.0]), np.array([0.0, 0.0, 1.0]), 1.0)
    there = draw_candidate(*pickle.loads(pickle.dumps((pose, drawing()))))
    here = draw_candidate(pose, drawing())
    np.testing.assert_array_equal(there.exposure, here.exposure)
