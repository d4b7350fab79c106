from dataclasses import replace

import numpy as np
import oracle
import pytest
from gsplat_on_cpu import on_cpu

from cogsplat.codec.errors import Cancelled, DataError
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import (
    COVERING_ENERGY,
    COVERING_SHARE,
    ScoreConfig,
    Scorer,
    score,
)
from cogsplat.codec.scoring.view_sums import SHOWN_WEIGHT
from cogsplat.codec.splats import SceneInfo, empty
from cogsplat.codec.views.roam_views import jitter

# Of unlike sizes, so that averages over views and over pixels differ.
CAMERAS = [
    oracle.camera(angle=0.3),
    oracle.camera(angle=1.4, width=40, height=50, shift=3.0),
    oracle.camera(angle=-0.9, width=33, height=17, distance=2.0),
]


def _close(actual, expected, scale):
    """Check equality except in a few pixels near a cut, which float32 may decide differently."""
    off = np.abs(actual - expected)
    assert off.max() <= 2e-3 * scale, f"off by {off.max() / scale:.2e} of the largest"
    assert np.mean(off > 1e-5 * scale) < 0.05


@pytest.mark.parametrize("top_k", [0, 1, 3, 20])
@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_scores_equal_brute_force(top_k, info):
    splats = oracle.scene(3, n=150, info=info)
    scores = score(splats, CAMERAS, ScoreConfig(top_k=top_k, jitter=False))
    seen = [oracle.view(splats, camera) for camera in CAMERAS]
    pixels = sum(camera.width * camera.height for camera in CAMERAS)
    kept = [oracle.top_weights(view, top_k).sum(axis=0) for view in seen]
    contribution = np.mean(kept, axis=0)
    _close(scores.contribution, contribution, contribution.max())
    if top_k:
        assert not np.allclose(contribution, np.mean([v.weights.sum(axis=0) for v in seen], axis=0))

    bases = [np.abs(oracle.real_sh(oracle.directions(splats, camera), 3)) for camera in CAMERAS]
    per_basis = sum(b * k[:, None] for b, k in zip(bases, kept, strict=True)) / pixels
    assert len(set(per_basis.argmax(axis=1))) > 5, "too few bases were tried"
    sensitivity = per_basis.max(axis=1)
    _close(scores.colour_sensitivity, sensitivity, sensitivity.max())

    energy = sum(np.square(view.weights).sum(axis=0) for view in seen) / pixels
    _close(scores.energy, energy, energy.max())
    of_views = [
        np.square(view.weights).sum(axis=0) / (camera.width * camera.height)
        for view, camera in zip(seen, CAMERAS, strict=True)
    ]
    largest = np.max(of_views, axis=0)
    _close(scores.largest_energy, largest, largest.max())
    peak = np.max([view.weights.max(axis=0) for view in seen], axis=0)
    _close(scores.peak, peak, 1.0)
    count = sum((view.weights >= SHOWN_WEIGHT).any(axis=0) for view in seen)
    assert (count < sum((view.weights > 0).any(axis=0) for view in seen)).any()
    np.testing.assert_array_equal(scores.shown, count)
    assert scores.num_pixels == pixels


@pytest.mark.parametrize("basis", range(16))
def test_sensitivity_is_the_derivative_of_the_mean_pixel(basis):
    # One splat in one view: the basis that is largest there must be the one reported, and every
    # basis' derivative, measured on renders, must be |Y| times the contribution.
    splats = oracle.scene(20 + basis, n=1)
    splats.means[:] = 0.0
    splats.sh0[:] = 0.0
    splats.shN[:] = 0.0
    camera = oracle.camera(angle=0.4 * basis)
    scores = score(splats, [camera], ScoreConfig(jitter=False))
    values = np.abs(oracle.real_sh(oracle.directions(splats, camera), 3))[0]
    assert scores.colour_sensitivity[0] == pytest.approx(
        values.max() * scores.contribution[0] / scores.num_pixels, rel=1e-6
    )
    changed = replace(splats, sh0=splats.sh0.copy(), shN=splats.shN.copy())
    step = 0.125
    if basis:
        changed.shN[0, basis - 1] = step
    else:
        changed.sh0[0] = step
    slope = np.abs(
        render(changed, camera).mean(axis=(0, 1)) - render(splats, camera).mean(axis=(0, 1))
    )
    expected = values[basis] * scores.contribution[0] / scores.num_pixels
    np.testing.assert_allclose(slope / step, expected, rtol=1e-3, atol=1e-6)
    assert scores.colour_sensitivity[0] >= expected * (1 - 1e-6)


def test_energy_predicts_the_error_of_a_wrong_colour():
    splats = oracle.scene(4, n=100, degree=0)
    splats.sh0[:] = 2.0  # bright enough that nothing is clamped
    scores = score(splats, CAMERAS, ScoreConfig(jitter=False))
    changed = replace(splats, sh0=splats.sh0.copy())
    worst = int(scores.energy.argmax())
    changed.sh0[worst] += 0.25 / 0.28209479177387814
    errors = [
        np.square(render(changed, camera) - render(splats, camera)).mean(axis=2).ravel()
        for camera in CAMERAS
    ]
    assert np.concatenate(errors).mean() == pytest.approx(scores.energy[worst] * 0.25**2, rel=1e-4)


