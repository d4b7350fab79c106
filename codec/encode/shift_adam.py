"""Adam over numpy arrays, for compensation shifts (Kingma and Ba 2015)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

BETA_1: Final = 0.85
"""Decay rate of the mean gradient."""

BETA_2: Final = 0.97
"""Decay rate of the mean squared gradient."""

EPSILON: Final = 1e-12
"""Term added to the root mean squared gradient before division."""


class ShiftAdam:
    """Adam state of one array: running moments of its gradient.

    Parameters
    ----------
    shape : tuple of int
        Shape of the array. Values along the last axis share a step count.
    rates : (c,) float64
        Learning rates along the last axis.
    """

    def __init__(self, shape: tuple[int, ...], rates: F64) -> None:
        self._rates = rates
        self._mean = np.zeros(shape)
        self._square = np.zeros(shape)
        self._count = np.zeros(shape[:-1])

    def step(self, part: slice | int, gradient: F64) -> F64:
        """Update the moments and return the step to subtract from a part of the array.

        Parameters
        ----------
        part : slice or int
            Part along the first axis.
        gradient : float64 array
            Gradient of that part.
        """
        self._count[part] += 1
        mean, square = self._mean[part], self._square[part]
        mean *= BETA_1
        mean += (1 - BETA_1) * gradient
        square *= BETA_2
        square += (1 - BETA_2) * gradient * gradient
        count = np.asarray(self._count[part])[..., None]
        size = np.sqrt(square / (1 - BETA_2**count)) + EPSILON
        moved: F64 = self._rates * (mean / (1 - BETA_1**count)) / size
        return moved
