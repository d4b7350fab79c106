"""Capture viewpoints: which are chosen, the pixel of training, and changes of a scene's frame."""

from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.capture import (
    MAX_VIEWPOINTS,
    capture_of_cameras,
    merged_capture,
    training_pixel,
)
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.geometry.baked_thickness import bake_thickness
from cogsplat.codec.geometry.merging import merge
from cogsplat.codec.geometry.transforms import convert_axes, transform, transform_camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.projection import FILTER, THICKNESS, project
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.view_quality import share_capture
from cogsplat.codec.splats import SceneInfo
from cogsplat.codec.views.trained_at import TrainedAt, parse_trained_at

CAMERAS = [oracle.camera(angle=0.1 * k, shift=0.01 * k * k) for k in range(50)]


def test_viewpoints_are_cameras_spread_evenly():
    capture = capture_of_cameras(CAMERAS)
    assert len(capture) == 32
    places = np.array(capture)[:, :3]
    positions = np.array([camera.position for camera in CAMERAS])
    distances = np.linalg.norm(positions[:, None] - places, axis=2)
    assert (distances.min(axis=0) < 1e-5).all()
    # None of the cameras is far from a viewpoint, against the distances between cameras.
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert distances.min(axis=1).max() < 2 * steps.max()
    assert capture_of_cameras([]) == ()
    assert len(capture_of_cameras(CAMERAS[:3])) == 3


def test_training_pixel_is_the_weighted_mean_of_the_viewpoints():
    rng = np.random.default_rng(0)
    capture = tuple(map(tuple, rng.uniform(1.0, 5.0, (7, 4)).tolist()))
    position = rng.normal(size=3)
    *centre, area, rest = training_pixel(capture, position).tolist()
    rows = np.array(capture)
    weights = np.linalg.norm(rows[:, :3] - position, axis=1) ** -4.0
    for mean in rng.normal(scale=3.0, size=(9, 3)):
        squares = (np.linalg.norm(rows[:, :3] - mean, axis=1) / rows[:, 3]) ** 2
        found = area * np.square(mean - centre).sum() + rest
        assert found == pytest.approx(np.average(squares, weights=weights), rel=1e-12)


def test_a_viewer_at_a_viewpoint_has_its_pixel_alone():
    capture = ((0.0, 0.0, -4.0, 100.0), (1.0, 0.0, -4.0, 50.0))
    found = training_pixel(capture, np.array([1.0, 0.0, -4.0]))
    np.testing.assert_allclose(found, [1.0, 0.0, -4.0, 1 / 2500, 0.0])


def test_far_splats_are_filtered_and_near_ones_are_as_thick_as_they_were():
    camera = oracle.camera()
    splats = oracle.scene(0, n=40)
    captured = replace(splats, info=SceneInfo(capture=capture_of_cameras([camera])))
    for factor in (0.25, 4.0):
        moved = replace(
            camera, fx=camera.fx / factor, fy=camera.fy / factor,
        )  # fmt: skip
        footprints = project(captured, moved)
        thickness = 0.3 / factor**2
        np.testing.assert_allclose(footprints.added[:, THICKNESS], thickness, rtol=1e-5)
        blur = max(0.0, (1 - 1 / factor**2) / 12)
        np.testing.assert_allclose(footprints.added[:, FILTER], blur, rtol=1e-5, atol=1e-7)


def test_pictures_move_with_the_scene():
    splats = oracle.scene(1, n=80, info=SceneInfo(capture=oracle.CAPTURE))
    camera = oracle.camera(width=26, height=18, focal=14.0)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    change = (3.0, turn, (1.0, -2.0, 0.5))
    moved = transform(splats, *change)
    # Scale 3 moves the near plane: nothing of this scene is near it.
    np.testing.assert_allclose(
        render(moved, transform_camera(camera, *change)), render(splats, camera), atol=2e-3
    )
    turned = convert_axes(splats, "RUB")
    back = convert_axes(turned, "RDF")
    assert back.info.capture == splats.info.capture
    assert turned.info.capture[0] == pytest.approx((0.5, 0.25, 2.0, 60.0))


