"""Headless Chromium, as benchmarks and tests start it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Scenes come over links of less than a Mbit/s.
_PATIENCE_MS: Final = 300_000


def executable() -> str | None:
    """Return Chromium's path: what COGSPLAT_CHROMIUM says, or what is installed; None without."""
    given = os.environ.get("COGSPLAT_CHROMIUM")
    return given or shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def chromium(arguments: Sequence[str] = ()) -> Iterator[Browser]:
    """Start a browser, and end it with the block.

    Parameters
    ----------
    arguments : sequence of str
        Of its command line, beyond those that Playwright gives.

    Yields
    ------
    Browser
        That of `executable`, or Playwright's own where there is none.
    """
    from playwright.sync_api import sync_playwright

    root = hasattr(os, "geteuid") and os.geteuid() == 0
    with sync_playwright() as playwright:
        # Chromium's own sandbox refuses to run as root.
        browser = playwright.chromium.launch(
            executable_path=executable(), args=list(arguments), chromium_sandbox=not root
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened_page(url: str, ready: str) -> Iterator[Page]:
    """Open a page in a browser of its own.

    Parameters
    ----------
    url : str
    ready : str
        JavaScript expression that holds once the page can be used.

    Yields
    ------
    Page
        Its calls wait for up to five minutes.
    """
    with chromium() as browser:
        page = browser.new_page()
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(url)
        page.wait_for_function(f"() => {ready}")
        yield page
