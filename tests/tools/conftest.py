"""One small scene for all tests of the tools, ways to run the command line on it, a browser."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from chromium import chromium
from click.testing import CliRunner, Result
from running import ROOT, SPLATS, VIEWS, Ran, Run, SmallScene, program, words_of
from web_package import build_once

import cogsplat
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.main import cli

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallScene:
    from cogsplat.codec.encode.config import EncodeConfig

    folder = tmp_path_factory.mktemp("small")
    scene = SmallScene(folder / "scene.ply", folder / "scene.cogs", folder / "cameras.json")
    splats, cameras = synth(SPLATS), synth_cameras(VIEWS, 64, 48)
    cogsplat.write(splats, scene.ply)
    write_cameras_json(cameras, scene.cameras)
    config = EncodeConfig(chunk_splats=300, prune=PruneConfig(peak=0.001))
    cogsplat.encode(splats, scene.cogs, cameras=cameras, config=config)
    return scene


@pytest.fixture(scope="session")
def paged_house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A house of 4 rooms cut by cells: the root and two pages, each with a view table."""
    from cogsplat.codec.encode.config import EncodeConfig

    path = tmp_path_factory.mktemp("paged") / "house.cogs"
    config = EncodeConfig(
        profile="near-lossless", cells=True, chunk_splats=64, order="contribution"
    )
    scene, cameras = synth_rooms(4, 8000, sh_degree=1), rooms_cameras(4, views=2)
    cogsplat.encode(scene, path, cameras=cameras, config=config)
    with cogsplat.open(path) as file:
        assert sorted(file.view_table_rows) == [(), (0,), (1,)]
    return path


@pytest.fixture(scope="session")
def web_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the npm package, built once for all processes of this run."""
    own = tmp_path_factory.getbasetemp()
    return build_once(own.parent if "PYTEST_XDIST_WORKER" in os.environ else own)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="session")
def run() -> Run:
    """Run a command in this process; faults of the program are raised."""

    def invoke(*arguments: object) -> Ran:
        result: Result = CliRunner().invoke(cli, words_of(arguments))
        if result.exception and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert "Traceback" not in result.output
        return Ran(result.exit_code, result.stdout, result.stderr)

    return invoke


@pytest.fixture
def run_apart() -> Run:
    """Run a command in a process of its own."""

    def start(*arguments: object, before: str = "") -> Ran:
        done = subprocess.run(
            program(words_of(arguments), before),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        return Ran(done.returncode, done.stdout, done.stderr)

    return start


@pytest.fixture
def few_planned_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plan few and small views without cameras, for tests of what has nothing to do with views.

    Commands such as `merge` encode with the default preset, whose planned views take 10 seconds.
    """
    from cogsplat.codec.encode.presets import Preset
    from cogsplat.codec.views.planner import ViewPlanConfig

    def plan_config(_: Preset, threads: int = 0, *, in_addition: bool = False) -> ViewPlanConfig:
        return ViewPlanConfig(views=6, width=80, height=60, threads=threads)

    monkeypatch.setattr(Preset, "plan_config", plan_config)


@pytest.fixture
def few_vectors(tmp_path: Path) -> Path:
    """A folder with some of the vectors: of refinements, CRC, hash, folders, and a picture."""
    vectors = ROOT / "tests" / "vectors"
    manifest = json.loads((vectors / "manifest.json").read_text())
    names = ("refinements", "sh1", "one-splat")
    manifest["valid"] = [e for e in manifest["valid"] if e["name"] in names]
    codes = ("segment-crc", "segment-hash")
    manifest["invalid"] = [e for e in manifest["invalid"] if e["code"] in codes]
    manifest["folders"] = [e for e in manifest["folders"] if e["name"] == "one-splat"]
    broken = "folder-flip"
    manifest["invalid_folders"] = [e for e in manifest["invalid_folders"] if e["name"] == broken]
    manifest["drawings"] = [e for e in manifest["drawings"] if e["name"] == "half"]
    assert len(manifest["valid"]) == 3
    assert len(manifest["folders"]) == len(manifest["invalid_folders"]) == 1
    assert {e["code"] for e in manifest["invalid"]} == set(codes)
    folder = tmp_path / "vectors"
    for kind, suffixes in (("valid", ("cogs", "f32")), ("invalid", ("cogs",))):
        (folder / kind).mkdir(parents=True)
        for entry in manifest[kind]:
            for suffix in suffixes:
                name = f"{entry['name']}.{suffix}"
                (folder / kind / name).write_bytes((vectors / kind / name).read_bytes())
    (folder / "drawings").mkdir()
    for name in ("half.f32", "viewpoint.cogs", "kernel.cogs"):
        shutil.copy(vectors / "drawings" / name, folder / "drawings")
    shutil.copytree(vectors / "folders" / "one-splat", folder / "folders" / "one-splat")
    shutil.copytree(vectors / "invalid-folders" / broken, folder / "invalid-folders" / broken)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder
