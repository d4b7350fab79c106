"""The viewer in a real browser: what goes wrong on the way, and what people do with it."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import threading
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, lose_graphics, picture, statistics, wait_until
from faulty_server import FaultyServer
from numpy.typing import NDArray
from running import Run, SmallScene, program

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.delivery.slow_server import Link, running
from cogsplat.tools.delivery.viewer_pages import linked_page, write_standalone_page
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 320, 240
COMPLETE = "s.state === 'complete' && s.upToDate"


def camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    return synth_cameras(48, width, height)[8]


def ours(small: SmallScene, view: Camera, size_bytes: int | None = None) -> NDArray[np.float32]:
    part = cogsplat.decode(small.cogs, size_bytes=size_bytes, compensate=True)
    return np.clip(render(part, view), 0, 1)


def open_whole(page: Page, server: FaultyServer) -> None:
    page.goto(server.url)
    look_from(page, camera())
    wait_until(page, COMPLETE)


def told(page: Page) -> str:
    """Return the sentence that a person is shown of what failed; it must stand on the page."""
    found = wait_until(page, "s.state === 'failed'")
    error = str(found["error"])
    expect(page.get_by_text(error).first).to_be_visible()
    return error


def test_it_follows_the_size_of_its_window(
    page: Page, server: FaultyServer, small: SmallScene
) -> None:
    open_whole(page, server)
    assert psnr(picture(page), ours(small, camera())) >= 38
    page.set_viewport_size({"width": 400, "height": 300})
    wait_until(page, "window.cogsplatViewer.shadowRoot.querySelector('canvas').width === 400")
    wait_until(page, COMPLETE)
    assert psnr(picture(page), ours(small, camera(400, 300))) >= 38


def test_a_cut_connection_is_mended(page: Page, server: FaultyServer, small: SmallScene) -> None:
    server.faults.breaks = [7000, 100]
    open_whole(page, server)
    assert server.faults.breaks == []
    assert psnr(picture(page), ours(small, camera())) >= 38


def test_a_server_that_is_busy_is_asked_again(
    page: Page, server: FaultyServer, small: SmallScene
) -> None:
    server.faults.statuses = [HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.TOO_MANY_REQUESTS]
    open_whole(page, server)
    assert psnr(picture(page), ours(small, camera())) >= 38


def test_a_server_without_ranges_is_read_from_the_front(
    page: Page, server: FaultyServer, small: SmallScene
) -> None:
    server.faults.ranges = False
    open_whole(page, server)
    assert psnr(picture(page), ours(small, camera())) >= 38


def test_a_type_that_means_nothing_does_not_matter(page: Page, server: FaultyServer) -> None:
    server.faults.content_type = "text/plain"
    open_whole(page, server)


def test_a_scene_that_is_not_there_is_said(page: Page, server: FaultyServer) -> None:
    del server.files["scene.cogs"]
    page.goto(server.url)
    assert "404" in told(page)


def test_a_page_in_the_place_of_the_scene_is_said(page: Page, server: FaultyServer) -> None:
    server.files["scene.cogs"] = b"<!doctype html><title>Sign in</title>" * 50
    page.goto(server.url)
    assert told(page)


def test_a_truncated_file_is_said(page: Page, server: FaultyServer, small: SmallScene) -> None:
    data = small.cogs.read_bytes()
    server.files["scene.cogs"] = data[: len(data) // 2]
    page.goto(server.url)
    assert told(page)


def test_damage_is_said(page: Page, server: FaultyServer, small: SmallScene) -> None:
    data = bytearray(small.cogs.read_bytes())
    data[-1000] ^= 1
    server.files["scene.cogs"] = bytes(data)
    page.goto(server.url)
    assert told(page)


def test_leaving_ends_the_requests(page: Page, server: FaultyServer, small: SmallScene) -> None:
    half = small.cogs.stat().st_size // 2
    server.hold_at(half)
    page.goto(server.url)
    wait_until(page, "s.splats > 0 && s.upToDate")
    page.goto("about:blank")
    server.hold_at(float("inf"))
    server.hold_at(half)
    # And coming back begins anew, in the same page and after a reload.
    page.goto(server.url)
    wait_until(page, "s.splats > 0 && s.upToDate")
    server.hold_at(float("inf"))
    page.reload()
    look_from(page, camera())
    wait_until(page, COMPLETE)
    assert psnr(picture(page), ours(small, camera())) >= 38


def test_it_comes_back_when_webgl_is_lost(
    page: Page, server: FaultyServer, small: SmallScene
) -> None:
    open_whole(page, server)
    frames = statistics(page)["frames"]
    sent = server.traffic.size_bytes("scene.cogs")
    lose_graphics(page)
    wait_until(page, f"{COMPLETE} && s.frames > {frames}")
    assert psnr(picture(page), ours(small, camera())) >= 38
    assert server.traffic.size_bytes("scene.cogs") == sent


def test_pictures_come_back_as_often_as_the_graphics_process_ends(
    page: Page, browser: Browser, server: FaultyServer
) -> None:
    open_whole(page, server)
    session = browser.new_browser_cdp_session()
    # By default Chromium gives no page WebGL after the second time.
    for _ in range(2):
        frames = statistics(page)["frames"]
        session.send("Browser.crashGpuProcess")
        wait_until(page, f"{COMPLETE} && s.frames > {frames}")


def test_graphics_that_build_no_program_are_said(page: Page, server: FaultyServer) -> None:
    page.add_init_script(
        """{
          const { prototype } = WebGL2RenderingContext;
          const asked = prototype.getProgramParameter;
          prototype.getProgramParameter = function (program, name) {
            return name === this.LINK_STATUS ? false : asked.call(this, program, name);
          };
        }"""
    )
    page.goto(server.url)
    told(page)


def test_keys_work_before_anything_was_clicked(page: Page, server: FaultyServer) -> None:
    open_whole(page, server)
    before, frames = picture(page), statistics(page)["frames"]
    for _ in range(6):
        page.keyboard.press("ArrowLeft")
    wait_until(page, f"s.frames > {frames} && s.upToDate")
    assert psnr(picture(page), before) < 35
    expect(page.locator("#panel")).to_be_hidden()
    page.keyboard.press("g")
    expect(page.locator("#panel")).to_be_visible()


def test_two_viewers_share_a_page_and_one_leaves_it(page: Page, server: FaultyServer) -> None:
    server.files["two.html"] = (
        b"<!doctype html><style>cogsplat-viewer { display: block; width: 300px; height: 100px }"
        b"</style><script type=module src=viewer.js></script>"
        b"<cogsplat-viewer src=scene.cogs></cogsplat-viewer>"
        b"<cogsplat-viewer src=scene.cogs sh-degree=0></cogsplat-viewer>"
    )
    page.goto(f"{server.url}two.html")
    complete = (
        "(count) => { const all = [...document.querySelectorAll('cogsplat-viewer')];"
        " return all.length === count && all.every((it) => it.statistics?.upToDate"
        " && it.statistics.state === 'complete'); }"
    )
    page.wait_for_function(complete, arg=2)
    page.evaluate("() => document.querySelector('cogsplat-viewer').remove()")
    page.wait_for_function(complete, arg=1)
    # And comes again.
    page.evaluate(
        """() => {
          const viewer = document.createElement("cogsplat-viewer");
          viewer.setAttribute("src", "scene.cogs");
          document.body.append(viewer);
        }"""
    )
    page.wait_for_function(complete, arg=2)


def test_a_finger_turns_the_scene_on_a_phone(browser: Browser, server: FaultyServer) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844},
        device_scale_factor=2,
        is_mobile=True,
        has_touch=True,
    )
    page = context.new_page()
    page.goto(server.url)
    wait_until(page, COMPLETE)
    canvas = page.locator("canvas").first
    assert canvas.evaluate("(it) => [it.width, it.height]") == [780, 1688]
    # Nothing of the page lies beside the screen.
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
    before = picture(page)
    frames = statistics(page)["frames"]
    session = context.new_cdp_session(page)
    for kind, x in (("touchStart", 100), ("touchMove", 160), ("touchMove", 240)):
        points = [{"x": x, "y": 400}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait_until(page, f"s.frames > {frames} && s.upToDate")
    assert psnr(picture(page), before) < 35
    context.close()


def test_pictures_come_while_a_slow_link_brings_the_scene(page: Page, small: SmallScene) -> None:
    files = {**linked_page("scene"), "scene.cogs": small.cogs.read_bytes()}
    with running(FaultyServer(files, Link(5e6, latency_seconds=0.02))) as server:
        # The last tenth waits for a picture, however slowly this machine draws.
        server.hold_at(0.9 * len(files["scene.cogs"]))
        page.goto(server.url)
        look_from(page, camera())
        seen = wait_until(page, "s.state === 'streaming' && s.frames > 0 && s.splats > 0")
        assert int(str(seen["splats"])) < int(str(seen["totalSplats"]))
        server.hold_at(float("inf"))
        wait_until(page, COMPLETE)
    assert psnr(picture(page), ours(small, camera())) >= 38


def test_a_page_without_a_server_shows_its_scene(
    page: Page, small: SmallScene, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    with path.open("wb") as out:
        write_standalone_page("scene", [small.cogs.read_bytes()], out)
    page.goto(path.as_uri())
    look_from(page, camera())
    wait_until(page, COMPLETE)
    assert psnr(picture(page), ours(small, camera())) >= 38


@pytest.mark.parametrize("ranges", [True, False])
def test_a_scene_in_a_folder_of_objects_is_shown(
    page: Page, small: SmallScene, *, ranges: bool
) -> None:
    objects = folder_of_file(small.cogs.read_bytes())
    files = linked_page("scene", "scene/") | {f"scene/{name}": x for name, x in objects.items()}
    with running(FaultyServer(files)) as server:
        server.faults.ranges = ranges
        open_whole(page, server)
        assert psnr(picture(page), ours(small, camera())) >= 38


class Quiet(SimpleHTTPRequestHandler):
    """The server of ``python -m http.server``, which knows no ranges, without its log."""

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


def test_a_folder_shows_its_scene_from_a_server_without_ranges(
    page: Page, run: Run, small: SmallScene, tmp_path: Path
) -> None:
    assert run("export-html", small.cogs, tmp_path / "site", "--folder").code == 0
    # Below a path, as on hosts that give each project one.
    handler = functools.partial(Quiet, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=[0.01])
        thread.start()
        try:
            page.goto(f"http://127.0.0.1:{server.server_port}/site/")
            look_from(page, camera())
            wait_until(page, COMPLETE)
            assert psnr(picture(page), ours(small, camera())) >= 38
        finally:
            server.shutdown()
            thread.join()


def test_view_shows_a_ply(page: Page, small: SmallScene) -> None:
    command = program(["view", small.ply, "--no-open", "--json", "--quiet"])
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        try:
            assert process.stdout is not None
            answer = b""
            while not answer.endswith(b"}\n"):
                line = process.stdout.readline()
                assert line
                answer += line
            page.goto(json.loads(answer)["url"])
            look_from(page, camera())
            wait_until(page, COMPLETE)
            source = np.clip(render(cogsplat.read(small.ply), camera()), 0, 1)
            assert psnr(picture(page), source) >= 28
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
        finally:
            process.kill()
