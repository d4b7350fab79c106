"""Votes of one mask against brute force."""

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.label_votes import label_votes


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_votes_are_the_weights_by_label(info):
    splats = oracle.scene(7, n=80, opacity=4.0, info=info)
    camera = oracle.camera(width=41, height=35)
    labels = np.random.default_rng(1).integers(0, 3, (35, 41)).astype(np.int32)
    index, votes = label_votes(splats, camera, labels, 4)
    weights = oracle.view(splats, camera).weights
    expected = np.stack([weights[labels.ravel() == k].sum(axis=0) for k in range(4)], axis=1)
    found = np.zeros((80, 4))
    found[index] = votes
    assert (expected[:, :3].max(axis=0) > 1.0).all()
    np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max())
    assert not found[:, 3].any(), "a label without pixels"


def test_hidden_splats_have_no_votes():
    splats, camera = oracle.scene(1, n=3), oracle.camera(width=16, height=16)
    splats.means[:] = camera.position + camera.rotation[2] * np.array([[0.5], [0.6], [0.7]])
    splats.scales[:] = 3.0
    splats.opacities[:] = np.inf
    index, votes = label_votes(splats, camera, np.zeros((16, 16), np.int32), 1)
    assert index.tolist() == [0, 1, 2]
    np.testing.assert_allclose(votes[:, 0], [256 * 0.99, 0.0, 0.0], rtol=1e-6)
