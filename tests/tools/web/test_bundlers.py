"""Fresh apps with the packed npm package, made by bundlers without configuration."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from chromium import PATIENCE_MS
from running import ROOT, installed
from web_package import npm

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

APPS = ROOT / "tests" / "tools" / "web" / "bundlers"
SCENE = ROOT / "tests" / "vectors" / "valid" / "compensation.cogs"
SPLATS = 15
# The element loads the scene a second time.
_SHOWN = """() => {
  const { state } = document.querySelector("cogsplat-viewer").statistics ?? {};
  return document.querySelector("output").textContent && ["complete", "failed"].includes(state);
}"""


@pytest.fixture(scope="module")
def apps(tmp_path_factory: pytest.TempPathFactory, web_package: Path) -> Path:
    """Return a folder with the bundlers and the packed package."""
    folder = tmp_path_factory.mktemp("bundlers")
    shutil.copytree(APPS, folder, ignore=shutil.ignore_patterns("node_modules"), dirs_exist_ok=True)
    npm(("pack", "--ignore-scripts", "--pack-destination", str(folder)), web_package)
    (tarball,) = folder.glob("cogsplat-*.tgz")
    quiet = ("--prefer-offline", "--ignore-scripts", "--no-fund", "--no-audit", "--no-package-lock")
    npm(("install", *quiet, f"./{tarball.name}"), folder)
    return folder


@contextmanager
def served(apps: Path, bundler: str, mode: str) -> Iterator[str]:
    """Make and serve an app; yield its address."""
    command = [installed("node"), "serve.mjs", bundler, mode, str(SCENE)]
    with subprocess.Popen(
        command,
        cwd=apps,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            said = []
            for line in process.stdout:
                if line.startswith("address: "):
                    yield line.removeprefix("address: ").strip()
                    return
                said.append(line)
            raise AssertionError(f"{bundler} {mode}: {''.join(said)[-4000:]}")
        finally:
            process.kill()


def open_app(page: Page, address: str) -> list[str]:
    """Open an app and wait for both scenes; return what the console complained of."""
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console",
        lambda message: (
            complaints.append(message.text)
            if message.type in ("error", "warning") and "GL Driver Message" not in message.text
            else None
        ),
    )
    page.goto(address)
    page.wait_for_function(_SHOWN, timeout=2 * PATIENCE_MS)
    assert page.inner_text("output") == f"{SPLATS} splats"
    viewer = page.evaluate("() => document.querySelector('cogsplat-viewer').statistics")
    assert (viewer["state"], viewer["splats"]) == ("complete", SPLATS), viewer
    return complaints


@pytest.mark.parametrize(
    ("bundler", "mode"),
    [
        ("vite8", "dev"),
        ("vite8", "build"),
        ("vite6", "dev"),
        ("vite6", "build"),
        ("webpack", "dev"),
        ("webpack", "build"),
        ("esbuild", "dev"),
        ("esbuild", "build"),
        ("none", "build"),
    ],
)
def test_an_app_decodes_in_workers_without_configuration(
    browser: Browser, apps: Path, bundler: str, mode: str
) -> None:
    page = browser.new_page()
    with served(apps, bundler, mode) as address:
        assert open_app(page, address) == []
        assert page.evaluate("() => decodedByWorkers") > 0
    page.close()


def test_a_policy_of_files_alone_gets_the_worker_that_the_bundler_found(
    browser: Browser, apps: Path
) -> None:
    page = browser.new_page()
    with served(apps, "vite8", "strict") as address:
        complaints = open_app(page, address)
        assert page.evaluate("() => decodedByWorkers") > 0
    page.close()
    # The browser itself reports each worker that the policy refused.
    assert all("Creating a worker from 'blob:" in complaint for complaint in complaints)


def test_an_app_without_any_worker_decodes_and_says_which_address_failed(
    browser: Browser, apps: Path
) -> None:
    page = browser.new_page()
    with served(apps, "esbuild", "strict") as address:
        complaints = open_app(page, address)
        assert page.evaluate("() => decodedByWorkers") == 0
    page.close()
    own = [text for text in complaints if text.startswith("cogsplat decodes without workers")]
    assert len(own) == 2, complaints
    for text in own:
        assert f"worker.js beside {address}main.js" in text
        assert "undefined" not in text
