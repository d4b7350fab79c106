"""Auxiliary files, such as caches, logs and checkpoints: regular files, never through links."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, Final, cast

from cogsplat.codec.errors import StorageError

from .atomic import StrPath, require_regular, storage_errors

# Missing on Windows. O_NONBLOCK: opening a pipe would otherwise wait for its other end.
_NO_LINKS: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def open_regular(path: StrPath, mode: str = "rb", *, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file in a binary mode; refuse a link, folder, device or pipe.

    Parameters
    ----------
    path : path
        File. Links in the path of its folder are followed.
    mode : str
        ``rb``, ``r+b``, ``ab`` or ``a+b``; the last two create a missing file.
    max_bytes : int, optional
        Size limit of the file, bytes.

    Raises
    ------
    StorageError
        ``not-found``, ``not-a-file``, ``file-too-large``, ``permission`` or ``io``.

    Notes
    -----
    Reads and writes can fail later: wrap them in `storage_errors`.

    Examples
    --------
    >>> from cogsplat.formats.storage.regular_files import open_regular
    >>> with open_regular("scene.ply", max_bytes=1 << 30) as file:
    ...     file.read(3)
    b'ply'
    """
    if "b" not in mode or "w" in mode:
        # "w" would empty the file before its type is known.
        raise ValueError(f"mode {mode!r}, expected 'rb', 'r+b', 'ab' or 'a+b'")
    with storage_errors(path):
        try:
            status = Path(path).lstat()
        except FileNotFoundError:
            if not mode.startswith("a"):
                raise
        else:
            require_regular(Path(path), status.st_mode)
        # The caller closes it.
        file = cast("BinaryIO", open(path, mode, opener=_open_no_link))  # noqa: SIM115
        try:
            # Another process may have replaced the file since.
            status = os.fstat(file.fileno())
            require_regular(Path(path), status.st_mode)
            if max_bytes is not None and status.st_size > max_bytes:
                raise StorageError(
                    "file-too-large",
                    f"{os.fspath(path)}: {status.st_size} bytes, expected at most {max_bytes}",
                )
        except BaseException:
            file.close()
            raise
        return file


def read_regular(path: StrPath, max_bytes: int) -> bytes:
    """Return the bytes of a regular file of limited size; raises like `open_regular`.

    Parameters
    ----------
    path : path
        File.
    max_bytes : int
        Size limit of the file, bytes.
    """
    with open_regular(path, max_bytes=max_bytes) as file, storage_errors(path):
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise StorageError(
            "file-too-large",
            f"{os.fspath(path)}: grew while it was read, expected at most {max_bytes} bytes",
        )
    return data


def _open_no_link(path: str, flags: int) -> int:
    """Open a file, but neither through a symbolic link nor waiting for a pipe."""
    return os.open(path, flags | _NO_LINKS, 0o666)
