"""Auxiliary files, such as caches, logs and checkpoints: regular files, never through links.

An auxiliary file is appended to or replaced only if it is new, empty, or begins as its kind does.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, cast

from cogsplat.codec.errors import StorageError

from .atomic import (
    OutputIsInputError,
    StrPath,
    atomic_write,
    check_output,
    require_regular,
    storage_errors,
)

# Missing on Windows. O_NONBLOCK: opening a pipe would otherwise wait for its other end.
_NO_LINKS: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

# First bytes of a file that its kind is recognised by.
_HEAD_BYTES: Final = 256


@dataclass(frozen=True)
class FileKind:
    """Kind of an auxiliary file, recognised by its first bytes.

    Parameters
    ----------
    name : str
        Name for messages, such as ``log of cogsplat batch``.
    head : bytes pattern
        Matches the beginning of every file of this kind, in its first 256 bytes.
    """

    name: str
    head: re.Pattern[bytes]

    def require(self, file: BinaryIO, path: StrPath) -> None:
        """Refuse a file of another kind; an empty file may become one of this kind.

        Parameters
        ----------
        file : BinaryIO
            File open for reading, at its beginning.
        path : path
            Path for messages.

        Raises
        ------
        ForeignFileError
            ``foreign-file``. Exit code 2.
        """
        head = file.read(_HEAD_BYTES)
        if head and not self.head.match(head):
            raise ForeignFileError(path, self.name)


class ForeignFileError(StorageError):
    """Error for an auxiliary file that exists as a file of another kind (``foreign-file``).

    Parameters
    ----------
    path : path
        Auxiliary file.
    kind : str
        Kind of file that was expected.
    """

    exit_code = 2

    def __init__(self, path: StrPath, kind: str) -> None:
        super().__init__(
            "foreign-file",
            f"{os.fspath(path)}: exists already and is no {kind}, expected one or a new name",
        )


def file_identities(path: StrPath) -> tuple[object, ...]:
    """Return the identities of a file: two paths of one file have at least one in common.

    Returns
    -------
    tuple
        The path with its links followed, which a missing file has as well; device and number of an
        existing file, which its hard links share.
    """
    name = os.path.normcase(os.path.realpath(path))
    try:
        status = Path(path).stat()
    except OSError:
        return (name,)
    # Windows has no numbers on some file systems.
    return (name, (status.st_dev, status.st_ino)) if status.st_ino else (name,)


def check_auxiliary(path: StrPath, kind: FileKind, *, inputs: Iterable[StrPath] = ()) -> None:
    """Check that an auxiliary file can be written, before the work that writes it.

    Parameters
    ----------
    path : path
        Auxiliary file. The check creates and removes a temporary file in its folder.
    kind : FileKind
        Kind of the file.
    inputs : iterable of path
        Input files, none of which may be the auxiliary file.

    Raises
    ------
    OutputIsInputError
        ``output-is-input``. Exit code 2.
    ForeignFileError
        ``foreign-file``: the file exists and is of another kind. Exit code 2.
    StorageError
        ``not-a-file``, also for a link; ``not-found`` for the folder; ``permission``,
        ``disk-full`` or ``io``.
    """
    identities = set(file_identities(path))
    for source in inputs:
        if not identities.isdisjoint(file_identities(source)):
            raise OutputIsInputError(path, source)
    _require_kind(path, kind)
    check_output(path, force=True)


@contextmanager
def replace_auxiliary(path: StrPath, kind: FileKind) -> Iterator[BinaryIO]:
    """Write an auxiliary file under a temporary name, then rename it, as `atomic_write` does.

    Raises
    ------
    StorageError
        See `check_auxiliary`.
    """
    # Checked again: hours may have passed since the start of the command.
    _require_kind(path, kind)
    with atomic_write(path, force=True, follow_links=False) as file:
        yield file


def _require_kind(path: StrPath, kind: FileKind) -> None:
    """Refuse a link, folder or device, and a file of another kind; accept a missing file."""
    if not os.path.lexists(path):
        return
    with open_regular(path) as file, storage_errors(path):
        kind.require(file, path)


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
    """Open a file; refuse symbolic links, and open pipes without blocking."""
    return os.open(path, flags | _NO_LINKS, 0o666)
