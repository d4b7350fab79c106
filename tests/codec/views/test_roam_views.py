import math
from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.views.roam_views import jitter, roam


def _named(count):
    return [replace(oracle.camera(angle=0.3 * k), name=str(k)) for k in range(count)]


def test_roam_moves_back_and_turns_alternately():
    splats, cameras = oracle.scene(1), _named(3)
    views = roam(splats, cameras)
    assert [view.name for view in views] == [
        "0-back", "0-turned", "1-back", "1-turned", "2-back", "2-turned",
    ]  # fmt: skip
    for index, camera in enumerate(cameras):
        moved, turned = views[2 * index], views[2 * index + 1]
        forward, right = camera.rotation[2], camera.rotation[0]
        np.testing.assert_allclose(
            moved.position, camera.position - 0.3 * visible_depth(splats, camera) * forward
        )
        np.testing.assert_array_equal(moved.rotation, camera.rotation)
        np.testing.assert_allclose(turned.position, camera.position, atol=1e-12)
        np.testing.assert_allclose(turned.rotation[1], camera.rotation[1])
        assert turned.rotation[2] @ forward == pytest.approx(math.cos(math.radians(20)))
        assert (turned.rotation[2] @ right > 0) == (index % 2 == 0)
        assert (moved.fx, moved.width, turned.cy) == (camera.fx, camera.width, camera.cy)


def test_roam_of_a_camera_that_sees_nothing_only_turns():
    camera = oracle.camera(distance=-50.0)
    moved, turned = roam(oracle.scene(0), [camera])
    np.testing.assert_array_equal(moved.translation, camera.translation)
    assert not np.allclose(turned.rotation, camera.rotation)


def test_jitter_is_the_rule_of_roam():
    splats, cameras = oracle.scene(1), _named(2)
    for first, second in zip(jitter(splats, cameras), roam(splats, cameras), strict=True):
        np.testing.assert_array_equal(first.rotation, second.rotation)
        np.testing.assert_array_equal(first.translation, second.translation)


def test_single_jittered_copies_alternate_between_kinds_and_sides():
    splats, cameras = oracle.scene(1), _named(8)
    copies = jitter(splats, cameras, copies=1)
    assert [copy.name for copy in copies] == [
        "0-back", "1-turned", "2-turned", "3-back", "4-back", "5-turned", "6-turned", "7-back",
    ]  # fmt: skip
    by_name = {view.name: view for view in roam(splats, cameras)}
    for copy in copies:
        np.testing.assert_array_equal(copy.rotation, by_name[copy.name].rotation)
        np.testing.assert_array_equal(copy.translation, by_name[copy.name].translation)
    again = jitter(splats, cameras[3:], copies=1, first=3)
    assert [copy.name for copy in again] == [copy.name for copy in copies[3:]]
    np.testing.assert_array_equal(again[2].rotation, copies[5].rotation)
