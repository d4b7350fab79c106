"""The real scene that the figures of record are stated for."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cogsplat.codec.metrics import psnr
from cogsplat.codec.order.orders import OrderConfig, OrderInputs, order_rows
from cogsplat.codec.render.rasteriser import RenderConfig, render_views
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.scenes.registry import read_scene

FOX = Path(__file__).parents[4] / "shared" / "data" / "fox"

pytestmark = [
    pytest.mark.shared,
    pytest.mark.slow,
    pytest.mark.skipif(not FOX.is_dir(), reason="the real scenes are not here"),
]

# What the scene was trained over, and what its trainer's renderer scored against the photos.
BACKGROUND = (0.613, 0.010, 0.398)
TRAINING_DB, HELD_OUT_DB = 35.56, 31.49

# Mean PSNR on the held-out views against the full render, by share of splats kept, of each order
# and octree depth; scored on the other views alone, without jitter.
ORDER_DB = {
    ("contribution", 3): {0.01: 12.2, 0.1: 17.8, 0.2: 20.8, 0.5: 28.9},
    ("antimatter", 3): {0.01: 13.4, 0.1: 17.5, 0.5: 25.6},
    ("sgss", 3): {0.01: 13.2, 0.1: 17.1, 0.5: 26.2},
    ("octree-round-robin", 3): {0.01: 11.8, 0.1: 16.1, 0.5: 25.6},
    ("octree-quota", 3): {0.01: 8.9, 0.1: 15.4, 0.5: 28.6},
    ("octree-quota", 5): {0.01: 7.7, 0.1: 14.2, 0.5: 29.7},
    ("opacity", 3): {0.01: 10.7, 0.1: 15.5, 0.5: 26.3},
    ("distance", 3): {0.01: 5.2, 0.1: 5.6, 0.5: 8.5},
    ("random", 3): {0.01: 5.6, 0.1: 8.8, 0.5: 20.7},
}

# What an order by one view gains at that view, dB, and the most that it may cost the others.
FIRST_VIEWS = (1, 9, 17, 25, 33, 41)
FIRST_VIEW_GAIN_DB = {0.01: 1.2, 0.04: 2.0, 0.08: 3.0}
FIRST_VIEW_COST_DB = 1.0


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


@pytest.fixture(scope="module")
def scored(fox):
    splats, cameras = fox
    train, _ = hold_out(cameras, 8)
    return OrderInputs(splats, score(splats, train, ScoreConfig(jitter=False)), train)


def mean_db(splats, rows, share, cameras, full):
    part = render_views(splats.take(rows[: round(share * len(splats))]), cameras)
    return np.mean([psnr(a, b) for a, b in zip(full, part, strict=True)])


def test_orders_give_the_known_quality(fox, scored):
    splats, cameras = fox
    held = hold_out(cameras, 8)[1]
    full = render_views(splats, held)
    for (name, depth), known in ORDER_DB.items():
        rows = order_rows(name, scored, OrderConfig(octree_depth=depth))
        for share, expected in known.items():
            found = mean_db(splats, rows, share, held, full)
            assert found == pytest.approx(expected, abs=0.3), f"{name} {depth} at {share:.0%}"


def test_first_view_gains_there_and_costs_the_others_little(fox, scored):
    splats, cameras = fox
    plain = order_rows("contribution", scored)
    gains = {share: [] for share in FIRST_VIEW_GAIN_DB}
    costs = []
    held = hold_out(cameras, 8)[1]
    full = render_views(splats, held)
    before = mean_db(splats, plain, 0.2, held, full)
    for index in FIRST_VIEWS:
        camera = [cameras[index]]
        there = render_views(splats, camera)
        # Unmixed: what is for the others comes behind it.
        config = OrderConfig(first_view=camera[0], first_view_mix=1.0)
        rows = order_rows("contribution+first-view", scored, config)
        for share, found in gains.items():
            ours, others = (mean_db(splats, r, share, camera, there) for r in (rows, plain))
            found.append(ours - others)
        costs.append(before - mean_db(splats, rows, 0.2, held, full))
    for share, least in FIRST_VIEW_GAIN_DB.items():
        assert np.mean(gains[share]) >= least, f"at {share:.0%}"
    assert max(costs) < FIRST_VIEW_COST_DB
