"""A notebook shows an open file: as a widget that fetches what it draws from the kernel."""

from __future__ import annotations

import base64
import sys
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from running import SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.formats.storage.images import decode_image
from cogsplat.tools.delivery.notebook import bundle, respond
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CELL = """
import cogsplat
cogsplat.open({path!r})
"""

# A page around the module that anywidget loads, with a model whose messages go to Python and back.
_PAGE = """
const program = new Blob([PROGRAM], { type: "text/javascript" });
const { default: widget } = await import(URL.createObjectURL(program));
const listeners = new Set();
const model = {
  on: (_, act) => listeners.add(act),
  off: (_, act) => listeners.delete(act),
  async send(content) {
    const [reply, parts] = await window.kernel(content);
    const bytes = parts.map((part) => Uint8Array.from(atob(part), (c) => c.charCodeAt(0)));
    for (const act of listeners) act(reply, bytes.map((part) => new DataView(part.buffer)));
  },
};
window.leave = widget.render({ model, el: document.body });
window.listeners = listeners;
"""


def test_it_answers_with_bytes_and_names(small: SmallScene) -> None:
    data = small.cogs.read_bytes()
    with cogsplat.open(small.cogs) as file:
        opened, none = respond(file, {"type": "open"})
        assert (opened["type"], opened["length"], none) == ("scene", len(data), [])
        assert opened["name"] == small.cogs.name
        programs = opened["programs"]
        assert isinstance(programs, list)
        assert all(len(program) > 1000 for program in programs)
        read = {"type": "read", "id": 7, "offset": 100, "length": 50}
        assert respond(file, read) == ({"type": "bytes", "id": 7}, [data[100:150]])
        behind = respond(file, {**read, "offset": len(data) - 10})
        assert behind == ({"type": "bytes", "id": 7}, [data[-10:]])
        for wrong in (
            {**read, "offset": -1},
            {**read, "length": 1 << 40},
            {**read, "offset": 10**30},
        ):
            assert respond(file, wrong)[0]["type"] == "failed"
        for other in (None, "read", {"type": "read"}, {**read, "offset": "0"}):
            assert respond(file, other)[0] == {
                "type": "failed",
                "id": -1,
                "message": "unknown message",
            }
    assert respond(file, read)[0]["type"] == "failed"


def test_bundle_is_a_widget_and_words(small: SmallScene) -> None:
    with cogsplat.open(small.cogs) as file:
        data, _ = bundle(file)
        assert "application/vnd.jupyter.widget-view+json" in data
        assert f"{file.root.splats:,} splats" in data["text/plain"]


def test_bundle_without_the_extra_says_what_to_install(
    small: SmallScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with cogsplat.open(small.cogs) as file:
        data = bundle(file)
    assert data.keys() == {"text/plain"}
    assert "cogsplat[notebook]" in data["text/plain"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_notebook_shows_what_open_returns(small: SmallScene, tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="needs nbclient")
    nbformat = pytest.importorskip("nbformat", reason="needs nbformat")
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(CELL.format(path=str(small.cogs)))]
    )
    nbclient.NotebookClient(
        notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    (output,) = notebook.cells[0].outputs
    assert "application/vnd.jupyter.widget-view+json" in output.data
    assert "splats" in output.data["text/plain"]


@pytest.mark.slow
def test_its_program_draws_every_size_in_a_browser(browser: Browser, small: SmallScene) -> None:
    program = files("cogsplat.tools").joinpath("web", "dist", "viewer.js").read_text("utf-8")
    # Training was in pictures of 64x48.
    cameras = [synth_cameras(48, 320, 240)[8], synth_cameras(48, 32, 24)[8]]
    with cogsplat.open(small.cogs) as file:

        def kernel(message: object) -> tuple[dict[str, object], list[str]]:
            content, buffers = respond(file, message)
            return content, [base64.b64encode(part).decode() for part in buffers]

        page = browser.new_page(viewport={"width": 336, "height": 400})
        page.expose_function("kernel", kernel)
        page.goto("about:blank")
        page.evaluate(
            f"async (PROGRAM) => {{ {_PAGE} }}",
            program,
        )
        page.wait_for_function("() => document.querySelector('cogsplat-viewer')", timeout=60_000)
        found = [picture_of_the_widget(page, camera) for camera in cameras]
        page.evaluate("() => window.leave()")
        assert page.evaluate("() => [window.listeners.size, document.body.children.length]") == [
            0,
            0,
        ]
        page.close()
    splats = cogsplat.decode(small.cogs)
    usual = splats.without_capture()
    for pixels, camera in zip(found, cameras, strict=True):
        assert psnr(pixels, np.clip(render(splats, camera), 0, 1)) >= 38
        assert psnr(pixels, np.clip(render(usual, camera), 0, 1)) < 38


def picture_of_the_widget(page: Page, camera: Camera) -> NDArray[np.float32]:
    """Return what the viewer shows from a camera once the scene is complete, 0 to 1."""
    page.evaluate(
        """([pose, width]) => {
          const viewer = document.querySelector("cogsplat-viewer");
          const style = { width: `${width}px`, height: `${pose.height}px`, minHeight: "0" };
          Object.assign(viewer.style, style);
          viewer.view = pose;
        }""",
        [
            {
                "height": camera.height,
                "fx": camera.fx,
                "fy": camera.fy,
                "rotation": camera.rotation.ravel().tolist(),
                "translation": camera.translation.tolist(),
            },
            camera.width,
        ],
    )
    page.wait_for_function(
        """([wide, high]) => {
          const viewer = document.querySelector("cogsplat-viewer");
          const { state, upToDate } = viewer.statistics;
          const { width, height } = viewer.shadowRoot.querySelector("canvas");
          return state === "complete" && upToDate && width === wide && height === high;
        }""",
        arg=[camera.width, camera.height],
        timeout=60_000,
    )
    address = page.evaluate(
        """() => document.querySelector("cogsplat-viewer").shadowRoot
          .querySelector("canvas").toDataURL()"""
    )
    pixels = decode_image(base64.b64decode(address.partition(",")[2]), "PNG")[..., :3]
    shown: NDArray[np.float32] = pixels.astype(np.float32) / 255
    return shown
