"""Names of files and cameras that no document and no terminal may hold as they are."""

import json
import os
import shutil
import sys
import threading
from pathlib import Path
from urllib.request import ProxyHandler, build_opener
from xml.etree import ElementTree

import pytest
from running import Run, SmallScene

from cogsplat.tools.delivery.local_server import SceneServer

# No UTF-8, an escape sequence of terminals, an end of a title, of a script and of an attribute.
NAME = os.fsdecode(b"bad\xff\x1b[31m <\"&' --> script")

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="names of files are bytes on Linux alone"
)


@pytest.fixture
def named(small: SmallScene, tmp_path: Path) -> Path:
    """A folder that holds the scene under that name, as PLY and as COGS."""
    shutil.copy(small.ply, tmp_path / f"{NAME}.ply")
    shutil.copy(small.cogs, tmp_path / f"{NAME}.cogs")
    return tmp_path


@pytest.mark.usefixtures("few_planned_views")
def test_pages_have_a_title(run: Run, named: Path) -> None:
    for suffix in ("cogs", "ply"):
        told = run("export-html", named / f"{NAME}.{suffix}", named / "page.html", "--force")
        assert told.code == 0, told.err
        assert "\x1b" not in told.out + told.err
        page = (named / "page.html").read_text(encoding="utf-8")
        shown = "bad\\udcff\\x1b[31m &lt;&quot;&amp;&#x27; --&gt; script"
        assert f"<title>{shown}.{suffix}</title>" in page


def test_the_local_server_has_a_title(named: Path) -> None:
    with SceneServer(named / f"{NAME}.cogs", NAME) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        with build_opener(ProxyHandler({})).open(server.url, timeout=30) as answer:
            page = answer.read().decode()
        thread.join()
    assert "<title>bad\\udcff\\x1b[31m &lt;" in page


def test_charts_and_tables_are_written(run: Run, small: SmallScene, named: Path) -> None:
    scene, cameras = named / f"{NAME}.ply", ["--cameras", small.cameras]
    told = run(
        "lab evaluate", scene, *cameras, "--orders", "source", "--shares", "10", "--file",
        named / f"{NAME}.cogs", "--sizes", "50%", "--out", named / "eval",
    )  # fmt: skip
    assert told.code == 0, told.err
    formats = ["--profiles", "none", "--formats", "splat", "--out", named / "bench"]
    told = run("lab bench", scene, *cameras, *formats)
    assert told.code == 0, told.err
    assert "\x1b" not in told.out + told.err
    charts = [*(named / "eval").glob("*.svg"), *(named / "bench").glob("*.svg")]
    assert len(charts) == 8
    for chart in charts:
        assert any(
            "bad\\udcff\\x1b" in (text.text or "") for text in ElementTree.parse(chart).iter()
        )
    assert "bad\\udcff" in (named / "eval" / "eval.csv").read_text(encoding="utf-8")


@pytest.fixture
def odd_cameras(small: SmallScene, tmp_path: Path) -> Path:
    """Cameras, one of which is called half a character and one an escape sequence."""
    cameras = json.loads(small.cameras.read_text())
    cameras[0]["img_name"], cameras[4]["img_name"] = "\ud800<b>", "\x1b[31m"
    path = tmp_path / "odd.json"
    path.write_text(json.dumps(cameras))
    return path


def test_a_report_names_scene_and_cameras(
    run: Run, named: Path, odd_cameras: Path, tmp_path: Path
) -> None:
    report = tmp_path / "report.html"
    told = run(
        "encode", named / f"{NAME}.ply", tmp_path / "out.cogs", "--cameras", odd_cameras,
        "--preset", "fast", "--eval-every", 4, "--report", report,
    )  # fmt: skip
    assert told.code == 0, told.err
    page = report.read_text(encoding="utf-8")
    assert "<h1>bad\\udcff\\x1b[31m &lt;" in page
    assert "\\ud800&lt;b&gt;" in page
    assert "\x1b" not in page


def test_cameras_that_cannot_be_stored_are_refused_before_any_work(
    run: Run, small: SmallScene, odd_cameras: Path, tmp_path: Path
) -> None:
    told = run(
        "encode", small.ply, tmp_path / "out.cogs", "--cameras", odd_cameras, "--store-cameras"
    )
    assert told.code == 3
    assert "[bad-camera]" in told.err
    assert "score" not in told.err


LONG = "n" * 300


@pytest.mark.parametrize(
    "words",
    [
        "info LONG",
        "decode LONG o.ply",
        "decode scene.cogs LONG.ply",
        "encode LONG o.cogs",
        "encode scene.ply LONG.cogs",
        "encode scene.ply o.cogs --cameras LONG",
        "encode scene.ply o.cogs --masks LONG --cameras cameras.json",
        "encode scene.ply o.cogs --report LONG.html",
        "encode scene.ply o.cogs --config LONG",
        "convert LONG o.ply",
        "convert scene.cogs LONG/",
        "merge scene.ply LONG o.ply",
        "tune LONG o.cogs",
        "tune scene.ply o.cogs --checkpoint LONG",
        "layers LONG o.cogs",
        "compare scene.ply LONG",
        "export-html LONG o.html",
        "export-html scene.cogs LONG --folder",
        "render LONG o.png",
        "serve LONG",
        "view LONG",
        "upload LONG s3://bucket/a",
        "batch LONG",
        "lab score LONG o.npy",
        "lab evaluate scene.ply --out LONG",
        "lab simulate LONG --cameras cameras.json",
    ],
)
def test_names_that_are_too_long_are_errors_of_files(
    run: Run, small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    """Not a traceback, nor an error of standard output, which others of the system are."""
    for path in (small.ply, small.cogs, small.cameras):
        shutil.copy(path, tmp_path / path.name)
    monkeypatch.chdir(tmp_path)
    first, *others = words.replace("LONG", LONG).replace("lab ", "lab_").split()
    told = run(first.replace("_", " "), *others)
    assert told.code in (2, 3, 4), told.err
    assert "standard output" not in told.err
    assert LONG in told.err