def test_merged_scenes_know_the_viewpoints_of_all_parts():
    one, two = oracle.CAPTURE[:2], oracle.CAPTURE[1:]
    assert merged_capture([one, two]) == oracle.CAPTURE
    parts = [oracle.scene(seed, n=5, info=SceneInfo(capture=c)) for seed, c in ((0, one), (1, two))]
    assert merge(parts).info.capture == oracle.CAPTURE
    with pytest.warns(CogsplatWarning, match="not all parts know"):
        assert merge([parts[0], oracle.scene(2, n=5)]).info.capture == ()
    boxes = [np.array([k, k, k, k + 1.0, k + 1.0, k + 1.0]) for k in range(3)]
    many = [parse_trained_at("800,60,1").capture(box) for box in boxes]
    assert len(merged_capture(many[:2])) == MAX_VIEWPOINTS
    assert merged_capture(many) == ()


def test_versions_of_a_scene_are_drawn_alike():
    plain = oracle.scene(3, n=5)
    captured = plain.with_capture(oracle.CAPTURE)
    assert captured.info.capture == oracle.CAPTURE
    assert [s.info.capture for s in share_capture(plain, captured)] == [oracle.CAPTURE] * 2
    assert captured.with_capture(oracle.CAPTURE[:1]).info.capture == oracle.CAPTURE
    antialiased = oracle.scene(3, n=5, info=SceneInfo(antialiased=True))
    assert antialiased.with_capture(oracle.CAPTURE).info.capture == ()


def test_pictures_of_training_as_text():
    assert parse_trained_at("1600,60") == TrainedAt(1600.0, 60.0)
    assert parse_trained_at("unknown").capture(np.arange(6.0)) == ()
    box = np.array([-1.0, -1.0, -1.0, 3.0, 1.0, 1.0])
    capture = np.array(parse_trained_at("800,90,5").capture(box))
    np.testing.assert_allclose(np.linalg.norm(capture[:, :3] - [1, 0, 0], axis=1), 5.0, rtol=1e-6)
    np.testing.assert_allclose(capture[:, 3], 400.0)
    # Without a distance, the scene fills the width.
    (x, y, z, _), *_ = parse_trained_at("800,60").capture(box)
    assert np.linalg.norm([x - 1, y, z]) == pytest.approx(2 * np.sqrt(6.0), rel=1e-6)


@pytest.mark.parametrize(
    "text", ["", "800", "800,60,1,1", "0,60", "nan,60", "1e31,60", "a,b", "800,0.05", "800,171"]
)
def test_other_texts_are_refused(text):
    with pytest.raises(DataError) as caught:
        parse_trained_at(text)
    assert caught.value.code == "bad-view-text"


def test_baked_thickness_is_that_of_the_nearest_viewpoint():
    splats = oracle.scene(6, n=20).with_capture(oracle.CAPTURE)
    baked = bake_thickness(splats)
    assert (baked.info.antialiased, baked.info.capture) == (True, ())
    pixels = [np.linalg.norm(splats.means - v[:3], axis=1) / v[3] for v in oracle.CAPTURE]
    expected = np.exp(2 * splats.scales) + 0.3 * np.min(pixels, axis=0)[:, None] ** 2
    np.testing.assert_allclose(np.exp(2 * baked.scales), expected, rtol=1e-4)
    marked = replace(splats, info=replace(splats.info, antialiased=True))
    for other in (oracle.scene(6, n=20), marked):
        with pytest.raises(DataError) as caught:
            bake_thickness(other)
        assert caught.value.code == "no-capture"


def test_baked_scenes_are_nearly_right_in_an_antialiased_renderer():
    rng = np.random.default_rng(5)
    splats = oracle.scene(5, n=400, opacity=3.0)
    splats.means[:] *= 0.8
    splats.scales[:] = rng.normal(-3.4, 0.4, size=(400, 3))
    camera = oracle.camera(width=256, height=192, focal=230.0)
    baked = bake_thickness(splats.with_capture(capture_of_cameras([camera])))
    full = render(splats, camera)
    for factor in (2, 4, 8):
        small, expected = camera.downscaled(factor), downscale_picture(full, factor)
        found = psnr(expected, render(baked, small))
        assert found > psnr(expected, render(splats, small)) + 2.0
