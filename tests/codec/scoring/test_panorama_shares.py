import numpy as np
import oracle

from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.scoring.panorama_shares import FACE_SIDE, panorama_shares
from cogsplat.codec.views.panorama import panorama


def test_shares_are_the_means_over_the_six_pictures():
    splats = oracle.scene(3, n=150)
    chunks = np.arange(150) // 50
    places = np.stack([oracle.camera(angle=0.3).position, [0.1, 0.2, 0.0]])
    found = panorama_shares(splats, chunks, 4, places)
    for place, shares in zip(places, found, strict=True):
        pictures = panorama(place, FACE_SIDE)
        weights = sum(oracle.view(splats, camera).weights.sum(axis=0) for camera in pictures)
        expected = [weights[chunks == chunk].sum() for chunk in range(4)]
        np.testing.assert_allclose(shares, np.array(expected) / (6 * FACE_SIDE**2), atol=2e-4)
        assert 0.01 < shares.sum() < 1.0
    alone = panorama_shares(splats, chunks, 4, places, executor=LocalThreads(1))
    np.testing.assert_array_equal(found, alone)
