"""Scenes that views cover badly: the same each time, and judged from where they can be seen."""

import numpy as np
import pytest

from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.coverage_scenes import (
    COVERAGE_SCENES,
    JUDGE_VIEWS,
    coverage_scene,
)

BUILDINGS = ("room", "two-rooms")


@pytest.mark.parametrize("name", COVERAGE_SCENES)
def test_a_scene_is_valid_and_the_same_each_time(name: str) -> None:
    scene, again = coverage_scene(name, 900), coverage_scene(name, 900)
    assert len(scene.splats) == 900
    assert scene.splats.sh_degree == 0
    scene.splats.require_valid()
    np.testing.assert_array_equal(scene.splats.means, again.splats.means)
    assert len(scene.judges) == JUDGE_VIEWS
    for one, other in zip(scene.judges, again.judges, strict=True):
        np.testing.assert_array_equal(one.translation, other.translation)


@pytest.mark.parametrize("name", COVERAGE_SCENES)
def test_every_judge_sees_the_scene(name: str) -> None:
    scene = coverage_scene(name, 4000)
    for judge in scene.judges:
        assert render(scene.splats, judge).max() > 0.1, judge.name


@pytest.mark.parametrize("name", BUILDINGS)
def test_judges_of_a_building_are_inside(name: str) -> None:
    scene = coverage_scene(name, 4000)
    low, high = scene.splats.means.min(axis=0), scene.splats.means.max(axis=0)
    for judge in scene.judges:
        assert ((judge.position > low) & (judge.position < high)).all()
        # Walls all around: hardly a pixel stays black.
        picture = render(scene.splats, judge)
        assert (picture.max(axis=2) > 0.02).mean() > 0.9


def test_seeds_and_degrees_are_heeded_and_other_names_refused() -> None:
    one, other = coverage_scene("card", 300, seed=1), coverage_scene("card", 300, seed=2)
    assert not np.array_equal(one.splats.means, other.splats.means)
    assert coverage_scene("card", 300, sh_degree=2).splats.sh_degree == 2
    with pytest.raises(ValueError, match="expected one of"):
        coverage_scene("sphere")
