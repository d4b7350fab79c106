"""Comparison of partitions into cells: ratio of fetched to visible splats, and computing time.

Run ``python -m cogsplat.tools.lab.benchmark.partition_comparison scene.ply --cameras PATH``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.partitions.basic_cuboids import BasicCuboids, basic_cuboids
from cogsplat.tools.lab.partitions.box_costs import Box, BoxCosts, box_costs, waste
from cogsplat.tools.lab.partitions.cuboid_program import cheapest_partition
from cogsplat.tools.lab.partitions.grid_trees import kd_partition, octree_partition
from cogsplat.tools.lab.partitions.guillotine import cut_costs
from cogsplat.tools.terminal.options import json_option
from cogsplat.tools.terminal.output import print_json, print_line, print_table
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber


@dataclass(frozen=True)
class MethodResult:
    """Result of one partitioning method.

    Parameters
    ----------
    way : str
        Name of the method.
    cells : int
        Number of non-empty boxes.
    cost : float
        Cost by the measure of SGSS (`box_costs`).
    waste : float
        Ratio of fetched to visible splats, mean over the views.
    cpu_seconds : float
        Processor time of the method, without computing the costs.
    """

    way: str
    cells: int
    cost: float
    waste: float
    cpu_seconds: float


@dataclass(frozen=True)
class PartitionComparison:
    """Partitions of one scene by several methods.

    Parameters
    ----------
    shape : tuple of int
        Number of basic cuboids along each axis.
    filled : int
        Number of non-empty cuboids.
    bound : float
        Lower bound of the cost of any partition of the grid.
    whole_waste : float
        Ratio of fetched to visible splats with the whole scene as one cell.
    ways : list of MethodResult
        Integer program, guillotine cuts, and trees of the same number of cells.
    """

    shape: tuple[int, int, int]
    filled: int
    bound: float
    whole_waste: float
    ways: list[MethodResult]


def compare(
    splats: Splats, cameras: Sequence[Camera], cuboids: int, seconds: float = 60.0
) -> PartitionComparison:
    """Partition a scene into cells by four methods; compare the cells.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        Views of the scene, in the frame of the means.
    cuboids : int
        Maximum number of basic cuboids.
    seconds : float
        Time limit of the integer program.
    """
    grid = basic_cuboids(splats.means.astype(np.float64), cameras, cuboids)
    costs = box_costs(grid)
    began = time.process_time()
    solution = cheapest_partition(costs, seconds)
    ways = [_measured("ILP", grid, costs, solution.boxes, began)]
    finders: dict[str, Callable[[], list[Box]]] = {
        "straight cuts": lambda: cut_costs(costs).partition(),
        "k-d tree": lambda: kd_partition(grid, ways[0].cells),
        "octree": lambda: octree_partition(grid, ways[0].cells),
    }
    for name, find in finders.items():
        began = time.process_time()
        ways.append(_measured(name, grid, costs, find(), began))
    i, j, k = grid.splats.shape
    whole = waste(grid, [(0, 0, 0, i, j, k)])
    return PartitionComparison((i, j, k), int((grid.splats > 0).sum()), solution.bound, whole, ways)


def _measured(
    way: str, grid: BasicCuboids, costs: BoxCosts, boxes: list[Box], began: float
) -> MethodResult:
    """Return the result of a method that started at processor time `began` and ends now."""
    cpu_seconds = time.process_time() - began
    cells = sum(1 for box in boxes if costs.splats[costs.index(box)])
    return MethodResult(way, cells, costs.total(boxes), waste(grid, boxes), cpu_seconds)


@click.command()
@click.argument("scene", type=PATH)
@click.option("--cameras", type=PATH, required=True, help="Views of the scene.")
@click.option(
    "--cuboids",
    type=click.IntRange(1, 5000),
    default=300,
    show_default=True,
    help="Basic cuboids at most.",
)
@click.option(
    "--seconds",
    type=FiniteNumber(0.0, min_open=True),
    default=60.0,
    show_default=True,
    help="Time limit of the integer program.",
)
@json_option
def main(scene: Path, cameras: Path, cuboids: int, seconds: float, as_json: bool) -> None:
    """Compare partitions of SCENE into cells: fetched splats per visible splat, and time."""
    found = compare(cogsplat.read(scene), cogsplat.read_cameras(cameras), cuboids, seconds)
    if as_json:
        print_json(asdict(found))
        return
    i, j, k = found.shape
    print_line(
        f"{i} x {j} x {k} basic cuboids, {found.filled} of them not empty; "
        f"as one cell, fetched / visible is {found.whole_waste:.2f}"
    )
    rows = [
        (
            way.way,
            f"{way.cells}",
            f"{way.cost:.4f}",
            f"{way.waste:.3f}",
            f"{way.cpu_seconds:.3f}",
        )
        for way in found.ways
    ]
    print_table(("", "cells", "cost", "fetched / visible", "processor s"), rows)
    print_line(f"lower bound of the cost: {found.bound:.4f}")


if __name__ == "__main__":
    main()
