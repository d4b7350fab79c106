from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.reference_views import MAX_VIEWS, PICTURE_PIXELS, render_references
from cogsplat.codec.views.roam_views import jitter


@pytest.fixture(scope="module")
def scene():
    return oracle.scene(5, n=60), [oracle.camera(angle=angle) for angle in (0, 20, 40)]


def test_reference_views_show_the_scene_small(scene):
    splats, cameras = scene
    large = [replace(c, width=4 * 310, height=4 * 200, fx=900.0, fy=900.0) for c in cameras]
    references = render_references(splats, large)
    assert len(references.cameras) == len(references.pictures) == len(references.weights) == 9
    assert references.given == 3
    np.testing.assert_allclose(references.weights, [1 / 3] * 3 + [1 / 6] * 6)
    for camera, picture, reduction in zip(
        references.cameras, references.pictures, references.reductions, strict=True
    ):
        assert picture.shape == (camera.height, camera.width, 3)
        assert PICTURE_PIXELS / 2 < camera.width * camera.height <= PICTURE_PIXELS
        assert reduction == 5.0
        assert picture.min() >= 0
        assert picture.max() <= 1


def test_reference_views_may_be_smaller(scene):
    splats, cameras = scene
    some = splats.take(np.arange(3))
    large = [replace(c, width=4 * 310, height=4 * 200, fx=900.0, fy=900.0) for c in cameras]
    references = render_references(some, large, jittered=False, pixels=PICTURE_PIXELS // 4)
    for camera, reduction in zip(references.cameras, references.reductions, strict=True):
        assert camera.width * camera.height <= PICTURE_PIXELS // 4
        assert reduction == 10.0
    with pytest.raises(ValueError, match="0 pixels"):
        render_references(some, large, pixels=0)


def test_reference_views_bound_their_views(scene):
    splats, cameras = scene
    references = render_references(splats.take(np.arange(3)), cameras * 100)
    assert len(references.cameras) == MAX_VIEWS
    assert references.given == MAX_VIEWS // 3


def test_samples_reach_every_view_equally(scene):
    splats, cameras = scene
    references = render_references(splats.take(np.arange(3)), cameras * 5)
    seen = np.zeros(len(references.cameras), int)
    for iteration in range(90):
        views = references.sample(9, iteration)
        assert len(set(views)) == len(views) == 9
        assert sum(view < references.given for view in views) == 3
        seen[views] += 1
    assert seen.min() >= 14
    assert seen.max() <= 22
    assert references.sample(100, 3) == list(range(45))


def test_no_cameras_are_refused_as_references(scene):
    with pytest.raises(ValueError, match="0 cameras"):
        render_references(scene[0], [])


def test_small_cameras_are_drawn_as_they_are(scene):
    splats, cameras = scene
    references = render_references(splats, cameras, near_plane=1.0)
    config = RenderConfig(near_plane=1.0)
    for camera, picture in zip(
        [*cameras, *jitter(splats, cameras)], references.pictures, strict=True
    ):
        np.testing.assert_array_equal(picture, np.clip(render(splats, camera, config), 0, 1))
    assert references.near_plane == 1.0


def test_progress_counts_the_views(scene):
    splats, cameras = scene
    calls = []
    render_references(splats, cameras * 8, jittered=False, progress=lambda *c: calls.append(c))
    assert calls == [("reference views", done, 24) for done in range(25)]
