"""Level training: each level on pictures of its own resolution."""

import numpy as np
import pytest

from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.fit.initial_splats import splats_from_points
from cogsplat.codec.fit.level_encoding import make_levels
from cogsplat.codec.fit.level_training import (
    MIN_OPACITY,
    grow_levels,
    train_levels,
)
from cogsplat.codec.fit.train_config import LevelsConfig, LevelsRequest
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CONFIG = LevelsConfig(scales=(4, 2, 1), shares=(0.2, 0.5, 1.0), steps=30, threads=1)


@pytest.fixture(scope="module")
def scene():
    return synth(600), synth_cameras(4, 96, 72)


@pytest.fixture(scope="module")
def levels(scene):
    return train_levels(*scene, CONFIG)


def opacity(logits):
    return 1 / (1 + np.exp(-logits.astype(np.float64)))


def test_levels_have_the_given_shares(levels):
    counts = np.bincount(levels.first_level, minlength=3)
    assert counts.sum() == len(levels.splats) == len(levels.last_level)
    # Some became invisible in training.
    for count, share in zip(np.cumsum(counts), CONFIG.shares, strict=True):
        assert 0.9 * share * 600 <= count <= share * 600
    assert (np.diff(levels.first_level) >= 0).all()


def test_splats_of_a_level_start_as_a_prefix_that_leaves_no_holes():
    cameras = synth_cameras(4, 128, 96)
    splats = synth(6000).with_capture(capture_of_cameras(cameras))
    untrained = LevelsConfig((2,), (0.15,), steps=0, threads=1)
    first = train_levels(splats, cameras, untrained).scene(0)
    assert first.info.capture == splats.info.capture
    # Inflated alike, in all axes.
    rows = [np.flatnonzero((splats.means == mean).all(axis=1))[0] for mean in first.means]
    growth = first.scales - splats.scales[rows]
    assert growth.min() == pytest.approx(growth.max(), abs=1e-5)
    assert growth.min() > 0.05
    views = [camera.downscaled(2) for camera in cameras]
    pictures = [downscale_picture(render(splats, camera), 2) for camera in cameras]
    by_contribution = np.argsort(-score(splats, views).contribution)[: len(first)]

    def shown(some):
        return np.mean([psnr(render(some, v), p) for v, p in zip(views, pictures, strict=True)])

    assert shown(first) > shown(splats.take(by_contribution)) + 3


def test_a_level_may_be_too_small_for_a_splat(scene):
    tiny = LevelsConfig((4, 1), (0.0001, 0.5), steps=0, threads=1)
    assert np.bincount(train_levels(*scene, tiny).first_level).tolist() == [0, 300]


def test_lower_levels_are_frozen_except_for_opacities(scene):
    """Training fewer levels gives the same lower levels."""
    fewer = LevelsConfig(scales=(4, 2), shares=(0.2, 0.5), steps=30, threads=1)
    first, both = train_levels(*scene, fewer), train_levels(*scene, CONFIG)
    count = len(first.splats)
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(
            getattr(both.splats, name)[:count], getattr(first.splats, name)
        )
    np.testing.assert_array_equal(both.opacities[:2, :count], first.opacities)
    later = both.rows(2)
    later = later[later < count]
    assert (both.opacities[2, later] != both.opacities[1, later]).mean() > 0.5


def test_added_splats_are_trained_with_their_sh(scene, levels):
    """The released code of the paper differs."""
    splats, _ = scene
    source = {tuple(mean) for mean in splats.means.tolist()}
    added = np.flatnonzero(levels.first_level == 2)
    moved = [tuple(mean) not in source for mean in levels.splats.means[added].tolist()]
    assert np.mean(moved) > 0.5
    assert np.abs(levels.splats.shN[added]).max() > 0


def test_levels_leave_out_transparent_splats_for_good(levels):
    for level in range(3):
        rows = levels.rows(level)
        assert (opacity(levels.opacities[level][rows]) >= MIN_OPACITY).all()
    assert (levels.first_level <= levels.last_level).all()
    for level in range(2):
        ended = np.flatnonzero(levels.last_level == level)
        assert (opacity(levels.opacities[level + 1][ended]) < MIN_OPACITY).all()


