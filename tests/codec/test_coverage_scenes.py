"""Coverage scenes: repeatable, and visible in all their test views."""

import numpy as np
import pytest
from coverage_scenes import (
    COVERAGE_SCENES,
    TEST_VIEWS,
    coverage_scene,
)

from cogsplat.codec.render.rasteriser import render

BUILDINGS = ("room", "two-rooms")


@pytest.mark.parametrize("name", COVERAGE_SCENES)
def test_a_scene_is_valid_and_the_same_each_time(name: str) -> None:
    scene, again = coverage_scene(name, 900), coverage_scene(name, 900)
    assert len(scene.splats) == 900
    assert scene.splats.sh_degree == 0
    scene.splats.require_valid()
    np.testing.assert_array_equal(scene.splats.means, again.splats.means)
    assert len(scene.test_views) == TEST_VIEWS
    for one, other in zip(scene.test_views, again.test_views, strict=True):
        np.testing.assert_array_equal(one.translation, other.translation)


@pytest.mark.parametrize("name", COVERAGE_SCENES)
def test_every_test_view_shows_the_scene(name: str) -> None:
    scene = coverage_scene(name, 4000)
    for view in scene.test_views:
        assert render(scene.splats, view).max() > 0.1, view.name


@pytest.mark.parametrize("name", BUILDINGS)
def test_test_views_of_a_building_are_inside(name: str) -> None:
    scene = coverage_scene(name, 4000)
    low, high = scene.splats.means.min(axis=0), scene.splats.means.max(axis=0)
    for view in scene.test_views:
        assert ((view.position > low) & (view.position < high)).all()
        # Walls all around: hardly a pixel stays black.
        picture = render(scene.splats, view)
        assert (picture.max(axis=2) > 0.02).mean() > 0.9


def test_seeds_and_degrees_are_heeded_and_other_names_refused() -> None:
    one, other = coverage_scene("card", 300, seed=1), coverage_scene("card", 300, seed=2)
    assert not np.array_equal(one.splats.means, other.splats.means)
    assert coverage_scene("card", 300, sh_degree=2).splats.sh_degree == 2
    with pytest.raises(ValueError, match="expected one of"):
        coverage_scene("sphere")
