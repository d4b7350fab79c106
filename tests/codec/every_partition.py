"""Every partition of a small grid, and random grids to try them on."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from cogsplat.tools.lab.partitions.basic_cuboids import BasicCuboids
from cogsplat.tools.lab.partitions.box_costs import Box


def random_grid(shape: tuple[int, int, int], seed: int, views: int = 4) -> BasicCuboids:
    """Return a grid with some empty cuboids, and views that see parts of it."""
    rng = np.random.default_rng(seed)
    splats = rng.integers(0, 30, shape) * (rng.random(shape) < 0.8)
    seen = np.stack(
        [
            np.minimum(splats, rng.integers(0, 30, shape) * (rng.random(shape) < 0.5))
            for _ in range(views)
        ]
    )
    edges = tuple(np.linspace(0.0, float(n), n + 1) for n in shape)
    return BasicCuboids((edges[0], edges[1], edges[2]), splats, seen)


def every_partition(shape: tuple[int, int, int]) -> Iterator[list[Box]]:
    """Yield all partitions of a grid into boxes: the first free cuboid begins the next box."""

    def more(free: np.ndarray) -> Iterator[list[Box]]:
        places = np.argwhere(free)
        if not len(places):
            yield []
            return
        a, b, c = places[0].tolist()
        for d, e, f in product(
            range(a + 1, shape[0] + 1), range(b + 1, shape[1] + 1), range(c + 1, shape[2] + 1)
        ):
            if free[a:d, b:e, c:f].all():
                rest = free.copy()
                rest[a:d, b:e, c:f] = False
                for others in more(rest):
                    yield [(a, b, c, d, e, f), *others]

    yield from more(np.ones(shape, bool))


def is_partition(shape: tuple[int, ...], boxes: list[Box]) -> bool:
    """Return whether each cuboid of a grid lies in one box."""
    covered = np.zeros(shape, int)
    for a, b, c, d, e, f in boxes:
        covered[a:d, b:e, c:f] += 1
    return bool((covered == 1).all())
