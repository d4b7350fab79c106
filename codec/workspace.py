"""Allocation of arrays with one row per splat: in memory, or in files mapped into memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .splats import SceneInfo, Splats, sh_coefficients

Zeros = Callable[[tuple[int, ...], DTypeLike], NDArray[Any]]
"""Function that returns a C-ordered array of zeros of a shape and a type."""


Gather = Callable[[NDArray[Any], NDArray[np.int64]], NDArray[Any]]
"""Function that returns a copy of an array's rows with the given numbers."""

Trim = Callable[[], None]
"""Function called after each chunk and view; it may release resident memory of mapped files."""


# Rows gathered from mapped files between two calls of `Workspace.trim`.
_ROWS_PER_TRIM: Final = 512


def _nothing() -> None:
    """Release nothing: arrays in memory need no trimming."""


def _in_memory(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return an array of zeros in memory."""
    return np.zeros(shape, dtype)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Allocator of arrays with one row per splat, in memory or in mapped files.

    Results do not depend on the workspace.

    Parameters
    ----------
    zeros : callable
        Allocator of arrays of zeros. It allocates scenes, their scores and decoded rows.
    in_files : bool
        Whether the arrays lie in files mapped into memory, because memory is scarce. Rows are then
        read in the order of the file, and only one view is processed at a time.
    trim : callable
        Function called after each chunk and each view; it may release resident memory.
    """

    zeros: Zeros = _in_memory
    in_files: bool = False
    trim: Trim = _nothing

    @property
    def views_at_once(self) -> bool:
        """Whether each core may process its own view; in files all cores share one view.

        Sharing takes less memory and slightly more time.
        """
        return not self.in_files

    def gather(self, values: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of an array's rows.

        Parameters
        ----------
        values : (N, ...) array
            Array in memory or mapped from a file.
        rows : (n,) int64
            Numbers of the rows.
        """
        if not self.in_files:
            return values[rows]
        # Linux maps 64 KiB around each row that is read. Reading rows in the order of the file
        # lets one mapping serve many rows.
        out = np.empty((len(rows), *values.shape[1:]), values.dtype)
        ascending = np.argsort(rows, kind="stable")
        for start in range(0, len(rows), _ROWS_PER_TRIM):
            places = ascending[start : start + _ROWS_PER_TRIM]
            out[places] = values[rows[places]]
            self.trim()
        return out

    def take(self, splats: Splats, rows: NDArray[np.int64]) -> Splats:
        """Return a copy of the splats `rows`, read with `gather`."""
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
        """Allocate splats without extras, all values zero, quaternions included.

        Parameters
        ----------
        rows : int
            Number of splats.
        sh_degree : int
            SH degree, 0 to 3.
        info : SceneInfo
            Metadata of the scene.
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
"""Workspace that allocates in memory."""
