"""The Adam optimiser over numpy arrays (Kingma and Ba 2015)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

MEMORY: Final = 0.85
"""What the running mean of gradients keeps of itself in a step."""

SQUARE_MEMORY: Final = 0.97
"""The same of the running mean of their squares."""

LEAST_SIZE: Final = 1e-12
"""Added to the size of gradients that steps are divided by."""


class Adam:
    """The steps of gradient descent on an array, from running moments of its gradient.

    Parameters
    ----------
    shape : tuple of int
        Of the array; all values along its last axis have one count of steps.
    rates : (c,) float64
        Learning rates along the last axis.
    """

    def __init__(self, shape: tuple[int, ...], rates: F64) -> None:
        self._rates = rates
        self._mean = np.zeros(shape)
        self._square = np.zeros(shape)
        self._count = np.zeros(shape[:-1])

    def step(self, part: slice | int, gradient: F64) -> F64:
        """Return what to subtract from a part of the array whose gradient is given."""
        self._count[part] += 1
        mean, square = self._mean[part], self._square[part]
        mean *= MEMORY
        mean += (1 - MEMORY) * gradient
        square *= SQUARE_MEMORY
        square += (1 - SQUARE_MEMORY) * gradient * gradient
        count = np.asarray(self._count[part])[..., None]
        size = np.sqrt(square / (1 - SQUARE_MEMORY**count)) + LEAST_SIZE
        moved: F64 = self._rates * (mean / (1 - MEMORY**count)) / size
        return moved
