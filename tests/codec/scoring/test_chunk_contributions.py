import numpy as np
import oracle

from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.render import front_to_back, splat_blocks
from cogsplat.codec.scoring.chunk_contributions import MAX_PIXELS, chunk_contributions

CAMERAS = [
    oracle.camera(angle=0.3),
    oracle.camera(angle=1.4, width=40, height=50, shift=3.0),
    oracle.camera(angle=-0.9, width=33, height=17, distance=2.0),
]


def test_shares_are_the_sums_of_blending_weights_by_chunk():
    splats = oracle.scene(3, n=150)
    chunks = np.random.default_rng(1).integers(0, 4, 150)
    shares = chunk_contributions(splats, chunks, 5, CAMERAS)
    for camera, found in zip(CAMERAS, shares, strict=True):
        weights = oracle.view(splats, camera).weights.sum(axis=0)
        expected = [weights[chunks == chunk].sum() for chunk in range(5)]
        expected = np.array(expected) / (camera.width * camera.height)
        np.testing.assert_allclose(found, expected, atol=2e-4)
        assert found[4] == 0.0
        assert 0.01 < found.sum() < 1.0


def test_large_pictures_are_reduced_without_changing_the_shares():
    splats = oracle.scene(5, n=200)
    chunks = np.arange(200) // 50
    large = oracle.camera(angle=0.3, width=300, height=200, focal=240.0)
    assert 2 * MAX_PIXELS < 300 * 200
    found = chunk_contributions(splats, chunks, 4, [large])
    again = chunk_contributions(splats, chunks, 4, [large], executor=LocalThreads(1))
    np.testing.assert_array_equal(found, again)
    weights = oracle.view(splats, large).weights.sum(axis=0) / (300 * 200)
    expected = [weights[chunks == chunk].sum() for chunk in range(4)]
    assert max(expected) > 0.1
    np.testing.assert_allclose(found[0], expected, atol=0.01)


def test_shares_are_the_same_with_blocks(monkeypatch):
    splats = oracle.scene(7, n=4000)
    chunks = np.arange(4000, dtype=np.int32) // 500
    whole = chunk_contributions(splats, chunks, 8, CAMERAS)
    monkeypatch.setattr(splat_blocks, "MIN_BLOCKED_SPLATS", 1)
    monkeypatch.setattr(front_to_back, "_FIRST", 512)
    np.testing.assert_array_equal(chunk_contributions(splats, chunks, 8, CAMERAS), whole)
    assert whole.any()
