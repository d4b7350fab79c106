"""Densification: halves look like the split splat, and large gradients decide what is split."""

import numpy as np
import pytest

from cogsplat.codec.fit.densification import Densification, split
from cogsplat.codec.fit.splat_adam import SplatAdam
from cogsplat.codec.geometry import rotations
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

MIN_OPACITY = 0.005


def covariances(splats):
    axes = rotations.matrices(rotations.unit(splats.quats))
    squares = np.exp(2 * splats.scales.astype(np.float64))
    return np.einsum("nij,nj,nkj->nik", axes, squares, axes)


def test_both_halves_have_the_mean_and_covariance_of_the_splat():
    splats = synth(50)
    two = split(splats)
    first, second = two.take(np.arange(50)), two.take(np.arange(50, 100))
    np.testing.assert_allclose((first.means + second.means) / 2, splats.means, atol=1e-5)
    off = (first.means - second.means).astype(np.float64) / 2
    together = (covariances(first) + covariances(second)) / 2
    together += np.einsum("ni,nj->nij", off, off)
    np.testing.assert_allclose(together, covariances(splats), rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(
    ("opacity", "min_db"), [(0.1, 60.0), (0.5, 45.0), (0.95, 35.0), (0.999, 30.0)]
)
def test_halves_look_like_the_splat(opacity, min_db):
    one = synth(40).take(np.array([7]))
    one.means[:] = 0.0
    one.scales[:] = np.log([0.5, 0.2, 0.1])
    one.opacities[:] = np.log(opacity / (1 - opacity))
    camera = synth_cameras(1, 96, 72)[0]
    whole, cut = render(one, camera), render(split(one), camera)
    assert psnr(whole, cut) > min_db
    # Opaque splats become wider at their flanks; the centre keeps its transmittance.
    y, x = np.unravel_index(whole.sum(axis=2).argmax(), whole.shape[:2])
    np.testing.assert_allclose(cut[y, x], whole[y, x], rtol=0.04)


def test_splats_of_infinite_opacity_are_split_into_finite_ones():
    one = synth(3)
    one.opacities[:] = [np.inf, 400.0, -20.0]
    assert np.isfinite(split(one).opacities).all()


def test_splats_with_the_largest_mean_gradients_are_split_unless_frozen():
    scene = synth(20)
    scene.opacities[:] = 2.0
    scene.opacities[[2, 11]] = -9.0
    densification = Densification(frozen=5, target=18, steps=100, min_opacity=MIN_OPACITY)
    sizes = np.linspace(1.0, 20.0, 20)
    for seen in (np.arange(20), np.arange(10)):
        # The mean over views counts: twice as many views do not change it.
        densification.accumulate(seen, np.stack([sizes[seen], np.zeros(len(seen))], axis=1), 20)
    grown, adam = densification.densify(scene, SplatAdam(scene), 56)
    # 14 of 15 are opaque enough, and the last densification reaches the target.
    assert len(grown) == 5 + 18
    for name in ("means", "scales", "opacities"):
        np.testing.assert_array_equal(getattr(grown, name)[:5], getattr(scene, name)[:5])
    whole = {tuple(row) for row in grown.means.tolist()}
    split_rows = [row for row in range(20) if tuple(scene.means[row].tolist()) not in whole]
    assert split_rows == [11, 16, 17, 18, 19]
    assert adam.state()["adam_means.means"].shape == (23, 3)


def test_densification_ends_after_60_percent_of_the_steps():
    densification = Densification(frozen=0, target=100, steps=200, min_opacity=MIN_OPACITY)
    due = [step for step in range(1, 201) if densification.is_due(step)]
    assert len(due) == 8
    assert due[-1] <= 120
    assert not any(Densification(0, 100, 1, MIN_OPACITY).is_due(step) for step in range(3))


def test_splats_without_gradients_are_not_split():
    scene = synth(10)
    scene.opacities[:] = 2.0
    densification = Densification(frozen=0, target=100, steps=100, min_opacity=MIN_OPACITY)
    densification.accumulate(np.arange(4), np.ones((4, 2)), 10)
    assert len(densification.densify(scene, SplatAdam(scene), 56)[0]) == 14
