from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import DataError
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import SceneInfo


def test_renders_are_the_ground_truth_of_given_and_drawn_views():
    splats = oracle.scene(0, info=SceneInfo(antialiased=True, kernel_px=0.1))
    cameras = [oracle.camera(angle) for angle in (0.1, 0.6)]
    background = (0.2, 0.0, 1.0)
    views = make_training_views(splats, cameras, background=background, threads=2)
    assert (len(views), views.num_given, len(views.pictures)) == (2, 2, 2)
    drawn = views.drawn.camera(np.random.default_rng(0), off_path=True)
    for view in [views.fixed(0), views.fixed(1), views.drawn.render(*drawn)]:
        assert view.config == RenderConfig(background=background, threads=1)
        expected = np.clip(render(splats, view.camera, view.config), 0, 1)
        np.testing.assert_array_equal(view.picture, expected)
    assert make_training_views(splats, cameras, draw=False).drawn is None


def test_samples_add_drawn_views_to_fixed_ones():
    cameras = [oracle.camera(angle) for angle in (0.1, 0.6, 1.1)]
    views = make_training_views(oracle.scene(4), cameras)
    sample = views.sample(5, 7)
    assert [camera for camera, _ in sample[:3]] == list(views.cameras)
    assert [len(views.sample(count, 7)) for count in (2, 5)] == [2, 5]
    alike, other = views.sample(5, 7), views.sample(5, 8)
    for (one, _), (two, _), (three, _) in list(zip(sample, alike, other, strict=True))[3:]:
        np.testing.assert_array_equal(one.rotation, two.rotation)
        assert not np.array_equal(one.rotation, three.rotation)


def test_covering_views_stand_behind_given_ones():
    splats = oracle.scene(6)
    cameras = [oracle.camera(angle) for angle in (0.1, 0.6)]
    below = [replace(oracle.camera(2.0), name="covering-000")]
    training_views, without = (
        make_training_views(splats, cameras, covering=views) for views in (below, ())
    )
    assert len(training_views) == len(without) + 1
    assert training_views.num_given == without.num_given == 2
    last = training_views.cameras[-1]
    assert last.name == "covering-000"
    assert (last.width, last.height) == (below[0].width // 2, below[0].height // 2)
    assert training_views.pictures[-1].shape == (last.height, last.width, 3)
    assert training_views.configs[-1].reduction == 2 * training_views.configs[0].reduction


def test_photos_are_the_ground_truth_of_cameras_only():
    splats, camera = oracle.scene(1), oracle.camera()
    photo = np.full((camera.height, camera.width, 3), 0.25, np.float32)
    training_views = make_training_views(splats, [camera], photos=[photo])
    np.testing.assert_array_equal(training_views.pictures[0], photo)
    assert (training_views.photos, make_training_views(splats, [camera]).photos) == (True, False)
    drawn = training_views.drawn.camera(np.random.default_rng(0), off_path=False)
    assert not (training_views.drawn.render(*drawn).picture == 0.25).all()
    with pytest.raises(ValueError, match="1 photos for 2 cameras"):
        make_training_views(splats, [camera, camera], photos=[photo])


def test_large_pictures_are_downscaled():
    splats = oracle.scene(2, n=30)
    camera = oracle.camera(width=80, height=60, focal=60.0)
    photo = render(splats, camera)
    training_views = make_training_views(splats, [camera], photos=[photo], max_pixels=1500)
    small = training_views.cameras[0]
    assert (small.width, small.height, small.fx) == (40, 30, 30.0)
    assert training_views.configs[0].reduction == 2
    drawn = render(splats, small, training_views.configs[0])
    assert np.abs(drawn - training_views.pictures[0]).mean() < 0.02
    white = np.ones((60, 81, 3), np.float32)
    odd = make_training_views(splats, [replace(camera, width=81)], photos=[white], max_pixels=1500)
    assert odd.pictures[0].shape == (30, 40, 3)


def test_no_cameras_are_refused():
    with pytest.raises(DataError, match="0 cameras") as caught:
        make_training_views(oracle.scene(3), [])
    assert caught.value.code == "no-cameras"
