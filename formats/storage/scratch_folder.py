"""Temporary folders; a later process removes the folder of a killed process."""

from __future__ import annotations

import functools
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from .atomic import host_digits, is_abandoned, lock, storage_errors

# cogsplat-<machine>-<random>
_NAME: Final = re.compile(r"cogsplat-([0-9a-f]{8})-[0-9a-f]{16}")

# Locked while the folder is in use, so that its process need not be known.
_LOCK_NAME: Final = ".lock"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Create a folder in the system's temporary folder and remove it after the block.

    The first scratch folder of a process removes those that killed processes of this user left on
    this machine: folders of this function's names whose lock nobody holds.

    Yields
    ------
    Path
        New, empty folder that only this user can read.

    Raises
    ------
    StorageError
        ``disk-full``, ``permission``, ``not-found`` or ``io``.
    """
    with storage_errors("temporary folder"):
        parent = Path(tempfile.gettempdir())
        _remove_stale(parent)
        folder, held = _create(parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        held.close()


def _create(parent: Path) -> tuple[Path, BinaryIO]:
    """Return a new folder, and its lock as an open file."""
    while True:
        folder = parent / f"cogsplat-{host_digits()}-{secrets.token_hex(8)}"
        folder.mkdir(mode=0o700)
        try:
            file = (folder / _LOCK_NAME).open("xb")
        except FileNotFoundError:
            # Another process removed the folder as stale before it was locked.
            continue
        if lock(file) and folder.exists():
            return folder, file
        file.close()


# Cached: a process looks once.
@functools.lru_cache(maxsize=8)
def _remove_stale(parent: Path) -> None:
    """Remove the folders of killed processes of this user and machine."""
    # Windows has no lock that ends with its process and still lets others read.
    if sys.platform == "win32":
        return
    with os.scandir(parent) as entries:
        for entry in entries:
            match = _NAME.fullmatch(entry.name)
            if not match or match[1] != host_digits():
                continue
            try:
                status = entry.stat(follow_symlinks=False)
            except FileNotFoundError:
                # Another process removed it since the folder was listed.
                continue
            if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid():
                _remove_unlocked(Path(entry.path))


def _remove_unlocked(folder: Path) -> None:
    """Remove a folder unless a process holds its lock."""
    try:
        descriptor = os.open(folder / _LOCK_NAME, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        # Killed before it was locked, or about to be locked: `_create` makes another one then.
        try:
            folder.rmdir()
        except OSError:
            # Locked or removed since.
            return
        return
    except OSError:
        return
    with os.fdopen(descriptor, "rb") as file:
        if is_abandoned(file):
            shutil.rmtree(folder, ignore_errors=True)
