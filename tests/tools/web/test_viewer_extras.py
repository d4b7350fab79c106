"""The viewer's parts that are loaded when they are asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, wait_until
from faulty_server import FaultyServer
from running import SmallScene

from cogsplat.codec.cameras import Camera
from cogsplat.tools.delivery.viewer_pages import write_standalone_page
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 400, 300
PHONE = {"width": 390, "height": 700}
COMPLETE = "s.state === 'complete' && s.upToDate"
PIXELS = 4
"""Longest way between a click and what was picked by it, px."""


def camera() -> Camera:
    return synth_cameras(48, WIDTH, HEIGHT)[8]


def open_whole(page: Page, url: str) -> None:
    page.goto(url)
    look_from(page, camera())
    wait_until(page, COMPLETE)


def target(page: Page) -> list[float]:
    found: list[float] = page.evaluate("() => cogsplatViewer.view.target")
    return found


def asked(server: FaultyServer, name: str) -> bool:
    return any(file == name for _, file, _ in server.traffic.rows)


def test_a_double_click_brings_a_point_into_the_middle(page: Page, server: FaultyServer) -> None:
    open_whole(page, server.url)
    assert not asked(server, "viewer_extras.js")
    before = target(page)
    page.mouse.dblclick(150, 190)
    page.wait_for_function(
        "(old) => String(cogsplatViewer.view.target) !== String(old)", arg=before
    )
    page.evaluate(
        "() => cogsplatViewer.addEventListener('cogsplat-view', () => { window.rested = 1; })"
    )
    page.wait_for_function("() => window.rested === 1")
    assert asked(server, "viewer_extras.js")
    view = camera()
    x, y, z = view.rotation @ np.array(target(page)) + view.translation
    assert abs(view.fx * x / z + WIDTH / 2 - 150) < PIXELS
    assert abs(view.fy * y / z + HEIGHT / 2 - 190) < PIXELS
    assert z > 0.2


def test_two_points_are_measured_in_a_page_without_a_server(
    browser: Browser, small: SmallScene, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    with path.open("wb") as out:
        write_standalone_page("scene", [small.cogs.read_bytes()], out)
    context = browser.new_context(viewport=PHONE, is_mobile=True, has_touch=True)
    page = context.new_page()
    refused: list[str] = []
    page.on("console", lambda message: refused.append(message.text))
    open_whole(page, path.as_uri())
    page.get_by_role("button", name="Settings").tap()
    page.get_by_role("button", name="Measure").tap()
    bar = page.get_by_role("group", name="Measure")
    expect(bar).to_contain_text("choose the first point")
    page.touchscreen.tap(150, 400)
    expect(bar).to_contain_text("second point")
    page.touchscreen.tap(250, 300)
    expect(bar).to_contain_text("scene units")
    places = page.evaluate(
        """() => [...cogsplatViewer.shadowRoot.querySelectorAll(".dot")].map((dot) => {
          const { x, y } = dot.getBoundingClientRect();
          return [x + 6, y + 6];
        })"""
    )
    assert np.abs(np.array(places) - [[150, 400], [250, 300]]).max() < PIXELS, json.dumps(places)
    bar.get_by_role("button", name="Done").tap()
    expect(bar).to_be_hidden()
    assert refused == []
    context.close()