@pytest.mark.parametrize("loss", ["squared", "structure"])
def test_training_improves_a_level(scene, loss):
    splats, cameras = scene
    views = [camera.downscaled(4) for camera in cameras]
    targets = [downscale_picture(render(splats, camera), 4) for camera in cameras]
    measure = psnr if loss == "squared" else ssim

    def mean_after(steps):
        config = LevelsConfig(scales=(4,), shares=(0.2,), steps=steps, loss=loss, threads=1)
        small = train_levels(splats, cameras, config).scene(0)
        pairs = zip(views, targets, strict=True)
        return np.mean([measure(render(small, view), target) for view, target in pairs])

    assert mean_after(60) > mean_after(0) + (1.0 if loss == "squared" else 0.01)


def test_the_result_does_not_depend_on_threads(scene, levels):
    other = train_levels(*scene, LevelsConfig(CONFIG.scales, CONFIG.shares, 30, threads=2))
    np.testing.assert_array_equal(other.opacities, levels.opacities)
    np.testing.assert_array_equal(other.splats.means, levels.splats.means)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scales": ()},
        {"scales": (1, 2)},
        {"scales": (2, 0)},
        {"scales": (2, 1), "shares": (1.0,)},
        {"scales": (2, 1), "shares": (0.6, 0.5)},
        {"scales": (2, 1), "shares": (0.6, 1.5)},
        {"steps": -1},
        {"loss": "none"},
        {"seed": -1},
        {"quality_db": 1.0},
        {"chunk_splats": 0},
        {"opacity_step": 0.0},
    ],
)
def test_invalid_configurations_are_refused(wrong):
    with pytest.raises(ValueError, match="expected"):
        LevelsConfig(**wrong)


@pytest.mark.parametrize("wrong", [{"max_splats": 0, "pictures": ()}, {"max_splats": 10}])
def test_points_need_pictures_and_splats(wrong):
    with pytest.raises(ValueError, match="expected"):
        LevelsRequest((), **wrong)


@pytest.mark.parametrize("planned", [False, True])
def test_levels_get_the_viewpoints_of_given_cameras(scene, planned):
    splats, cameras = scene
    config = LevelsConfig(scales=(2,), shares=(0.2,), steps=0, threads=1)
    made = make_levels(splats, LevelsRequest(cameras, config, planned=planned))
    assert made.scene.info.capture == (() if planned else capture_of_cameras(cameras))


def test_cameras_and_pictures_must_match(scene):
    splats, cameras = scene
    with pytest.raises(ValueError, match="cameras"):
        train_levels(splats, [], CONFIG)
    with pytest.raises(ValueError, match="pictures"):
        train_levels(splats, cameras, CONFIG, pictures=[np.zeros((4, 4, 3), np.float32)])


def test_levels_are_trained_from_points(scene):
    """Every level improves over its points, and keeps the splats of lower levels."""
    splats, cameras = scene
    photos = [np.clip(render(splats, camera), 0, 1) for camera in cameras]
    rows = np.random.default_rng(5).permutation(600)[:80]
    colours = np.clip(255 * (0.5 + 0.282 * splats.sh0[rows]), 0, 255).astype(np.uint8)
    points = splats_from_points(splats.means[rows].astype(np.float64), colours)
    config = LevelsConfig(scales=(4, 2), shares=(0.3, 1.0), steps=120, threads=1)
    grown = grow_levels(points, cameras, photos, 300, config)
    counts = np.bincount(grown.first_level, minlength=2)
    assert 80 < counts[0] <= 90
    assert 80 < counts[1] <= 210
    for level, scale in enumerate(config.scales):
        views = [camera.downscaled(scale) for camera in cameras]
        targets = [downscale_picture(photo, scale) for photo in photos]
        trained, initial = (
            np.mean([ssim(render(one, v), t) for v, t in zip(views, targets, strict=True)])
            for one in (grown.scene(level), points)
        )
        assert trained > initial + 0.1
    alone = grow_levels(points, cameras, photos, 90, LevelsConfig((4,), (1.0,), 120, threads=2))
    kept = len(alone.splats)
    np.testing.assert_array_equal(grown.splats.means[:kept], alone.splats.means)
    np.testing.assert_array_equal(grown.opacities[:1, :kept], alone.opacities)


def test_training_from_points_needs_points(scene):
    splats, cameras = scene
    with pytest.raises(ValueError, match="expected at least 1"):
        grow_levels(splats.take(np.zeros(0, np.int64)), cameras, [], 10)
    with pytest.raises(ValueError, match="expected at least 1"):
        grow_levels(splats, cameras, [], 0)
