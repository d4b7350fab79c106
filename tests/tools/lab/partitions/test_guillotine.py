"""Straight cuts: the cheapest of all partitions that they can make."""

import pytest
from every_partition import every_partition, is_partition, random_grid

from cogsplat.tools.lab.partitions.box_costs import Box, box_costs, cut_box
from cogsplat.tools.lab.partitions.guillotine import cut_costs


def by_straight_cuts(boxes: list[Box], within: Box) -> bool:
    """Return whether a partition of a box can be made by cuts through whole boxes."""
    if len(boxes) == 1:
        return True
    for axis in range(3):
        for plane in range(within[axis] + 1, within[axis + 3]):
            if all(box[axis + 3] <= plane or box[axis] >= plane for box in boxes):
                low, high = cut_box(within, axis, plane)
                below = [box for box in boxes if box[axis + 3] <= plane]
                above = [box for box in boxes if box[axis] >= plane]
                return by_straight_cuts(below, low) and by_straight_cuts(above, high)
    return False


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 3, 1), (2, 2, 2), (4, 1, 2)])
def test_guillotine_cuts_match_exhaustive_search(shape: tuple[int, int, int], seed: int) -> None:
    costs = box_costs(random_grid(shape, seed))
    found = cut_costs(costs).partition()
    assert is_partition(shape, found)
    least = min(
        costs.total(boxes)
        for boxes in every_partition(shape)
        if by_straight_cuts(boxes, (0, 0, 0, *shape))
    )
    assert costs.total(found) == pytest.approx(least)
