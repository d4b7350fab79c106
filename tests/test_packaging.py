"""The wheel holds the packages and nothing else, and what it holds works by itself."""

import importlib.metadata
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("codec", "formats", "tools")
EXTRAS = ("numba", "scipy", "sklearn", "PIL", "plyfile", "skimage", "threadpoolctl")

# What the core install must be able to import.
CORE = (
    "cogsplat",
    "cogsplat.codec.segments.heads",
    "cogsplat.formats.cogs.reader",
    "cogsplat.formats.scenes.ply.ply_scene",
    "cogsplat.tools.delivery.local_server",
    "cogsplat.tools.lab.synthetic.terrace",
)

# `setuptools` of pyproject.toml; older ones do not know its licence field.
OLDEST_SETUPTOOLS = 77


def newest_setuptools_is_here() -> bool:
    try:
        version = importlib.metadata.version("setuptools")
    except importlib.metadata.PackageNotFoundError:
        return False
    return int(version.split(".")[0]) >= OLDEST_SETUPTOOLS


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy what the wheel is made of: building in place would leave folders behind."""
    tree = tmp_path_factory.mktemp("tree")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree / name)
    leave = shutil.ignore_patterns("__pycache__", "node_modules", "*.egg-info")
    for name in ("cogsplat", *PACKAGES, "tests/vectors"):
        shutil.copytree(ROOT / name, tree / name, ignore=leave)
    return tree


@pytest.fixture(scope="module")
def wheel(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> zipfile.Path:
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-input"]
    command += ["--disable-pip-version-check", "--wheel-dir", str(out)]
    if newest_setuptools_is_here():
        command.append("--no-build-isolation")
    built = subprocess.run(
        [*command, str(tree)], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = out.iterdir()
    return zipfile.Path(path)


@pytest.mark.slow
def test_wheel_is_the_tree_and_nothing_else(tree: Path, wheel: zipfile.Path) -> None:
    names = [name for name in wheel.root.namelist() if not name.endswith("/")]
    assert len(names) == len(set(names))
    inside = {name for name in names if ".dist-info/" not in name}
    expected = {f"cogsplat/{path.name}" for path in (tree / "cogsplat").iterdir() if path.is_file()}
    for package in PACKAGES:
        sources = (tree / package).rglob("*.py")
        expected |= {f"cogsplat/{path.relative_to(tree).as_posix()}" for path in sources}
    programs = ("viewer.js", "viewer_extras.js", "viewer_worker.js", "worker.js")
    served = ("viewer.html", "viewer.css", *programs)
    expected |= {f"cogsplat/tools/web/dist/{name}" for name in served}
    vectors = [path for path in (tree / "tests/vectors").rglob("*") if path.is_file()]
    expected |= {f"cogsplat/{path.relative_to(tree / 'tests').as_posix()}" for path in vectors}
    assert inside == expected
    notes = {name.split("/", 1)[1] for name in names if ".dist-info/" in name}
    assert "licenses/LICENSE" in notes
    assert "entry_points.txt" in notes


def test_the_checkout_has_no_links() -> None:
    """Clones without symbolic links, Windows' default, hold the same files."""
    listed = subprocess.run(
        ["git", "ls-files", "--stage"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("not a clone")
    assert [line for line in listed.stdout.splitlines() if line.startswith("120000")] == []


@pytest.mark.slow
def test_core_alone_imports_from_the_wheel(wheel: zipfile.Path, tmp_path: Path) -> None:
    """Decoding and inspection work with no extra installed."""
    # Not by `wheel.root`, whose listing has folders that the file does not hold.
    with zipfile.ZipFile(str(wheel.root.filename)) as archive:
        archive.extractall(tmp_path)
    program = [
        "import sys",
        f"sys.path.insert(0, {str(tmp_path)!r})",
        f"sys.modules.update(dict.fromkeys({EXTRAS!r}))",
        f"import {', '.join(CORE)}",
        "print(cogsplat.__file__, cogsplat.codec.splats.__file__)",
    ]
    # -P keeps the current folder off the path, -s the user's own packages.
    command = [sys.executable, "-P", "-s", "-c", "\n".join(program)]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for path in done.stdout.split():
        assert Path(path).is_relative_to(tmp_path)


USER_SCRIPT = """import cogsplat

wrong: str = cogsplat.read("scene.ply")
"""

CHECKERS = {
    "mypy": (
        ["--no-incremental", "--config-file", os.devnull, "--python-executable"],
        '(expression has type "Splats", variable has type "str")',
        "Found 1 error in 1 file",
    ),
    "pyright": (
        ["--pythonpath"],
        'Type "Splats" is not assignable to declared type "str"',
        "1 error, 0 warnings",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("checker", CHECKERS)
def test_types_of_an_installed_wheel_resolve(
    checker: str, wheel: zipfile.Path, tmp_path: Path
) -> None:
    pytest.importorskip(checker, reason=f"needs {checker}")
    venv.create(tmp_path / "venv", with_pip=True, symlinks=True)
    python = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    script = tmp_path / "user.py"
    script.write_text(USER_SCRIPT, encoding="utf-8")
    options, message, count = CHECKERS[checker]
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-input"]
    install += ["--disable-pip-version-check", str(wheel.root.filename)]
    check = [sys.executable, "-m", checker, *options, python, script]
    # Neither may see this checkout.
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for command in (install, check):
        done = subprocess.run(
            [str(word) for word in command],
            cwd=tmp_path,
            env=clean,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == (0 if command is install else 1), done.stdout + done.stderr
    assert message in done.stdout
    assert count in done.stdout
