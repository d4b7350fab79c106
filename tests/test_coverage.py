"""Scenes without cameras: no view falls far below the others, and the prediction holds elsewhere.

The scenes are hard to cover with views; the encoder does not use their test views.
"""

from pathlib import Path

import numpy as np
import pytest
from coverage_scenes import CoverageScene, coverage_scene

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render

# One of each kind of `COVERAGE_SCENES` (thin, hollow, flat, with a thin long part, seen from
# inside, seen from inside of each of two rooms), and its number of splats.
TRIED = {
    "lamp": 6_000,
    "shell": 10_000,
    "card": 6_000,
    "statue": 6_000,
    "room": 6_000,
    "two-rooms": 6_000,
}


def measured_quality(scene: CoverageScene, decoded: cogsplat.Splats) -> list[float]:
    pairs = ((render(scene.splats, view), render(decoded, view)) for view in scene.test_views)
    return [float(psnr(whole, found)) for whole, found in pairs]


@pytest.mark.parametrize("name", list(TRIED))
def test_no_view_of_a_scene_without_cameras_falls_far_below_the_others(
    name: str, tmp_path: Path
) -> None:
    scene = coverage_scene(name, TRIED[name])
    made = cogsplat.encode(scene.splats, tmp_path / "scene.cogs", preset="fast")
    assert made.views == made.test_views == "planned"
    assert made.coverage >= 0.98
    found = measured_quality(scene, cogsplat.decode(tmp_path / "scene.cogs"))
    assert np.mean(found) - min(found) < 6.0
    assert np.mean(made.test_psnr_db) == pytest.approx(np.mean(found), abs=1.0)
    # The nominal quality.
    assert np.mean(found) == pytest.approx(40.0, abs=2.0)


def test_compare_measures_in_the_views_of_the_prediction(tmp_path: Path) -> None:
    splats = coverage_scene("card", 2_000).splats
    made = cogsplat.encode(splats, tmp_path / "scene.cogs", preset="fast")
    compared = cogsplat.compare(splats, tmp_path / "scene.cogs")
    told = [quality.psnr_db for quality in compared.test]
    assert told == pytest.approx(made.test_psnr_db, abs=0.05)
    assert [quality.psnr_db for quality in compared.close] == pytest.approx(
        made.close_psnr_db, abs=0.05
    )
