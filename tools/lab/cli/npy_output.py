"""Write arrays as .npy files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogsplat.formats.storage.atomic import atomic_write


def write_npy(values: NDArray[Any], path: Path, *, force: bool) -> None:
    """Write an array as a .npy file, atomically.

    Parameters
    ----------
    values : array
        Array to write.
    path : Path
        Output file.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    StorageError
        The errors of `atomic_write`.
    """
    # The file is built in memory, because numpy's writing to files loses the reason of a failure.
    page = io.BytesIO()
    np.save(page, values)
    with atomic_write(path, force=force) as file:
        file.write(page.getbuffer())
