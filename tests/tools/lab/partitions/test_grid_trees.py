"""Trees over a grid: partitions of as many boxes as asked for, cut where most splats are."""

import numpy as np
import pytest
from every_partition import is_partition, random_grid

from cogsplat.tools.lab.partitions.basic_cuboids import BasicCuboids
from cogsplat.tools.lab.partitions.grid_trees import kd_partition, octree_partition


def spread(shape: tuple[int, int, int]) -> BasicCuboids:
    grid = random_grid(shape, 0)
    grid.splats[:] = 10
    return grid


@pytest.mark.parametrize("cells", [1, 2, 3, 9, 24])
def test_a_kd_tree_has_the_requested_cells(cells: int) -> None:
    boxes = kd_partition(spread((4, 3, 2)), cells)
    assert len(boxes) == cells
    assert is_partition((4, 3, 2), boxes)


def test_a_kd_tree_splits_the_longest_axis_at_the_median() -> None:
    grid = spread((6, 2, 2))
    grid.splats[0] = 1000
    assert kd_partition(grid, 2) == [(0, 0, 0, 1, 2, 2), (1, 0, 0, 6, 2, 2)]


def test_trees_stop_at_single_cuboids() -> None:
    assert len(kd_partition(spread((2, 2, 1)), 50)) == 4
    assert len(octree_partition(spread((2, 2, 1)), 50)) == 4
    empty = spread((2, 2, 2))
    empty.splats[:] = 0
    assert len(kd_partition(empty, 5)) == 1
    assert len(octree_partition(empty, 9)) == 1


def test_an_octree_splits_the_fullest_box_at_the_middle() -> None:
    grid = spread((4, 4, 4))
    assert len(octree_partition(grid, 7)) == 1
    eight = octree_partition(grid, 8)
    assert sorted(eight)[:2] == [(0, 0, 0, 2, 2, 2), (0, 0, 2, 2, 2, 4)]
    grid.splats[3, 3, 3] = 500
    more = octree_partition(grid, 15)
    assert len(more) == 15
    assert is_partition((4, 4, 4), more)
    assert (3, 3, 3, 4, 4, 4) in more


@pytest.mark.parametrize("seed", range(6))
def test_trees_of_random_grids_are_partitions(seed: int) -> None:
    shape = tuple(np.random.default_rng(seed).integers(1, 6, 3).tolist())
    grid = random_grid((shape[0], shape[1], shape[2]), seed)
    for cells in (1, 4, 11):
        for boxes in (kd_partition(grid, cells), octree_partition(grid, cells)):
            assert len(boxes) <= cells
            assert is_partition(shape, boxes)
