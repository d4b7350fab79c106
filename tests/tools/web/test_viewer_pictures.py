"""The viewer's pictures in a real browser equal our own renders of what has arrived."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from chromium import PATIENCE_MS, look_from, picture, shows, wait_until
from faulty_server import FaultyServer
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats, concatenate
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.tools.delivery.slow_server import running
from cogsplat.tools.delivery.viewer_pages import linked_page
from cogsplat.tools.lab.conformance import tolerance
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

VECTORS = Path(__file__).resolve().parents[2] / "vectors"
FOX = Path(__file__).resolve().parents[4] / "shared" / "data" / "fox"

SAME_DB = 38.0
"""What a picture must have against our own render of the same data."""
RECOGNISABLE_DB = 24.0
"""What a picture must have against our own render of the whole, to be recognised."""


@dataclass(frozen=True)
class Shown:
    """A scene's file, and where it is looked at from."""

    path: Path
    camera: Camera
    recognisable_share: float
    """Of the bytes, from which on pictures are recognised."""

    def drawn(self, size_bytes: int | None = None) -> NDArray[np.float32]:
        """Render what is in the first bytes of the file, 0 to 1."""
        part = cogsplat.decode(self.path, size_bytes=size_bytes, compensate=True)
        return np.clip(render(part, self.camera), 0, 1)


