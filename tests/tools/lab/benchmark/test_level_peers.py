"""Comparison of levels with prefixes and with files for one size."""

import numpy as np
import pytest

from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.tools.lab.benchmark.level_peers import Model, measure_quality, models, rows
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
    cameras = synth_cameras(4, 64, 48)
    return synth(400).with_capture(capture_of_cameras(cameras)), cameras


@pytest.mark.slow
def test_each_size_has_a_level_prefixes_and_a_file_of_its_own(scene):
    splats, cameras = scene
    of = models(splats, cameras[:3], CONFIG, "fast")
    ways = ["level", "prefix, same bytes", "prefix, same splats", "a file for this size"]
    assert [(one.way, one.scale) for one in of] == [(way, s) for s in (2, 1) for way in ways]
    assert all(one.splats.info.capture == splats.info.capture for one in of)
    assert of[0].bytes_fetched < of[4].bytes_fetched
    # A prefix has at most the bytes of the level.
    assert all(of[at + 1].bytes_fetched <= of[at].bytes_fetched for at in (0, 4))
    found = measure_quality(splats, of, cameras[3:])
    assert [row[:2] for row in rows(found)] == [(f"1/{one.scale}", one.way) for one in of]


def test_models_are_measured_at_their_own_size(scene):
    splats, cameras = scene
    of = [Model("the scene", 1, splats), Model("half of it", 2, splats.take(slice(0, 200)))]
    whole, half = measure_quality(splats, of, cameras[:1], lpips=Brightness())
    assert whole.figures.psnr_db == 100.0 > half.figures.psnr_db
    # Pictures of 32 x 24 pixels are too small for this network.
    assert [row[-1] for row in rows([whole, half])] == ["0.0000", "-"]
