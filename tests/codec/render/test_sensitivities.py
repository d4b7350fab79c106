from dataclasses import fields, replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring import view_scores
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import SceneInfo, empty
from cogsplat.codec.views.roam_views import jitter

NAMES = ("opacities", "means", "scales", "rotations", "sh0")
# Of unlike sizes, so that averages over views and over pixels differ.
CAMERAS = [oracle.camera(angle=0.3), oracle.camera(angle=1.4, width=40, height=29, shift=3.0)]
EVERY_VIEW = ScoreConfig(jitter=False, sensitivity_every=1)


def _scene(seed, n=12, info=None):
    """Return a scene without the effects that sensitivities ignore: distant, constant colours."""
    splats = oracle.scene(seed, n, degree=0, info=info)
    splats.scales[:] = np.clip(splats.scales, -4.0, -1.2)
    splats.opacities[:] = np.minimum(splats.opacities, 3.0)
    return splats


def _turned(quats, row, axis, angle):
    """q · (1, angle / 2 about the axis), as a product of matrices [q]."""
    w, x, y, z = quats[row].astype(np.float64) / np.linalg.norm(quats[row].astype(np.float64))
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    small = np.zeros(4)
    small[0], small[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    turned = quats.copy()
    turned[row] = left @ small
    return turned


def _moved(splats, name, row, column, step):
    if name == "rotations":
        return replace(splats, quats=_turned(splats.quats, row, column, step))
    array = getattr(splats, name).copy()
    array.reshape(len(splats), -1)[row, column] += np.float32(step)
    return replace(splats, **{name: array})


def _measured(splats, cameras, name, row, column, step):
    """Mean squared derivative of the pixels, by central differences of brute force.

    Pixels where the step takes a splat across a cut are left out: they jump.
    """
    total, count = 0.0, 0
    for camera in cameras:
        low, high = (
            oracle.view(_moved(splats, name, row, column, sign * step), camera) for sign in (-1, 1)
        )
        same = ((low.weights > 0) == (high.weights > 0)).all(axis=1)
        slopes = (high.image - low.image).reshape(-1, 3)[same] / (2.0 * step)
        total += np.square(slopes).sum()
        count += 3 * camera.width * camera.height
    return total / count


def _both(splats, cameras, name):
    """Return a parameter's sensitivities as predicted and as measured, (N, columns)."""
    predicted = getattr(score(splats, cameras, EVERY_VIEW).sensitivities, name)
    predicted = predicted.reshape(len(splats), -1)
    measured = np.array(
        [
            [_measured(splats, cameras, name, row, column, 1e-3) for column in columns]
            for row, columns in enumerate([range(predicted.shape[1])] * len(splats))
        ]
    )
    assert np.count_nonzero(measured) > measured.size // 2
    return predicted, measured


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
@pytest.mark.parametrize("name", ["opacities", "scales", "rotations", "sh0"])
def test_sensitivities_are_the_squared_derivatives_of_brute_force(name, info):
    predicted, measured = _both(_scene(3, info=info), CAMERAS, name)
    np.testing.assert_allclose(predicted, measured, rtol=5e-3, atol=1e-4 * measured.max())


def test_sensitivities_of_means_are_the_squared_derivatives_but_for_the_turn():
    # Near by, the direction under which a splat is seen changes its shape a little.
    predicted, measured = _both(_scene(3), CAMERAS, "means")
    np.testing.assert_allclose(predicted, measured, rtol=0.3, atol=1e-3 * measured.max())
    assert predicted.sum() == pytest.approx(measured.sum(), rel=0.02)
    far = [oracle.camera(angle=0.3, distance=80.0, focal=900.0)]
    predicted, measured = _both(_scene(3), far, "means")
    np.testing.assert_allclose(predicted, measured, rtol=0.02, atol=1e-3 * measured.max())


def test_errors_of_all_splats_add_up():
    rng = np.random.default_rng(0)
    splats = oracle.scene(11, n=300)
    sensitivities = score(splats, CAMERAS, EVERY_VIEW).sensitivities
    plain = [render(splats, camera) for camera in CAMERAS]
    for name in ("opacities", "sh0"):
        slopes = getattr(sensitivities, name)
        # Faint splats would need steps far outside the linear range of the blend.
        known = slopes > 1e-2 * slopes.max()
        sizes = np.where(known, 3e-3 / np.sqrt(np.where(known, slopes, 1.0) * known.sum()), 0.0)
        assert sizes.max() < 0.25
        ratios = []
        for _ in range(10):
            errors = rng.normal(size=slopes.shape) * sizes
            changed = getattr(splats, name) + errors.astype(np.float32)
            wrong = replace(splats, **{name: changed})
            off = [render(wrong, c) - p for c, p in zip(CAMERAS, plain, strict=True)]
            ratios.append(np.mean(np.concatenate([np.square(o).ravel() for o in off])) / 9e-6)
        assert np.mean(ratios) == pytest.approx(1.0, rel=0.15), name


def test_colour_sensitivity_is_energy():
    splats = oracle.scene(4, degree=0)
    splats.sh0[:, :2] = np.abs(splats.sh0[:, :2])
    splats.sh0[:, 2] = -5.0  # clamped at 0
    scores = score(splats, CAMERAS, EVERY_VIEW)
    expected = np.outer(scores.energy, [1.0, 1.0, 0.0]) * C0**2 / 3.0
    np.testing.assert_allclose(scores.sensitivities.sh0, expected, rtol=1e-12)


def test_scores_are_the_same_with_and_without():
    splats = oracle.scene(5, n=150)
    plain = score(splats, CAMERAS)
    other = score(splats, CAMERAS, ScoreConfig(sensitivity_every=1))
    assert plain.sensitivities is None
    for field in fields(plain):
        if field.name != "sensitivities":
            np.testing.assert_array_equal(
                getattr(other, field.name), getattr(plain, field.name), field.name
            )


def test_threads_and_bands_do_not_change_them(monkeypatch):
    splats = oracle.scene(6, n=200)
    # The tiles of one camera are spread over threads; several cameras run in parallel.
    for cameras in (CAMERAS[:1], CAMERAS):
        expected = score(splats, cameras, replace(EVERY_VIEW, threads=1)).sensitivities
        for threads in (2, 3, 7):
            actual = score(splats, cameras, replace(EVERY_VIEW, threads=threads)).sensitivities
            for name in NAMES:
                np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name))
        monkeypatch.setattr(view_scores, "PAIRS_AT_ONCE", 100)
        banded = score(splats, cameras, EVERY_VIEW).sensitivities
        monkeypatch.undo()
        for name in NAMES:
            np.testing.assert_array_equal(getattr(banded, name), getattr(expected, name))


