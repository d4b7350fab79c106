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
    for name in ("cogsplat", *PACKAGES):
        shutil.copytree(ROOT / name, tree / name, symlinks=True, ignore=leave)
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
    expected = {"cogsplat/__init__.py", "cogsplat/py.typed"}
    for package in PACKAGES:
        sources = (tree / package).rglob("*.py")
        expected |= {f"cogsplat/{path.relative_to(tree).as_posix()}" for path in sources}
    built = [path for path in (tree / "tools/web/dist").iterdir() if path.is_file()]
    programs = {"viewer.js", "worker.js", "viewer_worker.js"}
    assert {"viewer.html", *programs} <= {path.name for path in built}
    expected |= {f"cogsplat/{path.relative_to(tree).as_posix()}" for path in built}
    assert inside == expected
    notes = {name.split("/", 1)[1] for name in names if ".dist-info/" in name}
    assert "licenses/LICENSE" in notes
    assert "entry_points.txt" in notes


@pytest.mark.slow
def test_links_in_the_import_package_lead_to_the_packages() -> None:
    for name in PACKAGES:
        link = ROOT / "cogsplat" / name
        assert link.is_symlink()
        assert link.readlink() == Path("..") / name


@pytest.mark.slow
def test_core_alone_imports_from_the_wheel(wheel: zipfile.Path, tmp_path: Path) -> None:
    """What decodes and inspects works with no extra installed."""
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


@pytest.mark.slow
def test_types_resolve_after_the_editable_install_of_the_readme(tree: Path, tmp_path: Path) -> None:
    """A checker finds the package and its types, not a module without any."""
    venv.create(tmp_path / "venv", with_pip=True, symlinks=True)
    python = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    script = tmp_path / "user.py"
    script.write_text(USER_SCRIPT, encoding="utf-8")
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-input", "-e", tree]
    install += ["--disable-pip-version-check", "--config-settings", "editable_mode=compat"]
    mypy = [sys.executable, "-m", "mypy", "--python-executable", python, "--no-incremental"]
    mypy += ["--config-file", os.devnull, script]
    pyright = [sys.executable, "-m", "pyright", "--pythonpath", python, script]
    # None may see this checkout.
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    told = []
    for command in (install, mypy, pyright):
        done = subprocess.run(
            [str(word) for word in command],
            cwd=tmp_path,
            env=clean,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        told.append(done.stdout + done.stderr)
        assert done.returncode == (0 if command is install else 1), told[-1]
    assert '(expression has type "Splats", variable has type "str")' in told[1]
    assert "Found 1 error in 1 file" in told[1]
    assert 'Type "Splats" is not assignable to declared type "str"' in told[2]
    assert "1 error, 0 warnings" in told[2]


def test_the_checks_install_as_the_readme_does() -> None:
    """One way to install, so that what the checks see is what users get."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "--editable '.[dev]' --config-settings editable_mode=compat" in script
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count("--config-settings editable_mode=compat") >= 2
