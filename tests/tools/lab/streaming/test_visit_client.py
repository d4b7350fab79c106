"""Simulated visits: arrival times, memory budget, browser delays."""

from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import ratios_from_boxes
from cogsplat.tools.lab.streaming.client import (
    PAGE,
    Arrivals,
    Link,
    Units,
    fetch_order,
    units_of,
)
from cogsplat.tools.lab.streaming.comparison import POLICIES, Simulation
from cogsplat.tools.lab.streaming.traces import Trace, recorded_trace
from cogsplat.tools.lab.streaming.visit_client import Browser, simulate_visit
from cogsplat.tools.lab.synthetic.rooms import rooms_walk

REST = recorded_trace([rooms_walk(4)[20].downscaled(8)] * 2, 1.0)
WALK = recorded_trace(rooms_walk(4)[::20], 1.0)
LINK = Link(80_000.0, 0.05)
# The download ends before the walk.
FAST = Link(800_000.0, 0.05)


def run_visit(
    file: CogsFile, trace: Trace, link: Link = LINK, budget: int = 0, browser: Browser | None = None
) -> tuple[Units, Arrivals]:
    units = units_of(file)
    chunks = file.chunks
    contribution = chunks.contribution.astype(np.float64)
    ratios = ratios_from_boxes(chunks.box.astype(np.float64), contribution)
    splats = chunks.splats.astype(np.int64).tolist()
    return units, simulate_visit(
        units,
        splats,
        contribution,
        lambda pose, _: ratios(pose),
        trace,
        link,
        budget_splats=budget,
        browser=browser,
    )


def test_every_unit_arrives_once_within_the_bandwidth(house_file: CogsFile) -> None:
    units, arrivals = run_visit(house_file, WALK)
    assert sorted(arrivals.units) == list(range(len(units)))
    assert (np.diff(arrivals.seconds) >= 0.0).all()
    sizes = units.index_bytes + np.cumsum(units.size_bytes[arrivals.units])
    assert (arrivals.seconds >= LINK.latency + sizes / 10_000.0 - 1e-6).all()
    # The link is hardly ever idle.
    assert arrivals.seconds[-1] < LINK.latency + 1.1 * sizes[-1] / 10_000.0
    assert sorted(arrivals.present_at(1e9)) == list(range(len(units)))
    place = {unit: at for at, unit in enumerate(arrivals.units)}
    for unit, before in enumerate(units.dependencies):
        assert all(place[other] < place[unit] or unit < other for other in before)


@pytest.mark.parametrize("share", [0.4, 0.7])
def test_a_budget_is_kept_at_every_moment(house_file: CogsFile, share: float) -> None:
    budget = int(share * int(house_file.chunks.splats.sum()))
    units, arrivals = run_visit(house_file, WALK, FAST, budget=budget)
    splats = house_file.chunks.splats.astype(np.int64)
    assert arrivals.evicted_at is not None
    assert np.isfinite(arrivals.evicted_at).any()
    most = 0
    for seconds in np.linspace(0.0, float(arrivals.seconds[-1]) + 1.0, 60):
        there = np.array(arrivals.present_at(float(seconds)), np.int64)
        assert len(np.unique(there)) == len(there)
        held = units.row[there[units.kind[there] == SegmentKind.HEAD]]
        most = max(most, int(splats[held].sum()))
    assert 0.5 * budget < most <= budget


def test_units_of_the_first_request_are_read_from_its_buffer(
    house_file: CogsFile,
) -> None:
    assert house_file.file_length < 65_536
    splats = house_file.chunks.splats.astype(np.int64)
    units, arrivals = run_visit(house_file, WALK, FAST, budget=int(splats.sum()) // 2)
    came = np.array(arrivals.units)
    later = arrivals.seconds > FAST.latency + house_file.file_length / 100_000.0
    # Units chosen after the download are present at once, several at the same time.
    assert len(np.unique(arrivals.seconds[later])) < later.sum() / 2
    # Units that exceed the budget were not read from the buffer before.
    heads = units.kind[came] == SegmentKind.HEAD
    assert splats[np.unique(units.row[came[heads & ~later]])].sum() < splats.sum()


def test_pages_arrive_before_what_they_list_and_a_small_budget_needs_one(
    paged_house: Path,
) -> None:
    with cogsplat.open(paged_house) as file:
        simulation = Simulation(file, [], threads=1)
        client, units = simulation.client("visit"), simulation.units
        assert units.page_of is not None
        pages = np.flatnonzero(units.kind == PAGE)
        assert len(pages) == 2
        budget = int(0.15 * int(file.root.splats))
        # This pose shows little of what one of the pages lists.
        rest = recorded_trace([rooms_walk(4)[40].downscaled(8)] * 2, 1.0)
        for splats, known in ((0, 2), (budget, 1)):
            came = simulation.arrivals("visit", client, rest, FAST, budget_splats=splats)
            assert np.isin(pages, came.units).sum() == known
            place = {unit: at for at, unit in enumerate(came.units)}
            listed = [unit for unit in came.units if units.page_of[unit] >= 0]
            assert bool(listed) == bool(known)
            assert all(place[int(units.page_of[unit])] < place[unit] for unit in listed)
            assert 4 < came.requests_by(1e9) < len(came.units)
            drawn = client.splats_of(came.present_at(1e9), rest.camera_at(0.0))
            assert len(drawn) == file.root.splats if not splats else 0 < len(drawn) <= budget


def test_a_page_is_read_once_and_its_bytes_count(paged_house: Path) -> None:
    with cogsplat.open(paged_house) as file:
        units = units_of(file)
        assert units.index_bytes + units.size_bytes.sum() == file.file_length
        for name in POLICIES:
            if name in ("antimatter", "sgss-cells"):
                continue
            simulation = Simulation(file, [], threads=1)
            client = simulation.client(name)
            found = fetch_order(units, client.priorities, REST.camera_at(0.0))
            assert sorted(found) == list(range(len(units)))


def test_browser_delays_postpone_arrivals(house_file: CogsFile) -> None:
    _, at_once = run_visit(house_file, WALK)
    slow = Browser(start_seconds=0.5, splats_per_second=2000.0)
    _, later = run_visit(house_file, WALK, browser=slow)
    assert later.seconds[0] > at_once.seconds[0] + 0.5
    rows = int(house_file.chunks.splats.sum())
    assert later.seconds[-1] >= 0.5 + rows / 2000.0


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_units_are_usable_after_their_dependencies(house_file: CogsFile, share: float) -> None:
    budget = int(share * float(house_file.chunks.splats.sum()))
    units, arrivals = run_visit(house_file, WALK, budget=budget)
    assert arrivals.units
    for seconds in arrivals.seconds.tolist():
        there = set(arrivals.present_at(seconds))
        assert all(before in there for unit in there for before in units.dependencies[unit])


def test_nothing_is_decoded_before_the_worker_has_started(house_file: CogsFile) -> None:
    _, arrivals = run_visit(house_file, WALK, browser=Browser(decoder_seconds=2.0))
    assert arrivals.seconds[0] == 2.0


def test_evicted_units_are_not_present() -> None:
    arrivals = Arrivals([3, 4, 3], np.array([1.0, 2.0, 5.0]), np.array([4.0, np.inf, np.inf]))
    assert [arrivals.present_at(seconds) for seconds in (0.5, 1.0, 3.0, 4.5, 6.0)] == [
        [], [3], [3, 4], [4], [4, 3],
    ]  # fmt: skip
    assert arrivals.fetched_by(4.5) == [3, 4]
