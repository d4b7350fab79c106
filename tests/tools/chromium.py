"""Headless Chromium for tests, and what they ask of the viewer in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.formats.storage.images import decode_image
from cogsplat.tools.lab.benchmark import chromium as benchmark

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Rendered in software, whatever the machine: WebGL 2 by SwiftShader.
_ARGUMENTS: Final = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
    "--disable-lcd-text",
    # A watchdog ends the graphics process where a busy machine keeps it from answering. After the
    # second time Chromium would give no page WebGL until it is restarted.
    "--disable-gpu-watchdog",
    "--disable-gpu-process-crash-limit",
    "--disable-domain-blocking-for-3d-apis",
)
# Longest time without a new byte, splat or picture: software pictures on a busy machine take
# seconds.
PATIENCE_MS: Final = 60_000
# Looks at a viewer that goes on without meeting a condition, and the time between two.
_MAX_LOOKS: Final = 3000
_BETWEEN_LOOKS_MS: Final = 200
# Pictures that are looked at until one is as it should be.
_ATTEMPTS: Final = 60

# The policy of the page forbids style elements, not sheets that scripts make; a shadow root has
# sheets of its own. Without transitions, because a cover that fades would stay over the canvas.
_SHOW_CANVAS_ALONE: Final = """() => {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(
    "* { visibility: hidden !important; transition: none !important }"
    + " canvas { visibility: visible !important }"
  );
  const roots = [document];
  for (const root of roots) {
    root.adoptedStyleSheets.push(sheet);
    for (const element of root.querySelectorAll("*")) {
      if (element.shadowRoot) roots.push(element.shadowRoot);
    }
  }
  window.restorePage = () => {
    for (const root of roots) {
      root.adoptedStyleSheets = root.adoptedStyleSheets.filter((other) => other !== sheet);
    }
  };
}"""

Statistics = Mapping[str, object]


def executable() -> str:
    """Return Chromium's path; without it, or without Playwright to drive it, skip the test."""
    pytest.importorskip("playwright", reason="needs playwright")
    found = benchmark.executable()
    if found is None:
        pytest.skip("needs Chromium: `apt-get install chromium`, or set COGSPLAT_CHROMIUM")
    return found


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser, and end it with the block."""
    executable()
    with benchmark.chromium(_ARGUMENTS) as browser:
        yield browser


_TWO_FRAMES: Final = """() => new Promise((done) => {
    requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50)));
})"""


def statistics(page: Page) -> Statistics:
    """Return what `ViewerHandle.statistics` of tools/web/src/viewer/viewer_handle.ts says."""
    found: Statistics = page.evaluate("() => window.cogsplatViewer.statistics")
    return found


def wait_until(page: Page, condition: str) -> Statistics:
    """Wait until a condition on the statistics `s` holds, in JavaScript, and return them.

    However slow the machine, the viewer has time as long as it makes progress.

    Raises
    ------
    AssertionError
        There was no new byte, splat or picture for `PATIENCE_MS`; the message has the statistics.
    """
    from playwright.sync_api import TimeoutError as PlaywrightTimeoutError

    last = ""
    for _ in range(_MAX_LOOKS):
        try:
            found = page.wait_for_function(
                f"""(last) => {{
                  const s = window.cogsplatViewer?.statistics;
                  if (s === undefined) return false;
                  if ({condition}) return "met";
                  const now = [s.state, s.bytes, s.splats, s.frames].join(" ");
                  return now !== last && now;
                }}""",
                arg=last,
                timeout=PATIENCE_MS,
            )
        except PlaywrightTimeoutError:
            break
        last = str(found.json_value())
        if last == "met":
            return statistics(page)
        page.wait_for_timeout(_BETWEEN_LOOKS_MS)
    told = page.evaluate("() => window.cogsplatViewer?.statistics ?? 'no viewer'")
    raise AssertionError(f"{condition}: no progress for {PATIENCE_MS} ms: {told}")


def look_from(page: Page, camera: Camera) -> None:
    """Set the viewer's pose to a camera whose principal point is the middle of its picture.

    Holes between splats stay holes, as in our own renders.
    """
    pose = {
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "rotation": camera.rotation.ravel().tolist(),
        "translation": camera.translation.tolist(),
    }
    page.evaluate(
        """(pose) => {
          window.cogsplatViewer.fillHoles = false;
          window.cogsplatViewer.view = pose;
        }""",
        pose,
    )


def lose_graphics(page: Page) -> None:
    """Take the WebGL context from the viewer's canvas for 0.3 s."""
    page.evaluate(
        """() => {
          const roots = [document, ...[...document.querySelectorAll("*")].flatMap(
            (element) => element.shadowRoot ?? [])];
          const canvas = roots.map((root) => root.querySelector("canvas")).find(Boolean);
          window.lost = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
          window.lost.loseContext();
        }"""
    )
    page.wait_for_timeout(300)
    page.evaluate("() => window.lost.restoreContext()")


def picture(page: Page) -> NDArray[np.float32]:
    """Return what the canvas shows, without what the page writes over it.

    Returns
    -------
    (H, W, 3) float32
        0 to 1.
    """
    page.evaluate(_SHOW_CANVAS_ALONE)
    # A screenshot may show the frame before the one that the page has drawn last.
    page.evaluate(_TWO_FRAMES)
    data = page.locator("canvas").first.screenshot(timeout=PATIENCE_MS)
    page.evaluate("() => window.restorePage()")
    pixels: NDArray[np.float32] = decode_image(data, "PNG")[..., :3].astype(np.float32) / 255
    return pixels


def shows(page: Page, ours: NDArray[np.float32], least_db: float) -> float:
    """Wait until the canvas shows a picture; return how much it is like ours at the end, dB."""
    found = 0.0
    for _ in range(_ATTEMPTS):
        wait_until(page, "s.upToDate || s.state === 'failed'")
        found = psnr(picture(page), ours)
        if found >= least_db:
            break
        # Refinements and tails that came with the last bytes are still being decoded.
        page.wait_for_timeout(200)
    return found
