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


# Rows that are sorted in memory at a time where mapped rows change their order: 24 MB of the widest
# attribute, and at most 8,000 parts of a scene of a billion splats.
_ROWS_PER_PART: Final = 1 << 17


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
        if len(rows) and rows[-1] - rows[0] == len(rows) - 1 and bool((np.diff(rows) == 1).all()):
            out = np.array(values[rows[0] : rows[-1] + 1])
            self.trim()
            return out
        # Linux maps 64 KiB around each row that is read. Reading rows in the order of the file
        # lets one mapping serve many rows.
        out = np.empty((len(rows), *values.shape[1:]), values.dtype)
        ascending = np.argsort(rows, kind="stable")
        for start in range(0, len(rows), _ROWS_PER_TRIM):
            places = ascending[start : start + _ROWS_PER_TRIM]
            out[places] = values[rows[places]]
            self.trim()
        return out

    def take(self, splats: Splats, rows: NDArray[np.int64], gather: Gather | None = None) -> Splats:
        """Return a copy of the splats `rows`, read with `gather` or another function."""
        gather = gather or self.gather
        return replace(
            splats,
            means=gather(splats.means, rows),
            scales=gather(splats.scales, rows),
            quats=gather(splats.quats, rows),
            opacities=gather(splats.opacities, rows),
            sh0=gather(splats.sh0, rows),
            shN=gather(splats.shN, rows),
            extras={name: gather(values, rows) for name, values in splats.extras.items()},
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


class Rearrangement:
    """Copier of mapped arrays into another order of their rows, in two sequential passes.

    `Workspace.gather` reads a chunk of rows from all over an array: with pages of 64 KiB mapped for
    every row, the chunks of a scene of N splats together read its arrays N / 8,192 times.

    Parameters
    ----------
    workspace : Workspace
        Allocator of the copies.
    rows : (n,) int64
        Distinct numbers of the rows to copy, in their new order.
    """

    def __init__(self, workspace: Workspace, rows: NDArray[np.int64]) -> None:
        self._workspace = workspace
        self._rows = rows
        # Row numbers in ascending order, and the new place of each.
        places = np.full(int(rows.max(initial=-1)) + 1, -1, np.int64)
        places[rows] = np.arange(len(rows))
        self._ascending = np.flatnonzero(places >= 0)
        self._places = places[self._ascending]

    def gather(self, values: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of an array's rows in an array of the workspace.

        Parameters
        ----------
        values : (N, ...) array
            Array in memory or mapped from a file.
        rows : (n,) int64
            The rows of this rearrangement, for the type `Gather`.
        """
        n = len(rows)
        # Pass 1 distributes the rows, in ascending order, to the parts that they belong to.
        parts = self._workspace.zeros((n, *values.shape[1:]), values.dtype)
        filled = np.arange(0, n, _ROWS_PER_PART)
        for start in range(0, n, _ROWS_PER_PART):
            run = slice(start, start + _ROWS_PER_PART)
            part = self._places[run] // _ROWS_PER_PART
            by_part = np.argsort(part.astype(np.uint16), kind="stable")
            read = values[self._ascending[run]][by_part]
            taken = 0
            for number, count in enumerate(np.bincount(part).tolist()):
                to = int(filled[number])
                parts[to : to + count] = read[taken : taken + count]
                filled[number] += count
                taken += count
            self._workspace.trim()
        # Pass 2 sorts each part in memory.
        out = self._workspace.zeros(parts.shape, parts.dtype)
        for start in range(0, n, _ROWS_PER_PART):
            run = slice(start, start + _ROWS_PER_PART)
            ordered = np.empty_like(parts[run])
            ordered[np.argsort(rows[run])] = parts[run]
            out[run] = ordered
            self._workspace.trim()
        return out


IN_MEMORY: Final = Workspace()
"""Workspace that allocates in memory."""
