"""Costs of all boxes at once against each box counted by itself."""

from itertools import product

import numpy as np
import pytest
from every_partition import random_grid

from cogsplat.tools.lab.partitions.box_costs import Spans, box_costs, cut_box, waste


@pytest.mark.parametrize("length", [1, 2, 5])
def test_spans_enumerate_ranges_by_length(length: int) -> None:
    spans = Spans(length)
    starts, ends = spans.ends()
    assert len(starts) == len(set(zip(starts.tolist(), ends.tolist(), strict=True))) == spans.count
    assert (np.diff(ends - starts) >= 0).all()
    for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        assert spans.index(start, end - start) == number
        assert number in range(spans.count)[spans.of_size(end - start)]


@pytest.mark.parametrize("seed", range(4))
def test_box_costs_match_direct_counting(seed: int) -> None:
    grid = random_grid((3, 2, 4), seed)
    costs = box_costs(grid)
    filled = (grid.splats > 0).sum()
    views = [view for view in grid.visible if view.any()]
    shape = grid.splats.shape
    ranges = [[(a, b) for a in range(n) for b in range(a + 1, n + 1)] for n in shape]
    for (a, d), (b, e), (c, f) in product(*ranges):
        part = np.s_[a:d, b:e, c:f]
        splats = grid.splats[part].sum()
        place = costs.index((a, b, c, d, e, f))
        expected = (splats > 0) / filled
        expected += np.mean([splats / view.sum() if view[part].any() else 0.0 for view in views])
        assert costs.splats[place] == splats
        assert costs.cost[place] == pytest.approx(expected)


def test_waste_is_fetched_over_visible_splats() -> None:
    grid = random_grid((2, 1, 1), 0, views=2)
    grid.splats[:] = np.array([10, 40]).reshape(2, 1, 1)
    grid.visible[:] = np.array([[5, 0], [5, 20]]).reshape(2, 2, 1, 1)
    assert waste(grid, [(0, 0, 0, 2, 1, 1)]) == pytest.approx((50 / 5 + 50 / 25) / 2)
    assert waste(grid, [(0, 0, 0, 1, 1, 1), (1, 0, 0, 2, 1, 1)]) == pytest.approx((2 + 2) / 2)
    grid.visible[:] = 0
    assert waste(grid, [(0, 0, 0, 2, 1, 1)]) == 1.0


def test_cut_box_splits_at_a_plane() -> None:
    assert cut_box((0, 1, 2, 3, 4, 5), 1, 3) == ((0, 1, 2, 3, 3, 5), (0, 3, 2, 3, 4, 5))
