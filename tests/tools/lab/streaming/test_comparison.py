"""Comparison of policies on a small house."""

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import ratios_from_boxes
from cogsplat.tools.lab.streaming.client import Link, units_of
from cogsplat.tools.lab.streaming.comparison import (
    POLICIES,
    SHARES,
    Moment,
    Simulation,
    bytes_until,
    moments_behind,
)
from cogsplat.tools.lab.streaming.traces import recorded_trace
from cogsplat.tools.lab.streaming.visit_client import simulate_visit
from cogsplat.tools.lab.synthetic.rooms import rooms_walk


def small(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras with pictures of an eighth of the size."""
    return [camera.downscaled(8) for camera in cameras]


def test_view_dependent_policies_beat_the_order_of_the_file(simulation: Simulation) -> None:
    found = simulation.at_rest(small(rooms_walk(4)[::15]), POLICIES)
    assert set(found) == set(POLICIES)
    file, views, oracle = (np.array(found[name]) for name in ("file", "views", "oracle"))
    half = SHARES.index(0.5)
    assert views[half] > file[half] + 3.0
    assert oracle[half] > file[half] + 3.0
    assert (np.diff(file) > 0.0).all()


def test_bytes_grow_along_a_trace(simulation: Simulation) -> None:
    trace = recorded_trace(small(rooms_walk(4)), 0.5)
    total = 8.0 * float(simulation.units.end[-1])
    seen = simulation.run_trace(trace, Link(total / trace.seconds, 0.02), ["file", "views"], 4)
    for moments in seen.values():
        assert [moment.seconds for moment in moments] == pytest.approx(
            [trace.seconds * part / 4 for part in (1, 2, 3, 4)], rel=0.01
        )
        sizes = [moment.bytes for moment in moments]
        assert sizes == sorted(sizes)
        assert sizes[0] < sizes[-1]


def test_bytes_of_chunks_never_visible_are_wasted(simulation: Simulation) -> None:
    trace = recorded_trace(small(rooms_walk(4))[:2], 1.0)
    total = 8.0 * float(simulation.units.end[-1])
    pictures: dict[str, int] = {}

    def on_picture(name: str, seconds: float, picture: np.ndarray) -> None:
        pictures[name] = pictures.get(name, 0) + 1
        assert picture.shape == (45, 60, 3)

    # The download ends shortly before the trace.
    link = Link(1.01 * total / trace.seconds, 0.0)
    seen = simulation.run_trace(
        trace, link, ["whole", "antimatter", "views"], 3, on_picture=on_picture
    )
    assert pictures == {"": 3, "whole": 3, "antimatter": 3, "views": 3}
    last = {name: moments[-1] for name, moments in seen.items()}
    # Other rooms are invisible; at the last moment the whole file is present.
    assert last["whole"].psnr_db == 100.0
    assert last["whole"].ssim == pytest.approx(1.0)
    assert 0.2 < last["whole"].wasted_bytes / last["whole"].bytes < 1.0
    assert seen["whole"][0].psnr_db < 20.0
    for moments in seen.values():
        assert all(0 <= moment.wasted_bytes <= moment.bytes for moment in moments)
    assert seen["views"][0].wasted_bytes < seen["antimatter"][0].bytes


def test_goal_bytes_are_those_after_which_the_goal_is_held() -> None:
    seen = [
        Moment(seconds=float(n), bytes=10 * n, psnr_db=db, ssim=1.0, wasted_bytes=0)
        for n, db in enumerate([60.0, 40.0, 55.0, 50.0])
    ]
    assert bytes_until(seen, 50.0) == 20
    assert bytes_until(seen, 30.0) == 0
    assert bytes_until(seen, 58.0) is None


def test_moments_behind_skip_the_first_second() -> None:
    def seen(*qualities: float) -> list[Moment]:
        return [Moment(0.8 * n, 0, db, 1.0, 0) for n, db in enumerate(qualities, 1)]

    others = seen(40.0, 40.0, 29.0, 40.0, 30.0)
    assert moments_behind(seen(20.0, 20.0, 20.0, 31.0, 29.9), others, 30.0) == 2
    assert moments_behind(others, others, 30.0) == 0


def test_the_last_moment_includes_the_last_arrival(simulation: Simulation) -> None:
    total = 8.0 * float(simulation.units.end[-1])
    trace = recorded_trace(small(rooms_walk(4)), 0.5)
    for seconds in np.linspace(3.0, 7.0, 5):
        link = Link(total / seconds, 0.02)
        for count in (1, 6, 7):
            assert simulation.run_trace(trace, link, ["file"], count)["file"][-1].psnr_db == 100.0


def test_a_fast_link_ends_the_comparison_with_the_download(simulation: Simulation) -> None:
    trace = recorded_trace(small(rooms_walk(4)), 0.5)
    (last,) = simulation.run_trace(trace, Link(1e9, 0.0), ["file"], 1)["file"]
    assert last.seconds < 0.01
    assert last.psnr_db == 100.0


def test_visit_uses_boxes_for_files_without_a_view_table(
    simulation: Simulation, house_file: CogsFile
) -> None:
    assert not house_file.view_table_rows
    trace, link = recorded_trace(rooms_walk(4)[::20], 1.0), Link(80_000.0, 0.05)
    boxes = house_file.chunks.box.astype(np.float64)
    contribution = house_file.chunks.contribution.astype(np.float64)
    ratios = ratios_from_boxes(boxes, contribution)
    splats = house_file.chunks.splats.astype(np.int64).tolist()
    expected = simulate_visit(
        units_of(house_file), splats, contribution, lambda pose, _: ratios(pose), trace, link
    )
    assert simulation.arrivals("visit", simulation.client("visit"), trace, link).units == (
        expected.units
    )
