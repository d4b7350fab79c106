"""The Adam optimiser over numpy arrays (Kingma and Ba 2015)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
_MEMORY: Final = 0.85
_SQUARE_MEMORY: Final = 0.97


class Adam:
    """Moments of an array's gradient, and the steps they make."""

    def __init__(self, shape: tuple[int, ...], rates: F64) -> None:
        self._rates = rates
        self._mean = np.zeros(shape)
        self._square = np.zeros(shape)
        self._count = np.zeros(shape[:-1])

    def step(self, part: slice | int, lagrangian: F64) -> F64:
        """Return what to subtract from a part of the array."""
        self._count[part] += 1
        mean, square = self._mean[part], self._square[part]
        mean *= _MEMORY
        mean += (1 - _MEMORY) * lagrangian
        square *= _SQUARE_MEMORY
        square += (1 - _SQUARE_MEMORY) * lagrangian * lagrangian
        count = np.asarray(self._count[part])[..., None]
        size = np.sqrt(square / (1 - _SQUARE_MEMORY**count)) + 1e-12
        moved: F64 = self._rates * (mean / (1 - _MEMORY**count)) / size
        return moved
