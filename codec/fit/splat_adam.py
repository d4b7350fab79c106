"""Adam optimiser for the values of a scene (Kingma and Ba 2015), compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.errors import FormatError
from cogsplat.codec.render.jit import kernel
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .checkpoint_arrays import CheckpointArrays, checkpoint_count, checkpoint_splats
from .differentiable_rendering import Gradients

F32 = NDArray[np.float32]

BETA_1: Final = 0.9
"""Decay of the first moment, the moving average of gradients (Kingma and Ba 2015)."""

BETA_2: Final = 0.999
"""Decay of the second moment, the moving average of squared gradients (3DGS)."""

# Added to the root of the second moment before the division (3DGS).
_EPSILON: Final = 1e-15


@called_with(
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[::1], "
    "float64, float64, int64, int64"
)
@kernel
def _update_rows(
    values: F32,
    gradients: F32,
    means: F32,
    squares: F32,
    rates: F32,
    correction_1: float,
    correction_2: float,
    first: int,
    last: int,
) -> None:
    """Make one Adam step on the rows from `first` to `last`, with a learning rate per row."""
    keep, keep_square = np.float32(BETA_1), np.float32(BETA_2)
    take, take_square = np.float32(1.0 - BETA_1), np.float32(1.0 - BETA_2)
    epsilon = np.float32(_EPSILON)
    root = np.float32(1.0 / math.sqrt(correction_2))
    inverse = np.float32(1.0 / correction_1)
    for i in range(first, last):
        rate = rates[i] * inverse
        for k in range(values.shape[1]):
            g = gradients[i, k]
            mean = keep * means[i, k] + take * g
            square = keep_square * squares[i, k] + take_square * g * g
            means[i, k] = mean
            squares[i, k] = square
            values[i, k] -= rate * mean / (np.float32(math.sqrt(square)) * root + epsilon)


def _update_range(
    tables: Sequence[F32], rates: F32, corrections: tuple[float, float], rows: tuple[int, int]
) -> None:
    """Make one Adam step on a half-open range of rows."""
    values, gradients, means, squares = tables
    _update_rows(
        values, gradients, means, squares, rates, corrections[0], corrections[1], rows[0], rows[1]
    )


class SplatAdam:
    """Adam optimiser of one scene, with the moments of all its values.

    Parameters
    ----------
    splats : Splats
        Scene to train; only the shapes of its arrays are used.
    """

    def __init__(self, splats: Splats) -> None:
        self._means = Gradients.zeros(splats)
        self._squares = Gradients.zeros(splats)
        self._steps = 0

    def step(
        self, splats: Splats, gradients: Gradients, rates: Mapping[str, F32], threads: int = 1
    ) -> None:
        """Make one optimiser step on a scene, in place.

        Parameters
        ----------
        splats : Splats
            Scene in training, changed in place.
        gradients : Gradients
            Gradients of the loss.
        rates : mapping of str to (N,) float32
            Learning rate of each splat by array; arrays without one do not change.
        threads : int
            Number of threads; 0 uses all cores. The result does not depend on it.
        """
        self._steps += 1
        corrections = 1.0 - BETA_1**self._steps, 1.0 - BETA_2**self._steps
        rows = len(splats)
        threads = thread_count(threads)
        edges = np.linspace(0, rows, threads + 1).astype(np.int64).tolist()
        for name, rate in rates.items():
            arrays = (splats, gradients, self._means, self._squares)
            tables = [getattr(arrays_of, name).reshape(rows, -1) for arrays_of in arrays]
            if not tables[0].shape[1]:
                continue
            update = partial(_update_range, tables, rate, corrections)
            for _ in ordered_map(update, pairwise(edges), threads):
                pass

    def select(self, rows: NDArray[np.int64]) -> SplatAdam:
        """Return a new optimiser with the moments of the splats `rows`, in this order.

        A row may occur twice, as after a split. The number of steps is inherited.
        """
        selected = SplatAdam.__new__(SplatAdam)
        selected._steps = self._steps
        for part in ("_means", "_squares"):
            kept: Gradients = getattr(self, part)
            arrays = {name: getattr(kept, name)[rows].copy() for name in Gradients.names()}
            setattr(selected, part, Gradients(**arrays))
        return selected

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the checkpoint arrays of the optimiser by name."""
        arrays: dict[str, NDArray[np.generic]] = {"adam.steps": np.array(self._steps)}
        for part in ("_means", "_squares"):
            for name in Gradients.names():
                arrays[f"adam{part}.{name}"] = getattr(getattr(self, part), name)
        return arrays

    @classmethod
    def from_state(cls, state: CheckpointArrays, splats: Splats) -> SplatAdam:
        """Return the optimiser of a scene from the checkpoint arrays of `state`.

        Raises
        ------
        FormatError
            ``bad-checkpoint``: an array is missing, or has another shape or type.
        """
        adam = cls(splats)
        adam._steps = checkpoint_count(state, "adam.steps")
        for part in ("_means", "_squares"):
            moments = checkpoint_splats(state, f"adam{part}.", splats)
            if len(moments["opacities"]) != len(splats):
                raise FormatError(
                    "bad-checkpoint",
                    f"moments of {len(moments['opacities'])} splats, expected {len(splats)}",
                )
            setattr(adam, part, Gradients(**moments))
        return adam
