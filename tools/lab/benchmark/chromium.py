"""Headless Chromium for benchmarks and tests."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Timeout of page calls: scenes are loaded over links of less than 1 Mbit/s.
_TIMEOUT_MS: Final = 300_000


def executable() -> str | None:
    """Return the path of Chromium: COGSPLAT_CHROMIUM, else the installed one, else None."""
    given = os.environ.get("COGSPLAT_CHROMIUM")
    return given or shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def chromium(arguments: Sequence[str] = ()) -> Iterator[Browser]:
    """Start a browser for the duration of the block.

    Parameters
    ----------
    arguments : sequence of str
        Command-line arguments in addition to Playwright's.

    Yields
    ------
    Browser
        Browser of `executable`, else the one that Playwright provides.
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
def opened_page(url: str, ready: str, arguments: Sequence[str] = ()) -> Iterator[Page]:
    """Open a page in a new browser and wait until it is ready.

    Parameters
    ----------
    url : str
        Address of the page.
    ready : str
        JavaScript expression that is true when the page is ready.
    arguments : sequence of str
        Command-line arguments of the browser in addition to Playwright's.

    Yields
    ------
    Page
        Page whose calls time out after five minutes.
    """
    with chromium(arguments) as browser:
        page = browser.new_page()
        page.set_default_timeout(_TIMEOUT_MS)
        page.goto(url)
        page.wait_for_function(f"() => {ready}")
        yield page
