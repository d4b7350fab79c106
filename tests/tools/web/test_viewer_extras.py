"""The viewer's parts that are loaded when they are asked for."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, picture, wait_until
from faulty_server import FaultyServer
from PIL import Image
from running import SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.description import Annotation, CameraPath, Description, PathStop, Picture
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


TEXT = "A <b>terrace</b> & its steps.\nSecond line."
SKY_WIDTH = 512


def sky() -> Picture:
    """Return a sky whose red grows to the right and whose green grows downwards."""
    y, x = np.mgrid[0 : SKY_WIDTH // 2, 0:SKY_WIDTH]
    colours = np.stack([256 * x / SKY_WIDTH, 512 * y / SKY_WIDTH, 0 * x], axis=-1)
    out = BytesIO()
    Image.fromarray(colours.astype(np.uint8)).save(out, "JPEG", quality=95, subsampling=0)
    return Picture("image/jpeg", SKY_WIDTH, SKY_WIDTH // 2, None, out.getvalue())


def centre(view: Camera) -> tuple[float, float, float]:
    """Return a point some way before a camera."""
    x, y, z = -view.rotation.T @ view.translation + 3 * view.rotation[2]
    return float(x), float(y), float(z)


@pytest.fixture(scope="module")
def described(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The small scene with a description."""
    views = synth_cameras(48, WIDTH, HEIGHT)
    place = np.array(centre(camera()))
    behind = -camera().rotation.T @ camera().translation - 3 * camera().rotation[2]
    description = Description(
        title="The terrace",
        text=TEXT,
        licence="CC0-1.0",
        credits="Its builders",
        metres_per_unit=0.5,
        unit="cm",
        background=(1.0, 0.5, 0.0),
        views=(replace(views[30], name="From behind"),),
        path=CameraPath((PathStop(0.0, views[8]), PathStop(2.0, views[14])), loop=True),
        annotations=(
            Annotation(place, "Middle", "Look <i>here</i>", views[9]),
            Annotation(behind, "Behind", ""),
        ),
        poster=sky(),
        sky=sky(),
    )
    path = tmp_path_factory.mktemp("described") / "scene.cogs"
    cogsplat.describe(small.cogs, description, path)
    return path.read_bytes()


def rest(page: Page) -> None:
    """Wait until no motion moves the camera and the last pose is drawn."""
    page.evaluate("() => new Promise((done) => setTimeout(done, 50))")
    last = ""
    for _ in range(400):
        page.wait_for_timeout(250)
        found = str(page.evaluate("() => JSON.stringify(cogsplatViewer.view)"))
        if found == last:
            break
        last = found
    wait_until(page, "s.upToDate")


def looks_from(page: Page, view: Camera) -> bool:
    found = page.evaluate("() => cogsplatViewer.view")
    near = np.abs(np.array(found["rotation"]) - view.rotation.ravel()).max() < 1e-5
    return bool(near and np.abs(np.array(found["translation"]) - view.translation).max() < 1e-4)


def test_the_description_is_shown_as_text(
    page: Page, server: FaultyServer, described: bytes
) -> None:
    server.files["scene.cogs"] = described
    open_whole(page, server.url)
    caption = page.get_by_role("button", name="The terrace")
    expect(caption).to_contain_text("Its builders · CC0-1.0")
    caption.focus()
    page.keyboard.press("Enter")
    about = page.get_by_role("region", name="About this scene")
    assert TEXT in about.locator(".text").text_content()
    about.get_by_role("button", name="From behind").click()
    rest(page)
    assert looks_from(page, synth_cameras(48, WIDTH, HEIGHT)[30])
    page.keyboard.press("Escape")
    expect(about).to_be_hidden()


