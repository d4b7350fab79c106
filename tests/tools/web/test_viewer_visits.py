"""Scenes of many rooms in the viewer in a real browser: chosen by the view, within a budget."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, lose_graphics, picture, shows, statistics, wait_until
from faulty_server import FaultyServer

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats
from cogsplat.tools.delivery.slow_server import Link, Reply, running
from cogsplat.tools.delivery.viewer_pages import linked_page
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, rooms_walk, synth_rooms

if TYPE_CHECKING:
    from playwright.sync_api import Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 240, 180
ROOMS, SPLATS = 6, 36_000
COMPLETE = "s.state === 'complete' && s.upToDate"
SAME_DB = 38.0
"""What a picture must have against our own render of the same data."""


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("house") / "scene.cogs"
    config = EncodeConfig(cells=True, chunk_splats=512, order="contribution")
    scene = synth_rooms(ROOMS, SPLATS, sh_degree=1)
    cogsplat.encode(scene, path, cameras=rooms_cameras(ROOMS, views=3), config=config)
    return path


@pytest.fixture(scope="module")
def whole(house: Path) -> Splats:
    return cogsplat.decode(house)


@pytest.fixture(scope="module")
def walk() -> list[Camera]:
    """Where a visitor goes; three of them see different rooms."""
    cameras = rooms_walk(ROOMS)
    return [resized(cameras[len(cameras) * k // 8]) for k in (0, 3, 6)]


def resized(camera: Camera) -> Camera:
    scale = HEIGHT / camera.height
    return replace(
        camera, width=WIDTH, height=HEIGHT, fx=camera.fx * scale, fy=camera.fy * scale,
        cx=WIDTH / 2, cy=HEIGHT / 2,
    )  # fmt: skip


def serve(house: Path, link: Link | None = None, **attributes: object) -> FaultyServer:
    return FaultyServer({**page_of(**attributes), "scene.cogs": house.read_bytes()}, link)


def page_of(scene: str = "scene.cogs", **attributes: object) -> Mapping[str, bytes]:
    """Return the viewer's page with attributes of its element."""
    given = "".join(f'{name.replace("_", "-")}="{value}" ' for name, value in attributes.items())
    element = b"<cogsplat-viewer "
    return {
        name: content.replace(element, element + given.encode())
        for name, content in linked_page("scene", scene).items()
    }


def seen(page: Page, splats: Splats, camera: Camera) -> float:
    """Return the PSNR of what the viewer shows of a pose, against our render of the whole."""
    look_from(page, camera)
    # What the new pose lacks is noticed with the next picture.
    page.wait_for_timeout(300)
    wait_until(page, COMPLETE)
    return psnr(picture(page), np.clip(render(splats, camera), 0, 1))


