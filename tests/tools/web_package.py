"""The npm package of tools/web, built from the sources in a clean copy."""

import re
import shutil
import subprocess
import time
from pathlib import Path

from running import ROOT, installed

WEB = ROOT / "tools" / "web"
SERVED = (
    "viewer.css",
    "viewer.html",
    "viewer.js",
    "viewer_extras.js",
    "viewer_worker.js",
    "worker.js",
)
"""Built files that the wheel serves; of all built files they alone are committed."""

OLDEST_NODE = 20
# Installation from the registry and the build take some 15 s; a busy machine is slower.
_PATIENCE_SECONDS = 600
_INSTALL = ("ci", "--prefer-offline", "--ignore-scripts", "--no-fund")


def npm(arguments: tuple[str, ...], folder: Path) -> str:
    """Run npm and return its output; a failure shows the failed tests and the end of it."""
    done = subprocess.run(
        [installed("npm"), *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    failed = re.findall(r"^ *not ok .*(?:\n(?! *(?:not )?ok ).*){0,40}", done.stdout, re.MULTILINE)
    assert done.returncode == 0, "\n".join(
        [f"npm {' '.join(arguments)}", *failed[:10], done.stdout[-4000:], done.stderr[-4000:]]
    )
    return done.stdout


def build(folder: Path) -> Path:
    """Copy the package and what its tests read into a folder, and build it there.

    Returns
    -------
    Path
        Folder of the package.
    """
    node = subprocess.run([installed("node"), "--version"], capture_output=True, text=True)
    assert int(node.stdout.removeprefix("v").split(".")[0]) >= OLDEST_NODE, node.stdout
    package = folder / "tools" / "web"
    leave = shutil.ignore_patterns("node_modules", "build", "dist", "wasm_bytes.ts")
    shutil.copytree(WEB, package, ignore=leave)
    shutil.copytree(ROOT / "tests" / "vectors", folder / "tests" / "vectors")
    for table in ("tests/tools/lab/scheduling/decisions.json", "tests/view_text.json"):
        (folder / table).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / table, folder / table)
    shutil.copy(ROOT / "SPEC.md", folder)
    npm(_INSTALL, package)
    npm(("run", "build"), package)
    return package


def build_once(shared: Path) -> Path:
    """Build the package in a shared folder: the first process builds, later processes wait."""
    # Where Node is missing every test skips, whichever process comes first.
    installed("npm")
    folder = shared / "web-package"
    failed = shared / "web-package-failed"
    done = shared / "web-package-done"
    try:
        folder.mkdir()
    except FileExistsError:
        for _ in range(_PATIENCE_SECONDS):
            if done.exists():
                return folder / "tools" / "web"
            assert not failed.exists(), "the npm package was not built: see the test that built it"
            time.sleep(1)
        raise AssertionError(f"no npm package after {_PATIENCE_SECONDS} s") from None
    try:
        package = build(folder)
    except BaseException:
        failed.touch()
        raise
    done.touch()
    return package