def test_jitter_adds_the_mean_over_the_copies():
    splats = oracle.scene(5, n=120)
    copies = jitter(splats, CAMERAS)
    plain = score(splats, CAMERAS, ScoreConfig(jitter=False))
    other = score(splats, copies, ScoreConfig(jitter=False))
    both = score(splats, CAMERAS, ScoreConfig(jitter=True))
    np.testing.assert_allclose(both.contribution, plain.contribution + other.contribution)
    np.testing.assert_allclose(both.energy, (plain.energy + other.energy) / 2)
    np.testing.assert_array_equal(both.peak, np.maximum(plain.peak, other.peak))
    np.testing.assert_array_equal(both.shown, plain.shown + other.shown)
    assert both.num_pixels == plain.num_pixels + other.num_pixels
    bound = (plain.colour_sensitivity + other.colour_sensitivity) / 2
    assert (both.colour_sensitivity <= bound * (1 + 1e-9)).all()
    assert (both.colour_sensitivity >= bound / 2).all()


def test_covering_views_count_in_maxima_and_in_no_mean():
    splats = oracle.scene(8, n=60)
    config = ScoreConfig(jitter=False, sensitivity_every=1)
    given, rest = CAMERAS[:1], CAMERAS[1:]
    alone, other = score(splats, given, config), score(splats, rest, config)
    both = score(splats, given, config, covering=rest)
    for name in ("contribution", "colour_sensitivity", "energy", "basis_mean", "basis_spread"):
        np.testing.assert_array_equal(getattr(both, name), getattr(alone, name), err_msg=name)
    np.testing.assert_array_equal(both.sensitivities.means, alone.sensitivities.means)
    assert (other.peak > alone.peak).any()
    best = np.maximum(alone.peak, np.float32(COVERING_SHARE) * other.peak)
    np.testing.assert_allclose(both.peak, best, rtol=1e-6)
    largest = np.maximum(alone.largest_energy, COVERING_ENERGY * other.largest_energy)
    np.testing.assert_allclose(both.largest_energy, largest, rtol=1e-12)
    peaks = [score(splats, [camera], config).peak for camera in rest]
    shown = sum((np.float32(COVERING_SHARE) * peak >= SHOWN_WEIGHT) for peak in peaks)
    np.testing.assert_array_equal(both.shown, alone.shown + shown)
    np.testing.assert_array_equal(both.covered, alone.covered + other.covered)


def test_views_may_be_added_in_parts():
    """The second part has the copies that it has as the rest of one list."""
    splats = oracle.scene(8, n=60)
    config = ScoreConfig(jitter_copies=1, sensitivity_every=1)
    expected = score(splats, CAMERAS, config)
    scorer = Scorer(splats, config)
    scorer.add(CAMERAS[:1], jittered=True)
    assert 0 < scorer.sums.shown.max() <= 2
    scorer.add(CAMERAS[1:], jittered=True)
    found = scorer.scores()
    for name in ("contribution", "colour_sensitivity", "energy", "largest_energy", "basis_mean"):
        values = getattr(expected, name)
        np.testing.assert_allclose(
            getattr(found, name), values, rtol=1e-6, atol=1e-9 * values.max(), err_msg=name
        )
    np.testing.assert_array_equal(found.peak, expected.peak)
    np.testing.assert_array_equal(found.shown, expected.shown)
    np.testing.assert_allclose(
        found.sensitivities.means, expected.sensitivities.means, rtol=1e-9, atol=1e-30
    )


def test_scores_do_not_depend_on_threads():
    splats = oracle.scene(6, n=300)
    for cameras in (CAMERAS, CAMERAS[:1]):
        expected = score(splats, cameras, ScoreConfig(threads=1, jitter=False))
        for threads in (2, 3, 7):
            actual = score(splats, cameras, ScoreConfig(threads=threads, jitter=False))
            for name in ("contribution", "colour_sensitivity", "energy", "peak", "shown"):
                np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), name)


def test_of_equal_weights_the_nearest_counts():
    # Alpha 1/4, and 1/3 of the 3/4 that it leaves: both weigh 1/4 in every pixel.
    splats = empty(0, 2)
    splats.scales[:] = 12.0
    splats.means[:, 2] = [1.0, 0.0]
    splats.opacities[:] = [np.log(1 / 2), np.log(1 / 3)]
    camera = oracle.camera(width=16, height=16)
    everything = score(splats, [camera], ScoreConfig(top_k=0, jitter=False))
    assert everything.contribution.tolist() == [64.0, 64.0]
    largest = score(splats, [camera], ScoreConfig(top_k=1, jitter=False))
    assert largest.contribution.tolist() == [0.0, 64.0]


def test_huge_top_k_counts_everything():
    splats = oracle.scene(7)
    everything = score(splats, CAMERAS, ScoreConfig(top_k=0, jitter=False))
    huge = score(splats, CAMERAS, ScoreConfig(top_k=10**12, jitter=False))
    np.testing.assert_array_equal(huge.contribution, everything.contribution)