@pytest.fixture(scope="module")
def terrace(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """The synthetic scene, in about 300 kB."""
    path = tmp_path_factory.mktemp("terrace") / "scene.cogs"
    cogsplat.encode(synth(40_000), path, cameras=synth_cameras(12, 160, 120))
    return Shown(path, synth_cameras(48, 480, 360)[8], 0.32)


@pytest.fixture(scope="module")
def fox(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """A scene that was trained on photos, in the views that it was not trained on."""
    if not FOX.is_dir():
        pytest.skip("the real scenes are not here")
    path = tmp_path_factory.mktemp("fox") / "scene.cogs"
    cameras = read_cameras(FOX / "cameras.json")
    config = EncodeConfig(compensate=True)
    known = [camera for i, camera in enumerate(cameras) if i % 8][::4]
    cogsplat.encode(FOX / "scene.ply", path, cameras=known, preset="fast", config=config)
    return Shown(path, cameras[8], 0.12)


@pytest.mark.parametrize("scene", ["terrace", pytest.param("fox", marks=pytest.mark.shared)])
def test_pictures_equal_our_renders_as_bytes_arrive(
    browser: Browser, request: pytest.FixtureRequest, scene: str
) -> None:
    shown: Shown = request.getfixturevalue(scene)
    whole, data = shown.drawn(), shown.path.read_bytes()
    total = len(data)
    recognisable = int(shown.recognisable_share * total)
    with running(FaultyServer({**linked_page(scene), "scene.cogs": data})) as server:
        size = {"width": shown.camera.width, "height": shown.camera.height}
        page = browser.new_page(viewport=size)
        server.hold_at(0)
        page.goto(server.url)
        look_from(page, shown.camera)
        for size_bytes in sorted({16 << 10, recognisable, 64 << 10, 256 << 10, total}):
            server.hold_at(size_bytes)
            found = shows(page, shown.drawn(size_bytes), SAME_DB)
            assert found >= SAME_DB, f"{size_bytes} of {total} bytes"
            if size_bytes == recognisable:
                assert psnr(picture(page), whole) >= RECOGNISABLE_DB
        assert wait_until(page, "s.state === 'complete'")["splats"] == len(
            cogsplat.decode(shown.path)
        )
        page.close()


def test_small_near_and_far_pictures_are_as_thick_as_in_training(
    browser: Browser, terrace: Shown
) -> None:
    # As the file says, training was in pictures of 160x120: these are near, nearer, and far.
    files = {**linked_page("terrace"), "scene.cogs": terrace.path.read_bytes()}
    whole = cogsplat.decode(terrace.path)
    usual = whole.without_capture()
    with running(FaultyServer(files)) as server:
        for width, height, back in ((240, 180, 1.0), (640, 480, 1.0), (240, 180, 3.0)):
            camera = synth_cameras(48, width, height)[8]
            # Back along the direction of view, with the same target in the middle.
            moved = camera.translation + np.array([0.0, 0.0, (back - 1.0) * 6.0])
            camera = replace(camera, translation=moved)
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(server.url)
            look_from(page, camera)
            wait_until(page, "s.state === 'complete' && s.upToDate")
            found = picture(page)
            assert psnr(found, np.clip(render(whole, camera), 0, 1)) >= SAME_DB
            if width == 640:
                assert psnr(found, np.clip(render(usual, camera), 0, 1)) < SAME_DB
            page.close()


def test_pictures_of_the_vectors(browser: Browser) -> None:
    manifest = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
    # The element has square pixels, and its principal point is in the middle.
    drawings = [d for d in manifest["drawings"] if d["camera"]["fx"] == d["camera"]["fy"]]
    assert len(drawings) == len(manifest["drawings"]) - 1
    page = browser.new_page(viewport={"width": 300, "height": 300})
    for scene in sorted({drawing["scene"] for drawing in drawings}):
        data = (VECTORS / "drawings" / f"{scene}.cogs").read_bytes()
        with running(FaultyServer({**linked_page(scene), "scene.cogs": data})) as server:
            page.goto(server.url)
            wait_until(page, "s.state === 'complete' && s.upToDate")
            for drawing in drawings:
                if drawing["scene"] == scene:
                    assert fault_of(page, drawing) == "", drawing["name"]
    page.close()


def fault_of(page: Page, drawing: Mapping[str, Any]) -> str:
    """Draw a picture of the vectors in the viewer; return its fault, or ""."""
    told = drawing["camera"]
    pose = {key: np.array(told[key]) for key in ("rotation", "translation")}
    camera = Camera(**{**told, **pose, "rotation": pose["rotation"].reshape(3, 3)})
    size = [camera.width, camera.height]
    page.evaluate(
        """([width, height]) => {
          const style = { width: `${width}px`, height: `${height}px`, minHeight: "0" };
          Object.assign(window.cogsplatViewer.style, style);
        }""",
        size,
    )
    look_from(page, camera)
    page.wait_for_function(
        """([width, height]) => {
          const viewer = window.cogsplatViewer;
          const canvas = viewer.shadowRoot.querySelector("canvas");
          return viewer.statistics.upToDate && canvas.width === width && canvas.height === height;
        }""",
        arg=size,
        timeout=PATIENCE_MS,
    )
    expected = np.fromfile(VECTORS / "drawings" / f"{drawing['name']}.f32", "<f4")
    return tolerance.picture_fault(
        picture(page), expected.reshape(camera.height, camera.width, 3), is_viewer=True
    )


FAR = np.array([10_000.0, 0.0, -10_000.0])
"""A place 14 km from the origin, in a scene that reaches as far to its other side."""
FOCAL = 500.0


def markers(place: NDArray[np.float64]) -> Splats:
    """Make 48 round splats of 4 pixels, at 2 to 8 units in front of a camera at a place."""
    column, row = np.meshgrid(np.arange(8) - 3.5, np.arange(6) - 2.5)
    depth = 5 + 3 * np.sin(7.3 * np.arange(48))
    ahead = np.stack([75 / FOCAL * column.ravel(), 75 / FOCAL * row.ravel(), np.ones(48)], axis=1)
    return Splats.from_arrays(
        means=(place + depth[:, None] * ahead).astype(np.float32),
        scales=np.repeat(np.log(4 * depth / FOCAL)[:, None], 3, axis=1).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (48, 1)),
        opacities=np.full(48, 5, np.float32),
        sh0=np.full((48, 3), 1.5, np.float32),
    )


def test_ten_kilometres_from_the_origin_splats_are_within_a_tenth_of_a_pixel(
    browser: Browser, tmp_path: Path
) -> None:
    path = tmp_path / "scene.cogs"
    config = EncodeConfig(profile="near-lossless", prune=None)
    cogsplat.encode(concatenate([markers(FAR), markers(-FAR)]), path, config=config)
    position, turn = FAR + np.array([0.137, -0.211, 0.052]), 0.05
    across, ahead = np.cos(turn), np.sin(turn)
    rotation = np.array([[across, 0, ahead], [0, 1, 0], [-ahead, 0, across]])
    camera = Camera(
        width=640,
        height=480,
        fx=FOCAL,
        fy=FOCAL,
        cx=320,
        cy=240,
        rotation=rotation,
        translation=-rotation @ position,
    )
    means = cogsplat.decode(path).means.astype(np.float64)
    local = (means[np.linalg.norm(means - FAR, axis=1) < 100] - position) @ rotation.T
    expected = FOCAL * local[:, :2] / local[:, 2:] + [320, 240]
    with running(FaultyServer({**linked_page("far"), "scene.cogs": path.read_bytes()})) as server:
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(server.url)
        look_from(page, camera)
        wait_until(page, "s.state === 'complete' && s.upToDate")
        shown = picture(page).mean(axis=2)
        page.close()
    inside = np.all((expected > 20) & (expected < [620, 460]), axis=1)
    assert np.count_nonzero(inside) >= 40
    for place in expected[inside]:
        left, top = np.round(place).astype(int) - 18
        light = shown[top : top + 36, left : left + 36]
        rows, columns = np.mgrid[top : top + 36, left : left + 36] + 0.5
        found = [np.average(columns, weights=light), np.average(rows, weights=light)]
        assert np.hypot(*(found - place)) < 0.1
