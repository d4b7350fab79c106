"""Peak weights of a small picture against brute force."""

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.peak_weights import peak_weights
from cogsplat.codec.splats import empty


@pytest.mark.parametrize("seed", range(3))
def test_peaks_are_the_largest_weights_of_brute_force(seed):
    splats, camera = oracle.scene(seed, opacity=3.0), oracle.camera()
    index, peaks = peak_weights(splats, camera)
    found = np.zeros(len(splats))
    found[index] = peaks
    np.testing.assert_allclose(found, oracle.view(splats, camera).weights.max(axis=0), atol=2e-4)
    depths = (splats.means[index] @ camera.rotation.T + camera.translation)[:, 2]
    assert (np.diff(depths) >= -1e-5).all(), "nearest first"


def test_a_splat_that_closes_the_picture_is_seen_and_hidden_splats_are_not():
    splats, camera = empty(0, 3), oracle.camera()
    splats.means[:] = camera.position + camera.rotation[2] * np.array([[0.5], [0.6], [0.7]])
    splats.scales[:] = 3.0
    splats.opacities[:] = np.inf
    index, peaks = peak_weights(splats, camera)
    assert index.tolist() == [0, 1, 2]
    np.testing.assert_allclose(peaks, [0.99, 0.01 * 0.99, 0.0], rtol=1e-4)


def test_the_near_plane_is_that_of_the_caller():
    splats, camera = empty(0, 2), oracle.camera()
    splats.means[:] = camera.position + camera.rotation[2] * np.array([[0.5], [2.0]])
    assert peak_weights(splats, camera, 1.0)[0].tolist() == [1]
    assert peak_weights(splats, camera, 0.1)[0].tolist() == [0, 1]