def test_jitter_counts_half():
    splats = oracle.scene(7)
    given = score(splats, CAMERAS, EVERY_VIEW).sensitivities
    copies = score(splats, jitter(splats, CAMERAS), EVERY_VIEW).sensitivities
    both = score(splats, CAMERAS, ScoreConfig(sensitivity_every=1)).sensitivities
    for name in NAMES:
        expected = (getattr(given, name) + getattr(copies, name)) / 2.0
        np.testing.assert_allclose(getattr(both, name), expected, rtol=1e-12)


@pytest.mark.parametrize("every", [2, 3])
def test_samples_of_tiles_add_up_to_the_whole(every):
    """One camera repeated `every` times is measured in each tile once."""
    splats = oracle.scene(8, n=150)
    camera = oracle.camera(width=70, height=50)
    whole = score(splats, [camera], EVERY_VIEW).sensitivities
    sampled = replace(EVERY_VIEW, sensitivity_every=every)
    # The phase moves on after each run of `every` views.
    parts = score(splats, [camera] * every, sampled).sensitivities
    for name in NAMES:
        expected = getattr(whole, name)
        np.testing.assert_allclose(getattr(parts, name), expected, rtol=1e-6, atol=1e-30)
    one = score(splats, [camera], sampled).sensitivities
    assert 0 < np.count_nonzero(one.opacities) < np.count_nonzero(whole.opacities)


def test_an_interval_beyond_all_tiles_measures_one():
    cameras = [replace(camera, width=9, height=7) for camera in CAMERAS]
    config = ScoreConfig(jitter=False, sensitivity_every=9)
    found = score(oracle.scene(8), cameras, config).sensitivities
    alone = score(oracle.scene(8), cameras[:1], EVERY_VIEW).sensitivities
    np.testing.assert_allclose(found.sh0, alone.sh0, rtol=1e-12)


def test_round_splats_need_no_rotation():
    splats = oracle.scene(9)
    splats.scales[:] = splats.scales[:, :1]
    sensitivities = score(splats, CAMERAS, EVERY_VIEW).sensitivities
    assert not sensitivities.rotations.any()
    assert sensitivities.scales.any()


def test_capped_alphas_do_not_move():
    splats = empty(0, 1)
    splats.scales[:] = 12.0
    for opacity in (np.inf, 20.0):
        splats.opacities[:] = opacity
        sensitivities = score(splats, CAMERAS[:1], EVERY_VIEW).sensitivities
        for name in ("opacities", "means", "scales", "rotations"):
            assert not getattr(sensitivities, name).any()
        assert sensitivities.sh0.all()


def test_extreme_and_invalid_splats_leave_finite_sums():
    splats = oracle.scene(10, n=30, info=SceneInfo(kernel_px=0.0, antialiased=True))
    splats.means[0] = -CAMERAS[0].rotation.T @ np.array([0, 0, 50.0])  # behind
    splats.opacities[1] = np.nan
    splats.opacities[2] = np.inf
    splats.scales[3] = [-100.0, 2.0, 2.0]
    splats.scales[4] = [-100.0, -100.0, 2.0]
    splats.scales[5] = 40.0
    splats.scales[6] = [-20.0, 5.0, -20.0]
    for info in (splats.info, SceneInfo(), SceneInfo(kernel_px=0.0), *oracle.INFOS.values()):
        sensitivities = score(replace(splats, info=info), CAMERAS[:1], EVERY_VIEW).sensitivities
        for name in NAMES:
            values = getattr(sensitivities, name)
            assert np.isfinite(values).all()
            assert (values >= 0.0).all()
            assert not values[:2].any()


def test_invalid_settings_are_refused():
    with pytest.raises(ValueError, match="sensitivity_every -1"):
        ScoreConfig(sensitivity_every=-1)
