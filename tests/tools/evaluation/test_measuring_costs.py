"""Estimated costs grow with splats, pixels and versions."""

import pytest

from cogsplat.tools.evaluation.measuring_costs import (
    comparison_costs,
    objects_cost,
    references_cost,
    versions_cost,
)
from cogsplat.tools.lab.synthetic.terrace import synth_cameras


def test_costs_add_up_by_views_and_versions() -> None:
    cameras = synth_cameras(4, 64, 48)
    once = versions_cost(1000, cameras, 1)
    assert versions_cost(1000, cameras, 3) == pytest.approx(3 * once)
    assert versions_cost(1000, cameras * 2, 1) == pytest.approx(2 * once)
    assert versions_cost(9000, cameras, 1) > once
    assert versions_cost(1000, synth_cameras(4, 640, 480), 1) > 10 * once
    test, close, roam = comparison_costs(1000, cameras)
    assert (test.stage, close.stage, roam.stage) == ("test", "close", "roam")
    assert roam.cost == pytest.approx(2 * test.cost)
    # Two renders of each view in place of one.
    assert once < test.cost + roam.cost < 2 * once
    assert 0.0 < references_cost(1000, cameras) < once
    assert objects_cost(1000, cameras, 2) > objects_cost(1000, cameras, 1) > 0.0
