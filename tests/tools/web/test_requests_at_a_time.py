"""Requests that a browser sends at a time: more where they share a connection."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from certificates import made_certificate
from running import SmallScene

from cogsplat.tools.delivery.file_app import FileApp
from cogsplat.tools.delivery.file_server import FileServer, running
from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.slow

_OPEN = """async (url) => {
  const { StreamedScene } = await import("/cogsplat.js");
  const { reader } = await StreamedScene.open(url);
  // The browser tells of a request some time after its end.
  while (performance.getEntriesByName(url).length === 0) {
    await new Promise((wake) => setTimeout(wake, 20));
  }
  return reader.mostRequests;
}"""


@pytest.mark.parametrize(("encrypted", "most"), [(False, 6), (True, 24)])
def test_requests_share_a_connection_over_http2(
    browser: Browser,
    web_package: Path,
    small: SmallScene,
    tmp_path: Path,
    *,
    encrypted: bool,
    most: int,
) -> None:
    module = (web_package / "dist" / "cogsplat.js").read_bytes()
    pages = {"index.html": b"<!doctype html>", "cogsplat.js": module}
    app = FileApp(small.cogs, ShapedLink(LinkQuality()), pages)
    certificate = made_certificate(tmp_path) if encrypted else None
    context = browser.new_context(ignore_https_errors=True)
    page = context.new_page()
    with running(FileServer(app, certificate=certificate)) as server:
        page.goto(server.url)
        assert page.evaluate(_OPEN, server.url + small.cogs.name) == most
        # Of another origin, for which the server allows the timing to be seen.
        with running(FileServer(app, certificate=certificate)) as other:
            assert page.evaluate(_OPEN, other.url + small.cogs.name) == most
    context.close()
