"""Adam over the stored values of a scene (Kingma and Ba 2015), compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.jit import kernel
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .differentiable_rendering import Gradients

F32 = NDArray[np.float32]

MEMORY: Final = 0.9
"""What the running mean of gradients keeps of itself in a step (Kingma and Ba 2015)."""

SQUARE_MEMORY: Final = 0.999
"""The same of the running mean of their squares (as 3DGS trains)."""

# Added to the size of gradients that steps are divided by (3DGS).
_LEAST_SIZE: Final = 1e-15


@called_with(
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1], "
    "float64, float64, int64, int64"
)
@kernel
def _move(
    values: F32,
    gradients: F32,
    means: F32,
    squares: F32,
    rates: F32,
    first_moment: float,
    second_moment: float,
    first: int,
    last: int,
) -> None:
    """Move the rows from `first` to `last` against their gradients, by a rate for each row."""
    keep, keep_square = np.float32(MEMORY), np.float32(SQUARE_MEMORY)
    take, take_square = np.float32(1.0 - MEMORY), np.float32(1.0 - SQUARE_MEMORY)
    least = np.float32(_LEAST_SIZE)
    root = np.float32(1.0 / math.sqrt(second_moment))
    inverse = np.float32(1.0 / first_moment)
    for i in range(first, last):
        rate = rates[i] * inverse
        for k in range(values.shape[1]):
            g = gradients[i, k]
            mean = keep * means[i, k] + take * g
            square = keep_square * squares[i, k] + take_square * g * g
            means[i, k] = mean
            squares[i, k] = square
            values[i, k] -= rate * mean / (np.float32(math.sqrt(square)) * root + least)


def _move_range(
    tables: Sequence[F32], rates: F32, moments: tuple[float, float], rows: tuple[int, int]
) -> None:
    values, gradients, means, squares = tables
    _move(values, gradients, means, squares, rates, moments[0], moments[1], rows[0], rows[1])


class SplatAdam:
    """The running moments of the gradients of one scene.

    Parameters
    ----------
    splats : Splats
        N of them.
    """

    def __init__(self, splats: Splats) -> None:
        self._means = Gradients.zeros(splats)
        self._squares = Gradients.zeros(splats)
        self._steps = 0

    def step(
        self, splats: Splats, gradients: Gradients, rates: Mapping[str, F32], threads: int = 1
    ) -> None:
        """Move the values of a scene against their gradients, in place.

        Parameters
        ----------
        splats : Splats
            Its arrays are written to.
        gradients : Gradients
        rates : mapping of str to (N,) float32
            Learning rate of each splat's values, by the names of the arrays that move.
        threads : int
            0 for every core this process may use. The result does not depend on it.
        """
        self._steps += 1
        moments = 1.0 - MEMORY**self._steps, 1.0 - SQUARE_MEMORY**self._steps
        rows = len(splats)
        threads = thread_count(threads)
        edges = np.linspace(0, rows, threads + 1).astype(np.int64).tolist()
        for name, rate in rates.items():
            arrays = (splats, gradients, self._means, self._squares)
            tables = [getattr(arrays_of, name).reshape(rows, -1) for arrays_of in arrays]
            if not tables[0].shape[1]:
                continue
            move = partial(_move_range, tables, rate, moments)
            for _ in ordered_map(move, pairwise(edges), threads):
                pass

    def take(self, rows: NDArray[np.int64]) -> SplatAdam:
        """Return the moments of some splats, for a scene of these alone."""
        taken = SplatAdam.__new__(SplatAdam)
        taken._steps = self._steps
        for part in ("_means", "_squares"):
            kept: Gradients = getattr(self, part)
            arrays = {name: getattr(kept, name)[rows].copy() for name in Gradients.names()}
            setattr(taken, part, Gradients(**arrays))
        return taken

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that `restored` needs, as arrays by name."""
        arrays: dict[str, NDArray[np.generic]] = {"adam.steps": np.array(self._steps)}
        for part in ("_means", "_squares"):
            for name in Gradients.names():
                arrays[f"adam{part}.{name}"] = getattr(getattr(self, part), name)
        return arrays

    @classmethod
    def from_state(cls, state: Mapping[str, NDArray[np.generic]]) -> SplatAdam:
        """Return the moments that `state` returned."""
        adam = cls.__new__(cls)
        adam._steps = int(state["adam.steps"])
        for part in ("_means", "_squares"):
            arrays = {
                name: np.array(state[f"adam{part}.{name}"], np.float32)
                for name in Gradients.names()
            }
            setattr(adam, part, Gradients(**arrays))
        return adam
