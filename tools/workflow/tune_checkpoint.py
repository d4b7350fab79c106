"""Checkpoints of ``cogsplat tune``: all that a run needs to go on, in one file."""

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

_OF: Final = "of"
_ARRAYS: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")


def fingerprint(splats: Splats, settings: str) -> str:
    """Return what tells one run from another: SHA-256 of the scene and of all its settings."""
    digest = hashlib.sha256(settings.encode())
    for name in _ARRAYS:
        digest.update(np.ascontiguousarray(getattr(splats, name)).data)
    return digest.hexdigest()


def write_checkpoint(path: Path, of: str, state: Mapping[str, NDArray[np.generic]]) -> None:
    """Write a state beside what it is of; the file before it stays until this one is whole."""
    with atomic_write(path, force=True) as file:
        np.savez(file, **{_OF: np.array(of)}, **state)  # type: ignore[arg-type]


def read_checkpoint(path: Path, of: str) -> dict[str, NDArray[np.generic]]:
    """Read the state of a run.

    Raises
    ------
    FormatError
        ``bad-checkpoint``: it is no checkpoint, or not whole.
    DataError
        ``other-checkpoint``: of another scene, or of other settings.
    StorageError
        It cannot be read.
    """
    with open_for_read(path) as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                state = {name: archive[name] for name in archive.files}
            found = str(state.pop(_OF))
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise FormatError(
                "bad-checkpoint", f"{path}: {error}, expected a checkpoint of cogsplat tune"
            ) from error
    if found != of:
        raise DataError(
            "other-checkpoint",
            f"{path}: of another scene or of other options, expected those of this command",
        )
    return state
