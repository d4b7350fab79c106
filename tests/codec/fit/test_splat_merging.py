from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.fit.splat_merging import covariances, merge_candidates, merge_pairs
from cogsplat.codec.geometry import rotations
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

ROWS = np.array([0]), np.array([1])


def two_of(splats, row, apart=0.0):
    """Return one splat twice, the second a little further along its longest axis."""
    both = splats.take(np.array([row, row]))
    axes = rotations.matrices(rotations.unit(both.quats))
    longest = int(both.scales[0].argmax())
    off = apart * np.exp(both.scales[0, longest]) * axes[0, :, longest]
    means = both.means.copy()
    means[1] += off.astype(np.float32)
    return replace(both, means=means)


def test_merged_moments_are_those_of_samples_of_both():
    rng = np.random.default_rng(0)
    splats = oracle.scene(4, n=2)
    found = merge_pairs(splats, *ROWS).take(ROWS[0])
    areas = np.exp(2 / 3 * splats.scales.sum(axis=1, dtype=np.float64))
    masses = areas / (1 + np.exp(-splats.opacities.astype(np.float64)))
    shares = masses / masses.sum()
    counts = np.round(shares * 400_000).astype(int)
    samples = np.concatenate(
        [
            rng.multivariate_normal(mean, spread, count)
            for mean, spread, count in zip(splats.means, covariances(splats), counts, strict=True)
        ]
    )
    size = np.sqrt(np.trace(np.cov(samples.T)))
    np.testing.assert_allclose(found.means[0], samples.mean(axis=0), atol=0.01 * size)
    np.testing.assert_allclose(covariances(found)[0], np.cov(samples.T), atol=0.01 * size**2)
    np.testing.assert_allclose(found.sh0[0], shares @ splats.sh0, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        found.shN[0], np.einsum("n,nkc->kc", shares, splats.shN), rtol=1e-4, atol=1e-6
    )


def test_two_equal_splats_merge_into_one_of_twice_the_opacity():
    splats = oracle.scene(5, n=1)
    halves = two_of(splats, 0)
    # The opacity doubles; occlusion between the two is neglected.
    alpha = 0.3
    halves = replace(halves, opacities=np.full(2, np.log(alpha / (1 - alpha)), np.float32))
    found = merge_pairs(halves, *ROWS)
    assert found.opacities[0] == pytest.approx(np.log(0.6 / 0.4), abs=1e-4)
    np.testing.assert_allclose(covariances(found)[0], covariances(splats)[0], rtol=1e-4, atol=1e-9)
    # The removed splat and the given scene are unchanged.
    assert found.opacities[1] == halves.opacities[1]
    assert halves.opacities[0] == halves.opacities[1]


def test_only_similar_splats_are_candidates():
    splats = oracle.scene(6, n=1)
    near, far = two_of(splats, 0, 0.5), two_of(splats, 0, 8.0)
    other = replace(near, sh0=near.sh0 + np.array([[0], [4]], np.float32))
    errors = np.array([1.0, 2.0])
    kept, removed = merge_candidates(near, errors, 5)
    assert (kept.tolist(), removed.tolist()) == ([1], [0])
    for unlike in (far, other):
        assert not len(merge_candidates(unlike, errors, 5)[0])
    assert not len(merge_candidates(near, errors, 0)[0])
    assert not len(merge_candidates(near.take(slice(0, 1)), errors[:1], 5)[0])


def test_pairs_are_disjoint_and_remove_splats_of_small_error():
    splats = synth(800, seed=6)
    errors = np.random.default_rng(1).random(800)
    kept, removed = merge_candidates(splats, errors, 60)
    rows = np.concatenate([kept, removed])
    assert 20 < len(kept) <= 60
    assert len(np.unique(rows)) == len(rows)
    assert errors[removed].max() <= np.median(errors)


def test_merging_loses_less_than_deletion():
    splats, cameras = synth(2500, seed=7), synth_cameras(4, 96, 72)
    errors = np.exp(splats.scales.sum(axis=1, dtype=np.float64))
    kept, removed = merge_candidates(splats, errors, 300)
    assert len(kept) > 100
    left = np.setdiff1d(np.arange(len(splats)), removed)
    both = [splats.take(left), merge_pairs(splats, kept, removed).take(left)]
    deleted, together = (
        np.mean([psnr(render(splats, view), render(each, view)) for view in cameras])
        for each in both
    )
    assert together > deleted + 1.0


def test_splats_of_size_0_give_finite_values():
    splats = synth(50, seed=8)
    splats.scales[:25] = -1000.0
    splats.means[:10] = splats.means[0]
    kept, removed = merge_candidates(splats, np.ones(50), 50)
    found = merge_pairs(splats, kept, removed)
    assert np.isfinite(found.scales).all()
    assert np.isfinite(found.opacities).all()
