"""Where arrays as long as a scene are kept: in memory, or wherever the caller has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .splats import SceneInfo, Splats, sh_coefficients

Zeros = Callable[[tuple[int, ...], DTypeLike], NDArray[Any]]
"""Returns a C-ordered array of zeros, from its shape and type."""


Gather = Callable[[NDArray[Any], NDArray[np.int64]], NDArray[Any]]
"""Returns some rows of an array, copied."""

Settle = Callable[[], None]
"""Called after a piece of work, such as a chunk: may give memory back."""


# Rows that are gathered between two calls of `settle`.
_GATHERED: Final = 512


def _nothing() -> None:
    pass


def _in_memory(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    return np.zeros(shape, dtype)


@dataclass(frozen=True, eq=False)
class Workspace:
    """How the arrays that are as long as a scene come about, and how many views are drawn at once.

    Results do not depend on it.

    Parameters
    ----------
    zeros : callable
        Returns an array of zeros. Arrays that hold a scene, its scores and what a reader decodes
        of it come from here: they may lie in a file that is mapped into memory.
    views_at_once : bool
        Whether several views are worked on at once, one on each core. Otherwise all cores work on
        one view, which takes less memory and a little more time.
    settle : callable
        Called after each chunk and each view.
    """

    zeros: Zeros = _in_memory
    views_at_once: bool = True
    settle: Settle = _nothing

    def gather(self, values: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
        """Return some rows of a long array, copied.

        Parameters
        ----------
        values : (N, ...) array
            Perhaps mapped.
        rows : (n,) int64
        """
        if self.views_at_once:
            return values[rows]
        # Each row may bring 64 KiB of its file into memory, as Linux maps what lies around it: in
        # the order of the file, what it brings serves the next rows.
        out = np.empty((len(rows), *values.shape[1:]), values.dtype)
        ascending = np.argsort(rows, kind="stable")
        for start in range(0, len(rows), _GATHERED):
            places = ascending[start : start + _GATHERED]
            out[places] = values[rows[places]]
            self.settle()
        return out

    def take(self, splats: Splats, rows: NDArray[np.int64]) -> Splats:
        """Return some rows of a scene, copied; of a mapped one with few pages in memory."""
        return replace(
            splats,
            means=self.gather(splats.means, rows),
            scales=self.gather(splats.scales, rows),
            quats=self.gather(splats.quats, rows),
            opacities=self.gather(splats.opacities, rows),
            sh0=self.gather(splats.sh0, rows),
            shN=self.gather(splats.shN, rows),
            extras={name: self.gather(values, rows) for name, values in splats.extras.items()},
        )

    def splats(self, rows: int, sh_degree: int, info: SceneInfo) -> Splats:
        """Return so many splats without extras, all their values zero, quaternions too.

        Parameters
        ----------
        rows : int
        sh_degree : int
            0 to 3.
        info : SceneInfo
        """
        return Splats(
            means=self.zeros((rows, 3), np.float32),
            scales=self.zeros((rows, 3), np.float32),
            quats=self.zeros((rows, 4), np.float32),
            opacities=self.zeros((rows,), np.float32),
            sh0=self.zeros((rows, 3), np.float32),
            shN=self.zeros((rows, sh_coefficients(sh_degree) - 1, 3), np.float32),
            info=info,
        )


IN_MEMORY: Final = Workspace()
"""Arrays in memory, several views at once."""
