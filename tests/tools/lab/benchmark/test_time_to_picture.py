"""Quality over time while a browser loads a scene."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from chromium import executable
from running import SmallScene

import cogsplat
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.tools.lab.benchmark import time_to_picture
from cogsplat.tools.lab.benchmark.time_to_picture import Arrival, Contender, chart, contenders, run

ARRIVAL = Arrival("COGS", 5.0, 1000, (0.1, 0.5, 0.9), (20.0, 30.0, 41.0))


def test_times_to_thresholds() -> None:
    assert ARRIVAL.seconds_to(15.0) == 0.1
    assert ARRIVAL.seconds_to(30.0) == 0.5
    assert ARRIVAL.seconds_to(50.0) is None
    report = ARRIVAL.report()
    assert (report["first_s"], report["to_24_db_s"], report["to_30_db_s"]) == (0.1, 0.5, 0.5)
    assert (report["last_s"], report["final_db"]) == (0.9, 41.0)


def test_chart_names_every_file_and_its_size() -> None:
    other = Arrival("SPZ", 5.0, 2_000_000, (3.0,), (35.0,))
    texts = {
        node.text for node in ElementTree.fromstring(chart([ARRIVAL, other], "a scene")).iter()
    }
    assert {"COGS, 0.0 MB", "SPZ, 2.0 MB"} <= texts
    assert "Time to picture, 5 Mbit/s" in texts


@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_the_scene_is_written_in_every_format(small: SmallScene, tmp_path: Path) -> None:
    source = cogsplat.read(small.ply)
    found = contenders(source, small.cogs, tmp_path)
    assert [file.name for file in found] == [
        "COGS", "SPZ", "SOG", "compressed PLY", ".splat", ".splat by rows",
    ]  # fmt: skip
    for file in found[1:]:
        assert len(cogsplat.read(file.path)) == len(source)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_a_browser_ends_with_the_whole_scene(
    small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, web_package: Path
) -> None:
    monkeypatch.setenv("COGSPLAT_CHROMIUM", executable())
    monkeypatch.setattr(time_to_picture, "_WEB", web_package)
    source, cameras = cogsplat.read(small.ply), read_cameras(small.cameras)[:2]
    rows = next(file for file in contenders(source, small.cogs, tmp_path) if file.way == "bytes")
    ours = Contender("COGS", "cogs", small.cogs)
    # Spark, which npm brings, is not needed for these two.
    found = run(source, [ours, rows], cameras, [20.0], tmp_path, runs=1)
    assert [arrival.name for arrival in found] == ["COGS", ".splat by rows"]
    for arrival, file, least_db in zip(found, (ours, rows), (30.0, 20.0), strict=True):
        assert arrival.size_bytes == file.path.stat().st_size
        assert list(arrival.seconds) == sorted(arrival.seconds)
        assert arrival.quality_db[-1] >= least_db
        assert arrival.quality_db[-1] == max(arrival.quality_db)
