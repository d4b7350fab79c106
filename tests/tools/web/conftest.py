"""A page in a browser for tests of the viewer and the adapters, and what serves the viewer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from faulty_server import FaultyServer
from running import SmallScene

from cogsplat.tools.delivery.slow_server import running
from cogsplat.tools.delivery.viewer_pages import linked_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture
def page(request: pytest.FixtureRequest, browser: Browser) -> Iterator[Page]:
    """A page that must not throw: faults of the way are shown, not raised.

    Its size is ``WIDTH`` times ``HEIGHT`` of the test's module.
    """
    thrown: list[str] = []
    size = {"width": request.module.WIDTH, "height": request.module.HEIGHT}
    page = browser.new_page(viewport=size)
    page.on("pageerror", lambda error: thrown.append(str(error)))
    yield page
    page.close()
    assert thrown == []


@pytest.fixture
def server(small: SmallScene) -> Iterator[FaultyServer]:
    """Serve a page with the viewer and, as ``scene.cogs``, the small scene."""
    files = {**linked_page("scene"), "scene.cogs": small.cogs.read_bytes()}
    with running(FaultyServer(files)) as server:
        yield server
        server.hold_at(float("inf"))
