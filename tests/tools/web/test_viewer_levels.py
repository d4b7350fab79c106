"""Scenes with levels, and chunks that end, in the viewer in a real browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, picture, shows, statistics, wait_until
from faulty_server import FaultyServer

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.fit.level_encoding import encode_levels
from cogsplat.codec.fit.level_training import LevelledSplats
from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.views.first_look import FirstLook
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.tools.delivery.slow_server import running
from cogsplat.tools.delivery.viewer_pages import linked_page
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 400, 320
FULL = synth_cameras(48, 2 * WIDTH, 2 * HEIGHT)[8]
"""The first view of the files: what full pictures are taken by. No viewer is lower than 160 px."""
CAMERA = FULL.downscaled(2)
SAME_DB = 38.0
"""What a picture must have against our own render of the same data."""


@pytest.fixture(scope="module")
def levels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three levels of 2,000 splats added each; some are left out later, and opacities change."""
    count, added = 6000, 2000
    splats = synth(count)
    first = np.arange(count) // added
    last = np.full(count, 2)
    last[:300] = 0
    last[300:500] = last[2000:2500] = 1
    opacities = np.tile(splats.opacities, (3, 1))
    opacities[1:, :added] -= np.float32(1.5)
    opacities[2, : 2 * added] += np.linspace(-2, 2, 2 * added, dtype=np.float32)
    scene = LevelledSplats(splats, (4, 2, 1), first, last, opacities)
    encoded = encode_levels(scene, synth_cameras(6, 160, 120), LevelsConfig(chunk_splats=500))
    path = tmp_path_factory.mktemp("levels") / "scene.cogs"
    cogs.save(encoded, path, writer="test", look=FirstLook(view=FULL))
    return path


def serve(path: Path) -> FaultyServer:
    return FaultyServer({**linked_page("scene"), "scene.cogs": path.read_bytes()})


def assert_level(page: Page, path: Path, level: float, camera: Camera) -> None:
    """The viewer must say that it draws a level, and its picture be our own of that level."""
    wait_until(page, f"s.upToDate && s.state === 'complete' && Math.abs(s.level - {level}) < 1e-3")
    ours = np.clip(render(cogsplat.decode(path, level=level), camera), 0, 1)
    assert psnr(picture(page), ours) >= SAME_DB


@pytest.mark.parametrize(("share", "level"), [(0.25, 0), (0.375, 0.5), (0.75, 1.5)])
def test_the_level_follows_from_the_size_of_the_picture(
    browser: Browser, levels: Path, share: float, level: float
) -> None:
    width, height = round(share * FULL.width), round(share * FULL.height)
    page = browser.new_page(viewport={"width": width, "height": height})
    small = replace(
        FULL, width=width, height=height, fx=share * FULL.fx, fy=share * FULL.fy,
        cx=width / 2, cy=height / 2,
    )  # fmt: skip
    with running(serve(levels)) as server:
        page.goto(server.url)
        look_from(page, small)
        assert_level(page, levels, level, small)
    page.close()


def test_a_level_can_be_chosen(page: Page, levels: Path) -> None:
    with running(serve(levels)) as server:
        page.goto(server.url)
        look_from(page, CAMERA)
        assert_level(page, levels, 1, CAMERA)
        for level in (0, 1.25, 2):
            page.evaluate(
                f"() => document.querySelector('cogsplat-viewer').setAttribute('level', '{level}')"
            )
            assert_level(page, levels, level, CAMERA)
        page.keyboard.press("g")
        select = page.get_by_label("Level")
        select.wait_for()
        options = [
            "By the picture's size", "For 1/4 of it", "For 1/2 of it", "For full size",
        ]  # fmt: skip
        assert select.locator("option").all_inner_texts() == options
        select.select_option("For 1/4 of it")
        assert_level(page, levels, 0, CAMERA)
        select.select_option("By the picture's size")
        assert_level(page, levels, 1, CAMERA)


def test_a_scene_without_levels_offers_none(page: Page, server: FaultyServer) -> None:
    page.goto(server.url)
    assert "level" not in wait_until(page, "s.upToDate && s.state === 'complete'")
    page.keyboard.press("g")
    page.get_by_role("form", name="Settings").wait_for()
    assert not page.get_by_label("Level").is_visible()


def test_levels_grow_into_each_other_as_they_arrive(page: Page, levels: Path) -> None:
    data = levels.read_bytes()
    seen: list[object] = []
    with running(serve(levels)) as running_server:
        server = running_server
        assert isinstance(server, FaultyServer)
        server.hold_at(0)
        page.goto(server.url)
        page.evaluate("() => window.cogsplatViewer.setAttribute('level', '2')")
        look_from(page, CAMERA)
        for part in range(1, 11):
            server.hold_at(part * len(data) / 10)
            wait_until(page, f"s.upToDate && s.bytes >= {part * len(data) // 10}")
            seen.append(statistics(page).get("level"))
        assert_level(page, levels, 2, CAMERA)
    drawn = [level for level in seen if isinstance(level, int | float)]
    assert drawn == sorted(drawn)
    assert any(0 < level < 1 for level in drawn)
    assert any(1 < level < 2 for level in drawn)


@pytest.fixture(scope="module")
def ending(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene whose first chunk ends with the fifth chunk."""
    splats = synth(4000)
    config = EncodeConfig(chunk_splats=500, prune=None, compensate=False, order="contribution")
    encoded = pipeline.encode(
        splats, EncodeRequest(cameras=synth_cameras(6, 160, 120), config=config)
    )
    chunks = [
        replace(chunk, until=5) if number == 0 else chunk
        for number, chunk in enumerate(encoded.chunks)
    ]
    path = tmp_path_factory.mktemp("ending") / "scene.cogs"
    cogs.save(replace(encoded, chunks=chunks), path, writer="test", look=FirstLook(view=FULL))
    return path


def test_splats_of_the_first_seconds_go_when_they_have_ended(page: Page, ending: Path) -> None:
    size = ending.stat().st_size
    with running(serve(ending)) as running_server:
        server = running_server
        assert isinstance(server, FaultyServer)
        server.hold_at(0)
        page.goto(server.url)
        look_from(page, CAMERA)
        for size_bytes in (int(0.4 * size), int(0.9 * size), size):
            server.hold_at(size_bytes)
            ours = render(cogsplat.decode(ending, size_bytes=size_bytes), CAMERA)
            assert shows(page, np.clip(ours, 0, 1), SAME_DB) >= SAME_DB
        with cogsplat.open(ending) as file:
            drawn = sum(int(rows) for rows in file.chunks.splats[1:])
        assert len(cogsplat.decode(ending)) == drawn
