"""Bytes needed to hold a PSNR along a trace."""

import numpy as np

from cogsplat.codec.metrics import psnr
from cogsplat.tools.lab.streaming.comparison import Simulation
from cogsplat.tools.lab.streaming.goal_bytes import bytes_to_hold_goal
from cogsplat.tools.lab.streaming.traces import Trace, recorded_trace
from cogsplat.tools.lab.synthetic.rooms import rooms_walk

GOAL_DB = 35.0


def walk() -> Trace:
    """Return the first poses of a walk, with pictures of an eighth of the size."""
    cameras = [c.downscaled(8) for c in rooms_walk(4)[:12:3]]
    return recorded_trace(cameras, 0.5)


def test_the_oracle_needs_fewer_bytes_than_the_order_of_the_file(simulation: Simulation) -> None:
    total = int(simulation.units.size_bytes.sum())
    found = bytes_to_hold_goal(simulation, walk(), ["file", "whole", "oracle"], 4, GOAL_DB)
    for sizes in found.values():
        assert len(sizes) == 4
        assert sizes == sorted(sizes)
    assert found["whole"] == [total] * 4
    assert found["oracle"][-1] < 0.8 * found["file"][-1]
    assert found["file"][-1] <= total


def test_one_unit_less_misses_the_goal(simulation: Simulation) -> None:
    ((size,),) = bytes_to_hold_goal(simulation, walk(), ["file"], 1, GOAL_DB).values()
    camera = walk().camera_at(0.0)
    whole = simulation.picture(camera)
    client = simulation.client("file")
    sizes = np.cumsum(simulation.units.size_bytes)
    count = int(np.searchsorted(sizes, size)) + 1
    assert sizes[count - 1] == size
    quality = [
        psnr(simulation.picture(camera, client.splats_of(range(end), camera)), whole)
        for end in (count - 1, count)
    ]
    assert quality[0] < GOAL_DB <= quality[1]
