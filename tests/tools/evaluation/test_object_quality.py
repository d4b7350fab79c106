"""Pixels of each object, and PSNR over the object's pixels."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats, empty
from cogsplat.tools.evaluation.object_quality import object_pixels, object_qualities

CAMERA = Camera(
    width=60, height=40, fx=40.0, fy=40.0, cx=30.0, cy=20.0,
    rotation=np.eye(3), translation=np.zeros(3), name="front",
)  # fmt: skip


def four_balls() -> tuple[Splats, np.ndarray]:
    """Return opaque balls side by side, of the objects 2, 5, 7 and 9; one of 5 hides one of 2."""
    scene = empty(0, 5)
    scene.means[:] = [[-3, 0, 6], [-1, 0, 6], [1, 0, 6], [3, 0, 6], [-1, 0, 9]]
    scene.scales[:] = np.log(0.3)
    scene.opacities[:] = 8.0
    scene.sh0[:] = np.random.default_rng(3).uniform(0, 1.5, (5, 3))
    return scene, np.array([2, 5, 7, 9, 2], np.uint32)


def test_a_pixel_shows_the_object_that_weighs_most() -> None:
    scene, labels = four_balls()
    known = np.unique(labels)
    shown = object_pixels(scene, labels, known, CAMERA)
    assert shown.shape == (40, 60)
    # The centres are projected by hand: x = 40 · X / 6 + 30. What is hidden shows nothing.
    row = shown[20]
    assert [row[round(40 * x / 6 + 30)] for x in (-3, -1, 1, 3)] == [0, 1, 2, 3]
    assert (row[:3] == -1).all()
    # Against the picture itself: alone before black, a splat is where it is more than half opaque.
    alone = replace(scene.take(np.array([2])), sh0=np.full((1, 3), 0.5 / 0.28209479, np.float32))
    np.testing.assert_array_equal(shown == 2, render(alone, CAMERA)[..., 0] > 0.5)


def test_each_object_is_measured_over_its_own_pixels() -> None:
    scene, labels = four_balls()
    labelled = replace(scene, extras={"object": labels.astype("u1")})
    changed = scene.sh0.copy()
    changed[2] += 0.2
    other = replace(scene, sh0=changed)
    behind = replace(CAMERA, translation=np.array([0.0, 0.0, -100.0]), name="behind")
    found = object_qualities(labelled, other, [CAMERA, behind])
    assert [one.object for one in found] == [2, 5, 7, 9]
    assert [one.views for one in found] == [1, 1, 1, 1]
    assert [found[k].psnr_db for k in (0, 1, 3)] == [100.0, 100.0, 100.0]
    mask = object_pixels(scene, labels, np.unique(labels), CAMERA) == 2
    error = np.clip(render(scene, CAMERA), 0, 1)[mask] - np.clip(render(other, CAMERA), 0, 1)[mask]
    assert found[2].pixels == mask.sum() > 10
    expected = -10 * np.log10(np.mean(np.square(error.astype(np.float64))))
    assert found[2].psnr_db == pytest.approx(expected, abs=1e-4)
    assert found[2].worst_db == found[2].psnr_db
    hidden = object_qualities(labelled, other, [behind])
    assert {(one.views, one.pixels, one.psnr_db) for one in hidden} == {(0, 0, None)}


def test_a_scene_without_labels_is_refused() -> None:
    scene, _ = four_balls()
    with pytest.raises(DataError, match="expected labels of objects as the attribute 'object'"):
        object_qualities(scene, scene, [CAMERA])
    with pytest.raises(DataError, match="0 cameras"):
        object_qualities(scene, scene, [])
