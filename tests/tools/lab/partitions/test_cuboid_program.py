"""The integer program against every partition there is, counted out."""

import numpy as np
import pytest
from every_partition import every_partition, is_partition, random_grid

from cogsplat.tools.lab.partitions.box_costs import BoxCosts, Spans, box_costs
from cogsplat.tools.lab.partitions.cuboid_program import cheapest_partition
from cogsplat.tools.lab.partitions.guillotine import cut_costs

SHAPES = ((3, 3, 1), (2, 2, 2), (3, 2, 2), (5, 2, 1), (4, 1, 2))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("shape", SHAPES)
def test_the_program_finds_the_cheapest_of_all_partitions(
    shape: tuple[int, int, int], seed: int
) -> None:
    costs = box_costs(random_grid(shape, 100 + seed))
    found = cheapest_partition(costs)
    assert is_partition(shape, found.boxes)
    least = min(costs.total(boxes) for boxes in every_partition(shape))
    assert found.cost == pytest.approx(least, rel=1e-9)
    assert costs.total(found.boxes) == pytest.approx(found.cost)
    assert found.bound == pytest.approx(least, rel=1e-6)
    assert found.bound <= least + 1e-9
    assert found.kept <= found.candidates


@pytest.mark.parametrize("seed", range(5))
def test_a_pinwheel_partition_is_found(seed: int) -> None:
    """Four boxes about a middle one: each straight cut through the grid cuts one of them."""
    costs = BoxCosts((Spans(3), Spans(3), Spans(1)), np.zeros((6, 6, 1)), np.ones((6, 6, 1), int))
    costs.cost[:] = 1.0 + np.random.default_rng(seed).random((6, 6, 1))
    pinwheel = [(0, 0, 2, 1), (2, 0, 3, 2), (1, 2, 3, 3), (0, 1, 1, 3), (1, 1, 2, 2)]
    boxes = sorted((a, b, 0, c, d, 1) for a, b, c, d in pinwheel)
    for box in boxes:
        costs.cost[costs.index(box)] = 0.1
    costs.cost[costs.index((0, 0, 0, 3, 3, 1))] = 5.0
    assert costs.total(cut_costs(costs).partition()) > 0.6
    found = cheapest_partition(costs)
    assert found.boxes == boxes
    assert found.cost == pytest.approx(0.5)