def test_texts_and_views_need_no_further_program_until_a_click(
    page: Page, server: FaultyServer, small: SmallScene, tmp_path: Path
) -> None:
    view = synth_cameras(48, WIDTH, HEIGHT)[30]
    description = Description(
        title="The terrace",
        text=TEXT,
        credits="Its builders",
        metres_per_unit=0.5,
        background=(1.0, 0.5, 0.0),
        views=(replace(view, name="From behind"),),
        poster=sky(),
    )
    cogsplat.describe(small.cogs, description, tmp_path / "scene.cogs")
    server.files["scene.cogs"] = (tmp_path / "scene.cogs").read_bytes()
    open_whole(page, server.url)
    page.get_by_role("button", name="The terrace").click()
    about = page.get_by_role("region", name="About this scene")
    assert TEXT in about.locator(".text").text_content()
    assert not asked(server, "viewer_extras.js")
    about.get_by_role("button", name="From behind").click()
    rest(page)
    assert looks_from(page, view)
    assert asked(server, "viewer_extras.js")


def test_annotations_are_buttons_at_their_places(
    page: Page, server: FaultyServer, described: bytes
) -> None:
    server.files["scene.cogs"] = described
    open_whole(page, server.url)
    pin = page.get_by_role("button", name="1: Middle")
    expect(pin).to_be_visible()
    box = pin.bounding_box()
    assert box is not None
    assert abs(box["x"] + box["width"] / 2 - WIDTH / 2) < PIXELS
    assert abs(box["y"] + box["height"] / 2 - HEIGHT / 2) < PIXELS
    expect(page.locator(".pin").nth(1)).to_be_hidden()
    pin.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_text("Look <i>here</i>")).to_be_visible()
    expect(pin).to_have_attribute("aria-expanded", "true")
    rest(page)
    assert looks_from(page, synth_cameras(48, WIDTH, HEIGHT)[9])
    page.keyboard.press("Escape")
    expect(page.get_by_text("Look <i>here</i>")).to_be_hidden()
    expect(pin).to_be_focused()


def test_the_camera_path_pauses_at_a_touch(
    page: Page, server: FaultyServer, described: bytes
) -> None:
    server.files["scene.cogs"] = described
    open_whole(page, server.url)
    page.get_by_role("button", name="Play the camera path").click()
    pause = page.get_by_role("button", name="Pause the camera path")
    expect(pause).to_be_visible()
    page.wait_for_function(
        "(first) => Math.abs(cogsplatViewer.view.translation[0] - first) > 1e-3",
        arg=float(camera().translation[0]),
    )
    page.mouse.click(200, 150)
    expect(page.get_by_role("button", name="Play the camera path")).to_be_visible()
    rest(page)


def test_the_sky_is_behind_the_splats(page: Page, server: FaultyServer, described: bytes) -> None:
    server.files["scene.cogs"] = described
    open_whole(page, server.url)
    view = camera()
    # Far before the camera, with the whole scene behind.
    away = replace(view, translation=view.translation - np.array([0.0, 0.0, 500.0]))
    look_from(page, away)
    for _ in range(60):
        wait_until(page, "s.upToDate")
        found = picture(page)
        if found[0, 0, 2] < 0.1 and found.std() > 0.01:
            break
        page.wait_for_timeout(200)
    for x, y in ((20, 20), (200, 150), (300, 250), (380, 120)):
        direction = [(x + 0.5 - WIDTH / 2) / view.fx, (y + 0.5 - HEIGHT / 2) / view.fy, 1.0]
        # The axes of the scene are right, down and front.
        d = view.rotation.T @ np.array(direction)
        u = 0.5 + np.arctan2(d[0], d[2]) / (2 * np.pi)
        v = 0.5 + np.arcsin(d[1] / np.linalg.norm(d)) / np.pi
        assert np.abs(found[y, x] - [u, v, 0]).max() < 0.03, (x, y)


