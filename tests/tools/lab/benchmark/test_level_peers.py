"""Comparison of detail levels with other models."""

import numpy as np
import pytest

from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.tools.lab.benchmark.level_peers import (
    Model,
    chart,
    measure_quality,
    models,
    own_rows,
    size_rows,
)
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CONFIG = LevelsConfig(scales=(2, 1), shares=(0.4, 1.0), steps=4, threads=1)


class Brightness:
    """Substitute for the LPIPS network: distance of mean brightness."""

    name = "brightness"
    smallest_side = 40

    def features(self, picture):
        return [np.clip(picture, 0, 1).mean()]

    def distance(self, first, second):
        return abs(float(first[0] - second[0]))


@pytest.fixture(scope="module")
def scene():
    return synth(400), synth_cameras(4, 64, 48)


@pytest.mark.slow
def test_each_model_is_measured_at_each_size(scene):
    splats, cameras = scene
    of = models(splats, cameras[:3], CONFIG)
    ways = [(model.way, model.scale) for model in of]
    assert ways == [
        ("level", 2),
        ("level", 1),
        ("single-scale", 2),
        ("cut, not trained", 2),
        ("single-scale", 1),
        ("cut, not trained", 1),
        ("multi-scale", 1),
        ("the scene", 1),
    ]
    assert of[0].bytes_fetched < of[1].bytes_fetched
    assert of[0].opacity_bytes == 0 < of[1].opacity_bytes
    found = measure_quality(splats, of, cameras[3:], CONFIG, lpips=Brightness())
    # At full size the scene itself has the highest PSNR.
    assert found[-1].figures[1].psnr_db > max(one.figures[1].psnr_db for one in found[:-1])
    rows = own_rows(found)
    # Pictures of 32 x 24 pixels are too small for this network.
    assert [row[-1] == "-" for row in rows] == [model.scale == 2 for model in of]
    assert float(rows[-1][-1]) == 0.0
    assert [len(row) for row in size_rows(found)] == [4] * len(of)


def test_a_chart_has_a_line_for_each_model(scene):
    splats, cameras = scene
    of = [Model("the scene", 1, splats), Model("half of it", 2, splats.take(slice(0, 200)))]
    found = measure_quality(splats, of, cameras[:1], CONFIG)
    assert found[0].figures[2].lpips is None
    drawn = chart(found, 64)
    assert drawn.startswith("<svg")
    assert "the scene 1/1" in drawn
    assert "half of it 1/2" in drawn
