"""A client: what it may fetch, what has to come first, and when it comes."""

from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.scheduler import best_chain
from cogsplat.tools.lab.streaming.client import Link, fetch, units_of
from cogsplat.tools.lab.streaming.policies import file_order
from cogsplat.tools.lab.streaming.traces import recorded
from cogsplat.tools.lab.synthetic.rooms import rooms_walk

TRACE = recorded(rooms_walk(4), 0.5)


def test_units_are_the_segments_of_pictures_in_the_order_of_the_file(house_file: CogsFile) -> None:
    units = units_of(house_file)
    assert (np.diff(units.end) > 0).all()
    heads = units.chunk[units.kind == SegmentKind.HEAD]
    np.testing.assert_array_equal(heads, np.arange(house_file.num_chunks))
    assert units.end[-1] == house_file.file_length
    # This file has neither cameras nor compensation.
    assert units.opening_bytes + units.size_bytes.sum() == house_file.file_length


def test_in_the_order_of_the_file_bytes_come_as_the_link_lets_them(house_file: CogsFile) -> None:
    units = units_of(house_file)
    came = fetch(units, TRACE, Link(80_000.0, 0.1), file_order(units))
    assert came.units == list(range(len(units)))
    sizes = units.opening_bytes + np.cumsum(units.size_bytes)
    np.testing.assert_allclose(came.seconds, 0.1 + sizes / 10_000.0)


@pytest.mark.parametrize("seed", range(4))
def test_whatever_is_wanted_comes_behind_what_it_needs(house_file: CogsFile, seed: int) -> None:
    units = units_of(house_file)
    wanted = np.random.default_rng(seed).random(len(units))
    came = fetch(units, TRACE, Link(1e6, 0.02), lambda _: wanted)
    assert sorted(came.units) == list(range(len(units)))
    place = {unit: at for at, unit in enumerate(came.units)}
    for unit, before in enumerate(units.after):
        assert all(place[other] < place[unit] for other in before)
    # A chunk's head needs the heads of its parents, up to the first chunk.
    last = int(np.flatnonzero(units.chunk == house_file.num_chunks - 1)[0])
    best = best_chain([last], wanted, units.size_bytes, units.after, lambda _: True)
    assert best is not None
    assert best[0][-1] == last
    assert 0 in units.chunk[list(best[0])]


def test_what_comes_next_follows_the_pose_of_a_latency_ago(house_file: CogsFile) -> None:
    units = units_of(house_file)
    asked: list[np.ndarray] = []

    def wanted(camera: cogsplat.Camera) -> np.ndarray:
        asked.append(camera.position)
        return -np.arange(len(units), dtype=np.float64)

    link = Link(8.0 * float(units.end[-1]) / TRACE.seconds, 1.0)
    came = fetch(units, TRACE, link, wanted)
    began = np.concatenate([[1.0 + 8.0 * units.opening_bytes / link.bits_per_second], came.seconds])
    for position, seconds in zip(asked, began, strict=False):
        np.testing.assert_allclose(position, TRACE.at(seconds - 1.0).position)


def test_of_a_part_of_a_file_complete_chunks_may_be_fetched(house: Path) -> None:
    size = house.stat().st_size // 2
    with cogsplat.open(house, size_bytes=size) as part:
        units = units_of(part)
        assert units.end.max() <= size
        assert units.chunk.max() == part.complete_chunks() - 1
