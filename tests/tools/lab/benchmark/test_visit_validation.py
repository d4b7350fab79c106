"""Visits in a browser compared with their simulation."""

from pathlib import Path

import numpy as np
import pytest
from chromium import executable

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.lab.benchmark import visit_validation
from cogsplat.tools.lab.benchmark.visit_validation import compare, run_browser, units_of_chunks
from cogsplat.tools.lab.streaming.client import Link, units_of
from cogsplat.tools.lab.streaming.comparison import Simulation
from cogsplat.tools.lab.streaming.traces import recorded_trace
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, rooms_walk, synth_rooms


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("house") / "scene.cogs"
    config = EncodeConfig(cells=True, chunk_splats=128, order="contribution")
    scene = synth_rooms(4, 5000, sh_degree=1)
    cogsplat.encode(scene, path, cameras=rooms_cameras(4, views=2), config=config)
    return path


def test_units_follow_from_the_recorded_chunks(house: Path) -> None:
    with cogsplat.open(house) as file:
        units = units_of(file)
    found = units_of_chunks(units, [(0, False, False), (2, True, True)])
    kinds = [(int(units.row[unit]), int(units.kind[unit])) for unit in found]
    assert (0, SegmentKind.HEAD) in kinds
    assert (0, SegmentKind.REFINEMENT) not in kinds
    assert {kind for chunk, kind in kinds if chunk == 2} >= {SegmentKind.HEAD, SegmentKind.TAIL}


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["house", "paged_house"])
def test_browser_and_simulation_end_with_the_same_splats(
    scene: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, web_package: Path
) -> None:
    house: Path = request.getfixturevalue(scene)
    monkeypatch.setenv("COGSPLAT_CHROMIUM", executable())
    monkeypatch.setattr(visit_validation, "_WEB", web_package)
    with cogsplat.open(house) as file:
        simulation = Simulation(file, rooms_cameras(4, views=2), threads=1)
        total = int(file.chunks.splats.sum())
        walked = recorded_trace(rooms_walk(4)[:4], 0.5)
        link = Link(4e6, 0.02)
        # Late enough for the download on a busy machine. The chunks within a budget depend on the
        # order of arrival, so only their number is checked.
        for budget in (0, total // 2):
            visit = run_browser(house, walked, link, [8.0], budget, 2e6)
            rows, pictures = compare(simulation, walked, link, visit, budget)
            browser = visit.browser
            assert 0.0 <= browser.start_seconds < browser.decoder_seconds < 8.0
            assert browser.decoder_seconds < visit.first_rows < 8.0
            assert visit.page_bytes > 100_000
            # Workers of a complete visit have ended.
            assert (visit.worker_bytes > 100_000) == bool(budget)
            (row,) = rows
            assert row.simulated_fetched > 0
            assert row.fetched_bytes > 0
            assert row.requests >= 1
            # Timers of browsers may be a millisecond early.
            assert row.seconds > 7.9
            assert set(pictures) == {"", "browser", "simulated"}
            if budget:
                assert 0 < row.splats <= budget
                assert 0 < row.simulated_splats <= budget
            else:
                assert row.splats == row.simulated_splats == total
                assert row.psnr_db == row.simulated_db == 100.0
                np.testing.assert_array_equal(pictures["browser"][0], pictures[""][0])
