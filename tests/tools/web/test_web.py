"""The npm package in tools/web builds, passes its tests, and its bundle is the committed one."""

from __future__ import annotations

import gzip
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from running import installed

REPOSITORY = Path(__file__).resolve().parents[3]
WEB = REPOSITORY / "tools" / "web"
OLDEST_NODE = 20


def run(command: list[str], folder: Path) -> str:
    """Run a command and return its output; a failure shows all of it."""
    done = subprocess.run(
        command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    # Tests that failed first: the end of a long output is all that is shown of it.
    failed = re.findall(r"^ *not ok .*(?:\n(?! *(?:not )?ok ).*){0,40}", done.stdout, re.MULTILINE)
    assert done.returncode == 0, "\n".join(
        [" ".join(command), *failed[:10], done.stdout[-4000:], done.stderr[-4000:]]
    )
    return done.stdout


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Copy the package into a clean tree, with what its tests read, and install its tools."""
    node = run([installed("node"), "--version"], tmp_path)
    assert int(node.removeprefix("v").split(".")[0]) >= OLDEST_NODE, f"node is {node}"
    folder = tmp_path / "tools" / "web"
    shutil.copytree(WEB, folder, ignore=shutil.ignore_patterns("node_modules", "build"))
    vectors = tmp_path / "tests" / "vectors"
    shutil.copytree(REPOSITORY / "tests" / "vectors", vectors)
    decisions = "tests/tools/lab/scheduling/decisions.json"
    (tmp_path / decisions).parent.mkdir(parents=True)
    shutil.copy(REPOSITORY / decisions, tmp_path / decisions)
    shutil.copy(REPOSITORY / "SPEC.md", tmp_path)
    run([installed("npm"), "ci", "--prefer-offline", "--ignore-scripts", "--no-fund"], folder)
    return folder


@pytest.mark.slow
def test_package_builds_passes_its_tests_and_is_the_committed_bundle(package: Path) -> None:
    output = run([installed("npm"), "test"], package)
    assert "# fail 0" in output
    committed = bundle(package)
    assert committed, "tools/web/dist is empty"
    shutil.rmtree(package / "dist")
    run([installed("npm"), "run", "build"], package)
    built = bundle(package)
    stale = sorted(
        path for path in committed.keys() | built if committed.get(path) != built.get(path)
    )
    assert not stale, f"run `npm run build` in tools/web and commit {', '.join(stale)}"
    for backend in ("wasm", "javascript"):
        script = package / "scripts" / "conformance_decoder.mjs"
        decoder = f"{installed('node')} {script} {backend}"
        cli = [sys.executable, "-m", "cogsplat.tools.main"]
        run([*cli, "conformance", "run", "--decoder", decoder], REPOSITORY)


def bundle(package: Path) -> dict[str, bytes]:
    """Return every file of the package's dist, by its path."""
    dist = package / "dist"
    return {
        path.relative_to(dist).as_posix(): path.read_bytes()
        for path in dist.rglob("*")
        if path.is_file()
    }


def test_lock_file_names_no_host_but_the_public_registry() -> None:
    lock = (WEB / "package-lock.json").read_text(encoding="utf-8")
    hosts = [
        line
        for line in lock.splitlines()
        if '"resolved"' in line and "https://registry.npmjs.org/" not in line
    ]
    assert not hosts


def test_bundle_is_small_enough_for_a_page() -> None:
    for name, limit in (("cogsplat.js", 45_000), ("worker.js", 45_000)):
        size = len(gzip.compress((WEB / "dist" / name).read_bytes(), 9))
        assert size <= limit, f"{name}: {size} bytes gzipped"
