"""Checkpoints of ``cogsplat tune``: files from which training resumes."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.formats.storage.npz import array_names, read_array
from cogsplat.formats.storage.parser_errors import parser_errors
from cogsplat.formats.storage.regular_files import FileKind, open_regular, replace_auxiliary
from cogsplat.formats.storage.zip_directory import open_zip

# First array of a checkpoint: the fingerprint of the run.
_RUN: Final = "cogsplat-checkpoint"
_ARRAYS: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")

CHECKPOINT: Final = FileKind(
    # The header of a ZIP entry has 30 bytes before its name (APPNOTE 4.3.7).
    "checkpoint of cogsplat tune",
    re.compile(rb"PK\x03\x04.{26}" + _RUN.encode() + rb"\.npy", re.DOTALL),
)
"""Kind of checkpoint files."""

# About a hundred arrays with entries of 100 bytes, and 64 KiB in which the directory's end is.
_MAX_DIRECTORY_BYTES: Final = 1 << 18

# 64 hexadecimal digits of 4 bytes.
_FINGERPRINT_BYTES: Final = 256


def fingerprint(splats: Splats, settings: str) -> str:
    """Return the identity of a run: SHA-256 of its scene and settings, in hexadecimal."""
    digest = hashlib.sha256(settings.encode())
    for name in _ARRAYS:
        digest.update(np.ascontiguousarray(getattr(splats, name)).data)
    return digest.hexdigest()


def write_checkpoint(path: Path, run: str, state: Mapping[str, NDArray[np.generic]]) -> None:
    """Write the training state of a run; an earlier checkpoint is replaced by the complete new one.

    Parameters
    ----------
    path : Path
    run : str
        Identity of the run (`fingerprint`).
    state : mapping of str to ndarray
        Arrays by name.

    Raises
    ------
    StorageError
        See `replace_auxiliary`, e.g. ``foreign-file``.
    """
    with replace_auxiliary(path, CHECKPOINT) as file:
        np.savez(file, **{_RUN: np.array(run)}, **state)  # type: ignore[arg-type]


def read_checkpoint(path: Path, run: str) -> dict[str, NDArray[np.generic]]:
    """Read the training state of a run, arrays by name.

    The fingerprint is read first. An array is read only if the size in its header matches its
    stored bytes, so that the size of the file bounds memory.

    Parameters
    ----------
    path : Path
    run : str
        Identity of the run (`fingerprint`).

    Raises
    ------
    FormatError
        ``bad-checkpoint``: the file is no checkpoint, or damaged.
    DataError
        ``other-checkpoint``: the checkpoint belongs to another scene or other settings.
    StorageError
        The file cannot be read, or is a link.
    """

    def refusal(found: str) -> FormatError:
        return FormatError(
            "bad-checkpoint", f"{path}: {found[:200]}, expected a checkpoint of cogsplat tune"
        )

    with (
        open_regular(path) as file,
        storage_errors(path),
        parser_errors(refusal, passed=(OSError,)),
        open_zip(file, _MAX_DIRECTORY_BYTES, refusal) as archive,
    ):
        found = str(read_array(archive, _RUN, _FINGERPRINT_BYTES))
        if found == run:
            return {
                name: read_array(archive, name) for name in array_names(archive) if name != _RUN
            }
    raise DataError(
        "other-checkpoint",
        f"{path}: of another scene or other options, expected those of this command",
    )
