"""Checkpoints of ``cogsplat tune``: files from which training resumes."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.atomic import atomic_write, open_for_read

_RUN: Final = "of"
_ARRAYS: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")


def fingerprint(splats: Splats, settings: str) -> str:
    """Return the identity of a run: SHA-256 of its scene and settings, in hexadecimal."""
    digest = hashlib.sha256(settings.encode())
    for name in _ARRAYS:
        digest.update(np.ascontiguousarray(getattr(splats, name)).data)
    return digest.hexdigest()


def write_checkpoint(path: Path, run: str, state: Mapping[str, NDArray[np.generic]]) -> None:
    """Write the training state of a run; an earlier file is replaced when the new one is complete.

    Parameters
    ----------
    path : Path
    run : str
        Identity of the run (`fingerprint`).
    state : mapping of str to ndarray
        Arrays by name.
    """
    with atomic_write(path, force=True) as file:
        np.savez(file, **{_RUN: np.array(run)}, **state)  # type: ignore[arg-type]


def read_checkpoint(path: Path, run: str) -> dict[str, NDArray[np.generic]]:
    """Read the training state of a run, arrays by name.

    Parameters
    ----------
    path : Path
    run : str
        Identity of the run (`fingerprint`).

    Raises
    ------
    FormatError
        ``bad-checkpoint``: the file is no checkpoint, or truncated.
    DataError
        ``other-checkpoint``: the checkpoint belongs to another scene or other settings.
    StorageError
        The file cannot be read.
    """
    with open_for_read(path) as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                state = {name: archive[name] for name in archive.files}
            found = str(state.pop(_RUN))
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise FormatError(
                "bad-checkpoint", f"{path}: {error}, expected a checkpoint of cogsplat tune"
            ) from error
    if found != run:
        raise DataError(
            "other-checkpoint",
            f"{path}: of another scene or other options, expected those of this command",
        )
    return state
