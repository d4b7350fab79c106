"""The npm package in tools/web builds, passes its tests, and its viewer is the committed one."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from running import ROOT, installed
from web_package import SERVED, WEB, npm

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route


@pytest.mark.slow
def test_package_passes_its_checks_and_tests(web_package: Path) -> None:
    assert "# fail 0" in npm(("test",), web_package)


@pytest.mark.slow
def test_decoder_of_the_package_passes_the_conformance_suite(web_package: Path) -> None:
    decoder = f"{installed('node')} {web_package / 'scripts' / 'conformance_decoder.mjs'}"
    command = [sys.executable, "-m", "cogsplat.tools.main", "lab", "conformance", "run"]
    done = subprocess.run(
        [*command, "--decoder", decoder],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


@pytest.mark.slow
def test_committed_files_equal_a_fresh_build(web_package: Path) -> None:
    stale = [
        name
        for name in SERVED
        if (WEB / "dist" / name).read_bytes() != (web_package / "dist" / name).read_bytes()
    ]
    assert not stale, f"run `npm run build` in tools/web and commit {', '.join(stale)}"


def test_no_other_built_file_is_committed() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "dist"], cwd=WEB, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("this is no checkout of git")
    assert listed.stdout.split() == [f"dist/{name}" for name in SERVED]


@pytest.mark.slow
def test_npm_package_holds_its_entry_points_and_their_types(web_package: Path) -> None:
    arguments = ("pack", "--dry-run", "--json", "--ignore-scripts")
    packed = {file["path"] for file in json.loads(npm(arguments, web_package))[0]["files"]}
    exports = json.loads((web_package / "package.json").read_text(encoding="utf-8"))["exports"]
    for entry in exports.values():
        for path in entry.values() if isinstance(entry, dict) else (entry,):
            assert path.removeprefix("./") in packed
    assert packed >= {"LICENSE", "README.md"}
    assert (WEB / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_lock_file_names_no_host_but_the_public_registry() -> None:
    lock = (WEB / "package-lock.json").read_text(encoding="utf-8")
    hosts = [
        line
        for line in lock.splitlines()
        if '"resolved"' in line and "https://registry.npmjs.org/" not in line
    ]
    assert not hosts


@pytest.mark.slow
def test_bundle_is_small_enough_for_a_page(web_package: Path) -> None:
    # The first holds the program of the workers too.
    for name, limit in (("cogsplat.js", 54_000), ("worker.js", 22_000)):
        size = len(gzip.compress((web_package / "dist" / name).read_bytes(), 9))
        assert size <= limit, f"{name}: {size} bytes gzipped"


@pytest.mark.slow
def test_a_policy_that_forbids_webassembly_is_named(web_package: Path, browser: Browser) -> None:
    policy = {"Content-Security-Policy": "script-src 'self'"}
    library = (web_package / "dist" / "cogsplat.js").read_text(encoding="utf-8")

    def answer(route: Route) -> None:
        if route.request.url.endswith("/cogsplat.js"):
            route.fulfill(body=library, content_type="text/javascript", headers=policy)
        else:
            route.fulfill(body="<!doctype html>", content_type="text/html", headers=policy)

    page = browser.new_page()
    page.route("**/*", answer)
    page.goto("http://page.invalid/")
    message = page.evaluate(
        """async () => {
          const { loadKernels } = await import("/cogsplat.js");
          return loadKernels().then(() => "compiled", (error) => error.message);
        }"""
    )
    page.close()
    assert "'wasm-unsafe-eval'" in message
    assert "script-src" in message