def test_a_scene_that_waits_for_a_click_shows_the_poster_of_its_file(
    page: Page, server: FaultyServer, described: bytes
) -> None:
    server.files["scene.cogs"] = described
    server.files["wait.html"] = (
        b'<!doctype html><script type="module" src="viewer.js"></script>'
        b'<cogsplat-viewer src="scene.cogs" lazy="click" style="height: 200px"></cogsplat-viewer>'
    )
    page.goto(f"{server.url}wait.html")
    poster = page.locator("#filePoster")
    expect(poster).to_be_visible()
    assert poster.evaluate("(it) => it.width") == SKY_WIDTH
    page.get_by_role("button", name="Show the scene").click()
    expect(poster).to_be_hidden(timeout=30_000)


def test_poses_are_texts(page: Page, server: FaultyServer) -> None:
    text = "3,-2,-6,0.5,0,1,40"
    server.files["pose.html"] = (
        "<!doctype html><style>body { margin: 0 } cogsplat-viewer { height: 300px }</style>"
        '<script type="module" src="viewer.js"></script>'
        f'<cogsplat-viewer src="scene.cogs" view="{text}" up="-y"></cogsplat-viewer>'
    ).encode()
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.goto(f"{server.url}pose.html")
    page.evaluate("() => { window.cogsplatViewer = document.querySelector('cogsplat-viewer'); }")
    wait_until(page, COMPLETE)
    assert page.evaluate("() => cogsplatViewer.viewText") == text
    page.locator("canvas").focus()
    page.keyboard.press("c")
    expect(page.get_by_text(f"Copied: {text.replace(',', ', ')}")).to_be_visible()
    assert page.evaluate("() => navigator.clipboard.readText()") == text
    page.evaluate("() => cogsplatViewer.setAttribute('target', '1,0,2')")
    assert target(page) == [1, 0, 2]
    page.evaluate("() => cogsplatViewer.setAttribute('view', '1,2,3')")
    expect(page.get_by_text("The attribute view cannot be used")).to_be_visible()


def test_viewers_of_a_page_share_one_budget(page: Page, server: FaultyServer) -> None:
    server.files["three.html"] = (
        b"<!doctype html><style>cogsplat-viewer { height: 170px }</style>"
        b"<script type=module src=viewer.js></script>"
        b"<cogsplat-viewer src=scene.cogs style='height: 340px'></cogsplat-viewer>"
        b"<cogsplat-viewer src=scene.cogs></cogsplat-viewer><p style='height: 3000px'></p>"
        b"<cogsplat-viewer src=scene.cogs></cogsplat-viewer>"
    )
    page.goto(f"{server.url}three.html")
    total = 1500
    page.evaluate(
        """async (total) => {
          await customElements.whenDefined("cogsplat-viewer");
          customElements.get("cogsplat-viewer").budget.total = total;
          window.all = [...document.querySelectorAll("cogsplat-viewer")];
        }""",
        total,
    )

    def drawn(*viewers: int) -> list[int]:
        found: list[int] = page.wait_for_function(
            """(viewers) => {
              const found = viewers.map((i) => all[i].statistics);
              const done = found.every((it) => it.state === "complete" && it.upToDate);
              return done && found.map((it) => it.drawnSplats);
            }""",
            arg=viewers,
            timeout=60_000,
        ).json_value()
        return found

    # Whole chunks that are within their shares by size; what is out of sight has none.
    large, small = drawn(0, 1)
    assert 0 < small <= total / 3 < large <= 2 * total / 3
    assert page.evaluate("() => all[2].statistics.splats") == 0
    before = page.evaluate("() => { all[0].view = { ...all[0].view }; return all[0].view; }")
    page.evaluate("() => scrollTo(0, 5000)")
    (last,) = drawn(2)
    assert large < last <= total
    page.evaluate("() => { scrollTo(0, 0); all[1].setAttribute('splat-budget', 2000); }")
    page.wait_for_function("() => all[1].statistics.drawnSplats > 1500")
    # What the page has chosen stays, and the others share the rest.
    assert drawn(1)[0] <= 2000
    assert page.evaluate("() => all[0].view") == before
