from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import DataError
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import SceneInfo


def test_renders_are_the_ground_truth_of_cameras_and_copies():
    splats = oracle.scene(0, info=SceneInfo(antialiased=True, kernel_px=0.1))
    cameras = [oracle.camera(angle) for angle in (0.1, 0.6)]
    background = (0.2, 0.0, 1.0)
    training_views = make_training_views(splats, cameras, background=background, threads=2)
    assert (
        len(training_views),
        training_views.num_given,
        training_views.num_on_path,
        len(training_views.pictures),
    ) == (8, 2, 3, 8)
    for camera, config, picture in zip(
        training_views.cameras, training_views.configs, training_views.pictures, strict=True
    ):
        assert config == RenderConfig(background=background, threads=1)
        np.testing.assert_array_equal(picture, np.clip(render(splats, camera, config), 0, 1))
    alone = make_training_views(splats, cameras, copies=False)
    assert len(alone) == alone.num_given == alone.num_on_path == 2


def test_interpolated_cameras_are_halfway():
    splats = oracle.scene(4)
    one, other, middle = (oracle.camera(angle) for angle in (0.2, 1.0, 0.6))
    between = make_training_views(splats, [one, other]).cameras[2]
    np.testing.assert_allclose(between.rotation, middle.rotation, atol=1e-12)
    np.testing.assert_allclose(between.position, (one.position + other.position) / 2, atol=1e-12)
    # Of three cameras on a path, each pair is interpolated.
    three = make_training_views(splats, [one, middle, other])
    assert (three.num_given, three.num_on_path) == (3, 6)
    assert len({camera.name for camera in three.cameras}) == len(three)


def test_covering_views_have_no_copies():
    splats = oracle.scene(6)
    cameras = [oracle.camera(angle) for angle in (0.1, 0.6)]
    below = [replace(oracle.camera(2.0), name="covering-000")]
    training_views, without = (
        make_training_views(splats, cameras, covering=views) for views in (below, ())
    )
    assert len(training_views) == len(without) + 1
    assert (training_views.num_given, training_views.num_on_path) == (
        without.num_given,
        without.num_on_path,
    )
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
    assert (training_views.num_photos, make_training_views(splats, [camera]).num_photos) == (1, 0)
    assert not (training_views.pictures[1] == 0.25).all()
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