def test_unseen_and_invalid_splats_score_nothing():
    splats = oracle.scene(8, n=30)
    splats.means[0] = [0, 0, 500]
    splats.means[0] = -CAMERAS[0].rotation.T @ np.array([0, 0, 50.0])  # behind
    splats.opacities[1] = np.nan
    splats.opacities[2] = -np.inf
    scores = score(splats, CAMERAS[:1], ScoreConfig(jitter=False))
    assert not scores.contribution[:3].any()
    assert not scores.shown[:3].any()
    assert np.isfinite(scores.contribution).all()


def test_cameras_that_see_nothing_are_refused():
    with pytest.raises(DataError, match="none of 60 splats") as caught:
        score(oracle.scene(0), [oracle.camera(distance=-50.0)])
    assert caught.value.code == "cameras-see-nothing"
    with pytest.raises(DataError) as caught:
        score(empty(0), CAMERAS)
    assert caught.value.code == "cameras-see-nothing"


def test_no_cameras_are_refused():
    with pytest.raises(DataError) as caught:
        score(oracle.scene(0), [])
    assert caught.value.code == "no-cameras"


def test_progress_is_reported_and_may_cancel():
    splats = oracle.scene(9, n=10)
    calls = []
    score(splats, CAMERAS, progress=lambda *call: calls.append(call))
    assert calls == [("score", done, 9) for done in range(10)]

    def stop(stage, done, total):
        if done == 1:
            raise Cancelled

    for threads in (1, 2):
        with pytest.raises(Cancelled):
            score(splats, CAMERAS, ScoreConfig(threads=threads), progress=stop)


def test_weights_below_the_minimum_do_not_count():
    splats = oracle.scene(3, n=150)
    seen = [oracle.view(splats, camera) for camera in CAMERAS]
    for least in (0.01, 0.2):
        config = ScoreConfig(top_k=0, least_weight=least, jitter=False)
        kept = [np.where(v.weights >= least, v.weights, 0.0).sum(axis=0) for v in seen]
        expected = np.mean(kept, axis=0)
        found = score(splats, CAMERAS, config).contribution
        off = np.abs(found - expected) / expected.max()
        # A weight close to the limit may count or not: it is computed in float32.
        assert np.mean(off > 1e-4) < 0.05
        assert off.max() < 0.02
        every = score(splats, CAMERAS, ScoreConfig(top_k=0, jitter=False)).contribution
        assert (found <= every).all()
        assert (found < every).any()


def test_optional_scores_are_not_summed_by_default():
    splats = oracle.scene(3, n=50)
    full, bare = (score(splats, CAMERAS, ScoreConfig(colour_sensitivity=c)) for c in (True, False))
    assert full.colour_sensitivity.any()
    assert bare.colour_sensitivity.shape == (50,)
    assert not bare.colour_sensitivity.any()
    for name in ("contribution", "energy", "largest_energy", "peak", "shown", "basis_mean"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(full, name))
    np.testing.assert_array_equal(bare.basis_spread, full.basis_spread)


def test_one_jittered_copy_scores_fewer_views():
    splats = oracle.scene(3, n=50)
    both, one = (score(splats, CAMERAS, ScoreConfig(jitter_copies=copies)) for copies in (2, 1))
    given = sum(camera.width * camera.height for camera in CAMERAS)
    assert (both.num_pixels, one.num_pixels) == (3 * given, 2 * given)


@pytest.mark.parametrize(
    "options",
    [
        {"top_k": -1},
        {"near_plane": 0.0},
        {"threads": -2},
        {"least_weight": 1.5},
        {"jitter_copies": 3},
    ],
)
def test_invalid_settings_are_refused(options):
    with pytest.raises(ValueError, match="expected"):
        ScoreConfig(**options)


def test_on_a_device_scores_are_the_same_but_for_rounding(monkeypatch):
    splats = oracle.scene(3, n=60, info=SceneInfo(antialiased=True))
    cameras = [replace(camera, width=24, height=17) for camera in CAMERAS]
    config = ScoreConfig(top_k=0, least_weight=0.01, jitter_copies=1, sensitivity_every=2)
    expected = score(splats, cameras, config, covering=cameras[:1])
    on_cpu(monkeypatch)
    found = score(splats, cameras, replace(config, device="cuda"), covering=cameras[:1])
    for name in ("contribution", "energy", "largest_energy", "peak", "basis_mean"):
        values = getattr(expected, name)
        _close(getattr(found, name), values, np.abs(values).max())
    np.testing.assert_array_equal(found.shown, expected.shown)
    np.testing.assert_array_equal(found.covered, expected.covered)
    for name in ("opacities", "means", "scales", "rotations", "sh0"):
        values = getattr(expected.sensitivities, name)
        _close(getattr(found.sensitivities, name), values, values.max())


def test_a_device_and_an_executor_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="an executor and the device cuda"):
        score(oracle.scene(1), CAMERAS, ScoreConfig(device="cuda"), executor=LocalThreads())
