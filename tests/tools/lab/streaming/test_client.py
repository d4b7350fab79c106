"""Fetchable units, their dependencies and simulated arrival times."""

from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.scheduler import best_chain
from cogsplat.tools.lab.streaming.client import Link, simulate_fetch, units_of
from cogsplat.tools.lab.streaming.policies import file_order
from cogsplat.tools.lab.streaming.traces import recorded_trace
from cogsplat.tools.lab.synthetic.rooms import rooms_walk

TRACE = recorded_trace(rooms_walk(4), 0.5)


def test_units_are_in_the_order_of_the_file(house_file: CogsFile) -> None:
    units = units_of(house_file)
    assert (np.diff(units.end) > 0).all()
    heads = units.row[units.kind == SegmentKind.HEAD]
    np.testing.assert_array_equal(heads, np.arange(house_file.num_chunks))
    assert units.end[-1] == house_file.file_length
    # This file has neither cameras nor compensation.
    assert units.index_bytes + units.size_bytes.sum() == house_file.file_length


def test_arrival_times_follow_from_bandwidth_and_latency(house_file: CogsFile) -> None:
    units = units_of(house_file)
    came = simulate_fetch(units, TRACE, Link(80_000.0, 0.1), file_order(units))
    assert came.units == list(range(len(units)))
    sizes = units.index_bytes + np.cumsum(units.size_bytes)
    np.testing.assert_allclose(came.seconds, 0.1 + sizes / 10_000.0)


@pytest.mark.parametrize("seed", range(4))
def test_units_arrive_after_their_dependencies(house_file: CogsFile, seed: int) -> None:
    units = units_of(house_file)
    urgency = np.random.default_rng(seed).random(len(units))
    came = simulate_fetch(units, TRACE, Link(1e6, 0.02), lambda _, __: urgency)
    assert sorted(came.units) == list(range(len(units)))
    place = {unit: at for at, unit in enumerate(came.units)}
    for unit, dependencies in enumerate(units.dependencies):
        assert all(place[other] < place[unit] for other in dependencies)
    # A chunk's head needs the heads of its parents, up to the first chunk.
    last = int(np.flatnonzero(units.row == house_file.num_chunks - 1)[0])
    best = best_chain([last], urgency, units.size_bytes, units.dependencies, lambda _: True)
    assert best is not None
    assert best[0][-1] == last
    assert 0 in units.row[list(best[0])]


def test_units_are_chosen_by_the_pose_one_latency_earlier(house_file: CogsFile) -> None:
    units = units_of(house_file)
    positions: list[np.ndarray] = []

    def priorities(camera: cogsplat.Camera, _: object) -> np.ndarray:
        positions.append(camera.position)
        return -np.arange(len(units), dtype=np.float64)

    link = Link(8.0 * float(units.end[-1]) / TRACE.seconds, 1.0)
    came = simulate_fetch(units, TRACE, link, priorities)
    began = np.concatenate([[1.0 + 8.0 * units.index_bytes / link.bits_per_second], came.seconds])
    for position, seconds in zip(positions, began, strict=False):
        np.testing.assert_allclose(position, TRACE.camera_at(seconds - 1.0).position)


def test_truncated_files_have_the_units_of_complete_chunks(house: Path) -> None:
    size = house.stat().st_size // 2
    with cogsplat.open(house, size_bytes=size) as part:
        units = units_of(part)
        assert units.end.max() <= size
        assert units.row.max() == part.complete_chunks() - 1
