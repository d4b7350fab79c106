"""What people do with the viewer: settings, keys, film strip, comparison, fingers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, picture, statistics, wait_until
from faulty_server import FaultyServer
from numpy.typing import NDArray
from running import SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.tools.delivery.slow_server import Reply, running
from cogsplat.tools.delivery.viewer_pages import linked_page
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 400, 300
PHONE = {"width": 390, "height": 844}
COMPLETE = "s.state === 'complete' && s.upToDate"
SAME_DB = 38.0
OTHER_DB = 30.0


def camera() -> Camera:
    return synth_cameras(48, WIDTH, HEIGHT)[8]


def drawn(splats: Splats) -> NDArray[np.float32]:
    return np.clip(render(splats, camera()), 0, 1)


def open_whole(page: Page, server: FaultyServer) -> NDArray[np.float32]:
    page.goto(server.url)
    look_from(page, camera())
    wait_until(page, COMPLETE)
    return picture(page)


def settled(page: Page, frames: object) -> NDArray[np.float32]:
    """Return the picture when one more was drawn and nothing is left to draw."""
    wait_until(page, f"s.frames > {frames} && s.upToDate")
    return picture(page)


def test_settings_change_the_picture(page: Page, server: FaultyServer, small: SmallScene) -> None:
    open_whole(page, server)
    page.keyboard.press("g")
    panel = page.get_by_role("form", name="Settings")
    expect(panel).to_be_visible()
    whole = cogsplat.decode(small.cogs)

    frames = statistics(page)["frames"]
    panel.get_by_label("Reflections (SH degree)").select_option("0")
    plain = whole.with_sh_degree(0)
    assert psnr(settled(page, frames), drawn(plain)) >= SAME_DB

    frames = statistics(page)["frames"]
    panel.get_by_label("Reflections (SH degree)").select_option("3")
    panel.get_by_label("Background").select_option("#ffffff")
    white = np.clip(render(whole, camera(), RenderConfig(background=(1.0, 1.0, 1.0))), 0, 1)
    assert psnr(settled(page, frames), white) >= SAME_DB

    panel.get_by_label("Statistics").check()
    expect(panel.get_by_role("row", name="Splats drawn")).to_contain_text(f"{len(whole):,}")
    panel.get_by_label("Splats", exact=True).fill("20")
    budget = -(-len(whole) * 20 // 100)
    expect(panel.get_by_role("row", name="Splats drawn")).to_contain_text(f"{budget:,}")
    page.keyboard.press("Escape")
    expect(panel).to_be_hidden()


def test_keys_turn_and_go_back(page: Page, server: FaultyServer) -> None:
    open_whole(page, server)
    page.locator("canvas").focus()
    before, frames = picture(page), statistics(page)["frames"]
    page.keyboard.down("ArrowLeft")
    wait_until(page, f"s.frames > {int(str(frames))} + 2")
    page.keyboard.up("ArrowLeft")
    frames = statistics(page)["frames"]
    page.keyboard.press("w")
    turned = settled(page, frames)
    assert psnr(turned, before) < OTHER_DB
    frames = statistics(page)["frames"]
    page.keyboard.press("r")
    assert psnr(settled(page, frames), before) >= 45


def test_the_strip_shows_the_scene_as_it_grew(page: Page, server: FaultyServer) -> None:
    open_whole(page, server)
    page.locator("canvas").focus()
    whole = picture(page)
    page.keyboard.press("t")
    strip = page.get_by_role("group", name="The scene after parts of its file")
    buttons = strip.get_by_role("button")
    page.wait_for_function(
        "() => cogsplatViewer.shadowRoot.querySelector('#strip [aria-pressed=true]')"
    )
    sizes = buttons.all_text_contents()
    assert len(sizes) >= 3
    assert all("kB" in text for text in sizes)
    total = server.files["scene.cogs"]
    assert sizes[-1].startswith(f"{len(total) / 1000:.3g}"[:2])
    # Pictures of the strip grow to the whole, and none of them is empty.
    shown = [tile(button) for button in buttons.all()]
    near = [psnr(part, shown[-1]) for part in shown[:-1]]
    assert near == sorted(near)
    assert all(part.max() > 0.3 for part in shown)

    frames = statistics(page)["frames"]
    buttons.first.click()
    expect(buttons.first).to_have_attribute("aria-pressed", "true")
    assert psnr(settled(page, frames), whole) < OTHER_DB
    frames = statistics(page)["frames"]
    page.keyboard.press("t")
    expect(strip).to_be_hidden()
    assert psnr(settled(page, frames), whole) >= 45


def tile(button: Locator) -> NDArray[np.float32]:
    """Return what a picture of the strip shows."""
    width, height, values = button.locator("canvas").evaluate(
        "(it) => [it.width, it.height,"
        " [...it.getContext('2d').getImageData(0, 0, it.width, it.height).data]]"
    )
    pixels = np.array(values, np.float32).reshape(height, width, 4) / 255
    return np.ascontiguousarray(pixels[..., :3])


def test_two_scenes_meet_at_a_line_that_moves(
    page: Page, server: FaultyServer, small: SmallScene, tmp_path: Path
) -> None:
    ours = cogsplat.decode(small.cogs)
    other = replace(ours, sh0=-ours.sh0)
    cogsplat.write(other, tmp_path / "other.ply")
    server.files |= linked_page("Garden", "scene.cogs", "other.ply", "Garden <negative>")
    server.files["other.ply"] = (tmp_path / "other.ply").read_bytes()
    page.goto(server.url)
    look_from(page, camera())
    line = page.get_by_role("slider", name="Where the two scenes meet")
    expect(line).to_be_visible()
    for name in ("Garden", "Garden <negative>"):
        expect(page.get_by_text(name, exact=True)).to_be_visible()
    wait_until(page, COMPLETE)
    # The second scene tells nobody when it is whole.
    wanted = drawn(other)
    for share in (50, 80, 20):
        line.focus()
        page.keyboard.press("Home")
        for _ in range(share // 2):
            page.keyboard.press("ArrowRight")
        expect(line).to_have_attribute("aria-valuenow", str(share))
        at = WIDTH * share // 100
        expected = np.concatenate([wanted[:, :at], drawn(ours)[:, at:]], axis=1)
        for _ in range(40):
            wait_until(page, "s.upToDate")
            if psnr(picture(page), expected) >= OTHER_DB:
                break
            page.wait_for_timeout(100)
        assert psnr(picture(page), expected) >= OTHER_DB
    box = line.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 20, 100)
    page.mouse.down()
    page.mouse.move(200, 100)
    page.mouse.up()
    expect(line).to_have_attribute("aria-valuenow", "50")


def overlap(one: Locator, other: Locator) -> bool:
    first, second = one.bounding_box(), other.bounding_box()
    assert first is not None
    assert second is not None
    return all(
        first[at] < second[at] + second[size] and second[at] < first[at] + first[size]
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_nothing_covers_anything_on_a_phone(
    browser: Browser, server: FaultyServer, small: SmallScene
) -> None:
    context = browser.new_context(
        viewport=PHONE, device_scale_factor=1, is_mobile=True, has_touch=True
    )
    page = context.new_page()
    # Most has come: the longest text that is written while a scene arrives.
    server.hold_at(0.9 * small.cogs.stat().st_size)
    page.goto(server.url)
    wait_until(page, "s.splats > 0 && s.upToDate")
    status, tools = page.get_by_role("status"), page.get_by_role("toolbar", name="Viewer")
    expect(status).to_contain_text("dB predicted")
    assert not overlap(status, tools)
    page.get_by_role("button", name="Film strip").tap()
    strip = page.get_by_role("group", name="The scene after parts of its file")
    expect(strip.get_by_role("button").first).to_be_visible()
    for thing in (status, tools):
        assert not overlap(strip, thing)
    page.get_by_role("button", name="Settings").tap()
    panel = page.get_by_role("form", name="Settings")
    expect(panel).to_be_visible()
    expect(strip).to_be_hidden()
    assert not overlap(panel, tools)
    inside = panel.bounding_box()
    assert inside is not None
    assert inside["x"] >= 0
    assert inside["x"] + inside["width"] <= PHONE["width"]
    assert inside["y"] >= 0
    context.close()


def test_two_fingers_come_nearer(browser: Browser, server: FaultyServer) -> None:
    context = browser.new_context(viewport=PHONE, is_mobile=True, has_touch=True)
    page = context.new_page()
    page.goto(server.url)
    wait_until(page, COMPLETE)
    before, frames = picture(page), statistics(page)["frames"]
    session = context.new_cdp_session(page)
    for kind, apart in (("touchStart", 40), ("touchMove", 80), ("touchMove", 140)):
        points = [
            {"x": 195 - apart, "y": 400, "id": 0},
            {"x": 195 + apart, "y": 400, "id": 1},
        ]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    near = settled(page, frames)
    assert psnr(near, before) < 35
    # What is in the middle stays there and fills more of the picture.
    middle = near[340:460, 140:250]
    assert middle.std() > 0.01
    context.close()


def test_a_page_that_refuses_workers_is_shown_all_the_same(
    page: Page, server: FaultyServer, small: SmallScene
) -> None:
    allowed, refused = b"worker-src 'self'", b"worker-src 'none'"
    assert allowed in server.files["index.html"]
    server.files["index.html"] = server.files["index.html"].replace(allowed, refused)
    assert psnr(open_whole(page, server), drawn(cogsplat.decode(small.cogs))) >= SAME_DB
    # And a PLY, in the same page.
    server.files["scene.ply"] = small.ply.read_bytes()
    page.evaluate("() => cogsplatViewer.load(new URL('scene.ply', location.href).href)")
    wait_until(page, f"{COMPLETE} && s.totalSplats === {len(cogsplat.read(small.ply))}")
    assert psnr(picture(page), drawn(cogsplat.read(small.ply))) >= 28


class ReplacingServer(FaultyServer):
    """Another file takes the place of the scene after the first request for it."""

    replacement = b""
    asked = 0

    def reply(self, name: str, wanted: str | None) -> Reply:
        if name == self.name:
            self.asked += 1
            if self.asked == 2:
                self.files[name] = self.replacement
        return super().reply(name, wanted)


def test_a_scene_that_is_replaced_meanwhile_is_shown_anew(page: Page, tmp_path: Path) -> None:
    first, second = tmp_path / "first.cogs", tmp_path / "second.cogs"
    splats = synth(12_000)
    for path, colours in ((first, splats.sh0), (second, -splats.sh0)):
        cogsplat.encode(replace(splats, sh0=colours), path, preset="fast")
    # The first request takes 64 KiB; what is behind is asked for by another one.
    assert first.stat().st_size > 80_000
    files = {**linked_page("scene"), "scene.cogs": first.read_bytes()}
    with running(ReplacingServer(files)) as server:
        server.replacement = second.read_bytes()
        page.goto(server.url)
        look_from(page, camera())
        wait_until(page, COMPLETE)
        assert psnr(picture(page), drawn(cogsplat.decode(second))) >= SAME_DB
