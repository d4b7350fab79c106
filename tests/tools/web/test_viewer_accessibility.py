"""axe-core finds nothing serious in the viewer, whatever is open in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import wait_until
from faulty_server import FaultyServer
from running import SmallScene

import cogsplat
from cogsplat.formats.cogs.description import Annotation, CameraPath, Description, PathStop
from cogsplat.tools.delivery.viewer_pages import write_standalone_page
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

COMPLETE = "s.state === 'complete' && s.upToDate"
PHONE = {"width": 390, "height": 844}
SMALL_PHONE = {"width": 320, "height": 568}
DESKTOP = {"width": 900, "height": 700}
SERIOUS = ("serious", "critical")


@pytest.fixture(scope="module")
def axe(web_package: Path) -> str:
    """The program of axe-core."""
    return (web_package / "node_modules" / "axe-core" / "axe.min.js").read_text("utf-8")


@pytest.fixture(scope="module")
def described(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The small scene with views, a path and an annotation."""
    views = synth_cameras(48, 64, 48)
    with cogsplat.open(small.cogs) as file:
        first = file.root.first_view
    assert first is not None
    place = -first.rotation.T @ first.translation + 2 * first.rotation[2]
    description = Description(
        title="The terrace",
        text="A terrace and its steps.",
        licence="CC0-1.0",
        views=(first,),
        path=CameraPath((PathStop(0.0, views[8]), PathStop(2.0, views[14]))),
        annotations=(Annotation(np.array(place), "Middle", "Here"),),
    )
    path = tmp_path_factory.mktemp("described") / "scene.cogs"
    cogsplat.describe(small.cogs, description, path)
    return path.read_bytes()


def serious(page: Page, axe: str) -> list[object]:
    """Return the serious faults that axe-core finds in a page as it is."""
    page.context.new_cdp_session(page).send("Runtime.evaluate", {"expression": axe})
    found = page.evaluate("async () => (await axe.run(document)).violations")
    return [
        (fault["id"], [node["target"] for node in fault["nodes"]])
        for fault in found
        if fault["impact"] in SERIOUS
    ]


def check_all(page: Page, axe: str) -> None:
    """Look at the viewer with each of its panels open."""
    caption = page.get_by_role("button", name="The terrace")
    expect(caption).to_be_visible()
    assert serious(page, axe) == []
    caption.click()
    expect(page.get_by_role("region", name="About this scene")).to_be_visible()
    assert serious(page, axe) == []
    page.get_by_role("button", name="Settings").click()
    settings = page.get_by_role("form", name="Settings")
    expect(settings).to_be_visible()
    title, panel = caption.bounding_box(), settings.bounding_box()
    assert title is not None
    assert panel is not None
    # The title stays visible beside or above the panel.
    assert title["x"] + title["width"] <= panel["x"] or title["y"] + title["height"] <= panel["y"]
    assert serious(page, axe) == []
    page.get_by_role("button", name="Measure").click()
    measure = page.get_by_role("group", name="Measure")
    assert serious(page, axe) == []
    measure.get_by_role("button", name="Done").click()
    page.get_by_role("button", name="1: Middle").click()
    expect(page.get_by_text("Here", exact=True)).to_be_visible()
    assert serious(page, axe) == []


@pytest.mark.parametrize(("scheme", "size"), [("light", DESKTOP), ("dark", SMALL_PHONE)])
def test_nothing_serious_on_an_exported_page(
    browser: Browser, described: bytes, axe: str, tmp_path: Path, scheme: str, size: dict[str, int]
) -> None:
    path = tmp_path / "page.html"
    with path.open("wb") as out:
        write_standalone_page("scene", [described], out)
    context = browser.new_context(
        viewport=size, color_scheme="dark" if scheme == "dark" else "light"
    )
    page = context.new_page()
    page.goto(path.as_uri())
    wait_until(page, COMPLETE)
    check_all(page, axe)
    context.close()


def test_nothing_serious_on_an_embedded_element(
    browser: Browser, server: FaultyServer, described: bytes, axe: str
) -> None:
    server.files["scene.cogs"] = described
    server.files["embed.html"] = (
        b'<!doctype html><html lang="en"><meta name="viewport" content="width=device-width">'
        b"<title>A page</title><main><h1>A page</h1>"
        b'<script type="module" src="viewer.js"></script>'
        b'<cogsplat-viewer src="scene.cogs" lazy="click" style="height: 500px"></cogsplat-viewer>'
        b'<p style="height: 2000px">Text</p></main></html>'
    )
    context = browser.new_context(viewport=PHONE, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(f"{server.url}embed.html")
    page.evaluate("() => { window.cogsplatViewer = document.querySelector('cogsplat-viewer'); }")
    button = page.get_by_role("button", name="Show the scene")
    expect(button).to_be_visible()
    assert serious(page, axe) == []
    button.click()
    wait_until(page, COMPLETE)
    check_all(page, axe)
    del server.files["scene.cogs"]
    page.evaluate("() => cogsplatViewer.setAttribute('src', 'missing.cogs')")
    wait_until(page, "s.state === 'failed'")
    assert serious(page, axe) == []
    context.close()