def test_a_house_within_a_budget_comes_back_when_graphics_are_lost(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    with running(serve(house, splat_budget=len(whole) * 2 // 3)) as server:
        page.goto(server.url)
        for camera in walk[:2]:
            assert seen(page, whole, camera) >= 30.0
        before, frames = picture(page), statistics(page)["frames"]
        sent = server.traffic.size_bytes("scene.cogs")
        lose_graphics(page)
        wait_until(page, f"{COMPLETE} && s.frames > {frames}")
        assert psnr(picture(page), before) >= 50.0
        assert server.traffic.size_bytes("scene.cogs") == sent
        # The visit goes on.
        assert seen(page, whole, walk[2]) >= 30.0


def test_a_house_larger_than_its_budget_can_be_walked_through(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    total = len(whole)
    budget = total * 2 // 3
    held: list[int] = []
    with running(serve(house, splat_budget=budget)) as server:
        page.goto(server.url)
        page.evaluate(
            """() => {
              window.most = 0;
              const viewer = document.querySelector("cogsplat-viewer");
              viewer.addEventListener("cogsplat-change", () => {
                window.most = Math.max(window.most, viewer.statistics.splats);
              });
            }"""
        )
        for camera in [*walk, walk[0]]:
            assert seen(page, whole, camera) >= 30.0
            held.append(int(str(statistics(page)["splats"])))
        most = page.evaluate("window.most")
    assert total > budget >= most >= max(held)
    assert min(held) > budget // 2
    # What had made room for other rooms was fetched again.
    assert server.traffic.size_bytes("scene.cogs") > house.stat().st_size


def test_without_a_budget_all_comes_and_the_strip_of_pictures_can_be_taken(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    with running(serve(house)) as server:
        page.goto(server.url)
        look_from(page, walk[0])
        wait_until(page, COMPLETE)
        assert statistics(page)["splats"] == len(whole)
        ours = np.clip(render(whole, walk[0]), 0, 1)
        assert shows(page, ours, SAME_DB) >= SAME_DB
        page.locator("canvas").click()
        page.keyboard.press("t")
        expect(page.locator("#strip button[aria-pressed=true]")).to_have_count(1, timeout=60_000)
        page.locator("#strip button").nth(1).click()
        wait_until(page, "s.upToDate")
        assert psnr(picture(page), ours) < SAME_DB


class CappedServer(FaultyServer):
    """Sends so many bytes of the scene, whichever are asked for, and then no more until allowed."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        super().__init__(files)
        self._sent = 0
        self._most: float = 0
        self._changed = threading.Condition()

    def allow(self, size_bytes: float) -> None:
        """Send so many bytes in all."""
        with self._changed:
            self._most = size_bytes
            self._changed.notify_all()

    def reply(self, name: str, wanted: str | None) -> Reply:
        reply = super().reply(name, wanted)
        return replace(reply, body=self._capped(reply.body)) if name == self.name else reply

    def _capped(self, body: Iterable[bytes]) -> Iterator[bytes]:
        for part in body:
            for first in range(0, len(part), 512):
                piece = part[first : first + 512]
                with self._changed:
                    self._changed.wait_for(lambda: self._sent < self._most)
                    self._sent += len(piece)
                yield piece


def wait_for_no_more(page: Page) -> None:
    """Wait until what the viewer draws has stayed the same for a while."""
    before = -1
    while before != (splats := int(str(wait_until(page, "s.upToDate")["splats"]))):
        before = splats
        page.wait_for_timeout(1500)


def test_what_is_looked_at_comes_first(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    quality = {}
    size = house.stat().st_size
    for order in ("view", "file"):
        files = {**page_of(order=order), "scene.cogs": house.read_bytes()}
        with running(CappedServer(files)) as server:
            page.goto(server.url)
            # What the first request brings is the same, whoever looks from where.
            server.allow(32_768)
            first = wait_until(page, "s.splats > 0")["splats"]
            look_from(page, walk[1])
            page.wait_for_timeout(300)
            server.allow(0.7 * size)
            # All but what is still on its way in one of the connections.
            wait_until(page, f"s.bytes > {0.7 * size - 4096} && s.splats > {first}")
            wait_for_no_more(page)
            quality[order] = psnr(picture(page), np.clip(render(whole, walk[1]), 0, 1))
            page.goto("about:blank")
            server.allow(float("inf"))
    assert quality["view"] > quality["file"] + 3.0


def test_a_budget_that_is_lowered_is_kept(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    budget = len(whole) // 2
    with running(serve(house, splat_budget=budget)) as server:
        page.goto(server.url)
        seen(page, whole, walk[0])
        lower = budget // 2
        page.evaluate(
            "(n) => document.querySelector('cogsplat-viewer').setAttribute('splat-budget', n)",
            lower,
        )
        wait_until(page, f"s.splats <= {lower} && {COMPLETE}")
        assert int(str(statistics(page)["splats"])) > lower // 4


def test_a_server_without_ranges_gives_the_file_as_it_stands(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    with running(serve(house)) as server:
        server.faults.ranges = False
        page.goto(server.url)
        look_from(page, walk[0])
        wait_until(page, COMPLETE)
        assert shows(page, np.clip(render(whole, walk[0]), 0, 1), SAME_DB) >= SAME_DB


def test_a_folder_can_be_walked_through(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    files = folder_of_file(house.read_bytes())
    objects = {f"scene/{name}": content for name, content in files.items()}
    page_files = page_of("scene/", splat_budget=len(whole) * 2 // 3)
    with running(FaultyServer({**page_files, **objects})) as server:
        page.goto(server.url)
        for camera in walk[:2]:
            assert seen(page, whole, camera) >= 30.0


def test_damage_is_said_and_the_rest_is_shown(
    page: Page, house: Path, whole: Splats, walk: list[Camera]
) -> None:
    with cogsplat.open(house) as file:
        last = int(file.offsets[-1]) + 5
    data = bytearray(house.read_bytes())
    data[last] ^= 1
    with running(serve(house)) as server:
        server.files["scene.cogs"] = bytes(data)
        page.goto(server.url)
        look_from(page, walk[0])
        wait_until(page, "s.state === 'failed' && s.upToDate")
        assert str(statistics(page)["error"])
        assert psnr(picture(page), np.clip(render(whole, walk[0]), 0, 1)) > 25.0
