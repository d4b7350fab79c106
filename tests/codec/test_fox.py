"""The real scene that the figures of record are stated for."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cogsplat.codec.metrics import psnr
from cogsplat.codec.rasterise import RenderConfig, render_views
from cogsplat.codec.score import ScoreConfig, score
from cogsplat.codec.views import hold_out
from cogsplat.formats.camera_files import read_cameras
from cogsplat.formats.registry import read_scene

FOX = Path(__file__).parents[3] / "shared" / "data" / "fox"

pytestmark = [
    pytest.mark.shared,
    pytest.mark.slow,
    pytest.mark.skipif(not FOX.is_dir(), reason="the real scenes are not here"),
]

# What the scene was trained over, and what its trainer's renderer scored against the photos.
BACKGROUND = (0.613, 0.010, 0.398)
TRAINING_DB, HELD_OUT_DB = 35.56, 31.49

# Mean PSNR on the held-out views against the full render, by share of splats kept.
ORDER_DB = {0.01: 12.2, 0.1: 17.8, 0.2: 20.8, 0.5: 28.9}


@pytest.fixture(scope="module")
def fox():
    return read_scene(FOX / "scene.ply"), read_cameras(FOX / "cameras.json")


def test_renders_match_the_photos_as_in_training(fox):
    splats, cameras = fox
    pictures = render_views(splats, cameras, RenderConfig(background=BACKGROUND))
    photos = [
        np.asarray(Image.open(FOX / "images" / camera.name).convert("RGB"), np.float32) / 255
        for camera in cameras
    ]
    quality = np.array([psnr(a, b) for a, b in zip(pictures, photos, strict=True)])
    held = np.arange(len(cameras)) % 8 == 0
    assert quality[~held].mean() == pytest.approx(TRAINING_DB, abs=0.5)
    assert quality[held].mean() == pytest.approx(HELD_OUT_DB, abs=0.5)


def test_order_by_contribution_gives_the_known_quality(fox):
    splats, cameras = fox
    train, held = hold_out(cameras, 8)
    contribution = score(splats, train, ScoreConfig(jitter=False)).contribution
    order = np.argsort(-contribution, kind="stable")
    full = render_views(splats, held)
    for share, expected in ORDER_DB.items():
        part = render_views(splats.take(order[: round(share * len(splats))]), held)
        quality = np.mean([psnr(a, b) for a, b in zip(full, part, strict=True)])
        assert quality == pytest.approx(expected, abs=0.3), f"at {share:.0%}"
