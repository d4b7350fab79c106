"""Files written whole or not at all, and the failures of the file system as `StorageError`."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
import secrets
import socket
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from cogsplat.codec.errors import StorageError

StrPath = str | os.PathLike[str]

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_PERMISSION = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_NOT_FOUND = frozenset({errno.ENOENT, errno.ENOTDIR})

# .<target>.<process>-<machine><random>.tmp
_TEMPORARY = re.compile(r"\..+\.([0-9]{1,10})-([0-9a-f]{8})[0-9a-f]{8}\.tmp")


class TargetExistsError(StorageError):
    """The output is there already and was not to be replaced; a fault of usage, so exit code 2.

    Parameters
    ----------
    path : path
        The output; the reason code is ``exists``.
    """

    exit_code = 2

    def __init__(self, path: StrPath) -> None:
        super().__init__(
            "exists", f"{os.fspath(path)}: exists already, expected a new name (--force replaces)"
        )


def storage_error(error: OSError, path: StrPath) -> StorageError:
    """Return the `StorageError` that stands for an operating system's error.

    Its code is ``disk-full``, ``permission``, ``not-found``, ``not-a-file`` or ``io``.
    """
    where = error.filename
    # The name of a temporary says nothing to whoever asked for the output.
    if not isinstance(where, str) or _TEMPORARY.fullmatch(Path(where).name):
        where = os.fspath(path)
    reason = error.strerror or str(error)
    if error.errno in _DISK_FULL:
        return StorageError("disk-full", f"{where}: {reason}, expected room to write")
    if error.errno in _PERMISSION:
        return StorageError("permission", f"{where}: {reason}, expected access to it")
    if error.errno in _NOT_FOUND:
        return StorageError("not-found", f"{where}: {reason}, expected it to exist")
    if error.errno == errno.EISDIR:
        return StorageError("not-a-file", f"{where}: {reason}, expected a file")
    return StorageError("io", f"{where}: {reason}")


@contextmanager
def storage_errors(path: StrPath) -> Iterator[None]:
    """Turn every `OSError` of the block into a `StorageError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise storage_error(error, path) from error


def _require_regular(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a device, pipe or socket"
        raise StorageError("not-a-file", f"{path}: is {kind}, expected a file")


def open_for_read(path: StrPath) -> BufferedReader:
    """Open a regular file for reading bytes, buffered.

    Raises
    ------
    StorageError
        ``not-found``, ``not-a-file``, ``permission`` or ``io``.

    Notes
    -----
    Reads can fail later: wrap them in `storage_errors`.
    """
    with storage_errors(path):
        # Asked before opening, because opening a pipe waits for its other end.
        _require_regular(Path(path), Path(path).stat().st_mode)
        return Path(path).open("rb")


def refuse_existing(path: StrPath, *, force: bool) -> None:
    """Refuse an existing output before the work that would fill it.

    Raises
    ------
    TargetExistsError
        ``exists``: `path` is there and `force` is not set. Exit code 2.
    StorageError
        ``not-found`` where its folder is not there, ``permission``, ``not-a-file`` or ``io``.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        mode = _mode_of(target)
        if mode is None:
            target.parent.stat()
            return
        _require_regular(Path(path), mode)
        if not force:
            raise TargetExistsError(path)


@contextmanager
def atomic_write(path: StrPath, force: bool = False) -> Iterator[BinaryIO]:
    """Give a binary file that becomes `path` when the block ends well.

    Parameters
    ----------
    path : path
        The output. A symbolic link is followed: what it points to is replaced.
    force : bool
        Whether an existing file may be replaced; its permission bits are kept.

    Yields
    ------
    BinaryIO
        Buffered, seekable; a temporary sibling of `path` until the block ends.

    Raises
    ------
    TargetExistsError
        ``exists``: `path` is there and `force` is not set. Exit code 2.
    StorageError
        ``disk-full``, ``permission``, ``not-found`` (the folder), ``not-a-file``, ``io``.

    Notes
    -----
    Whatever leaves the block, Ctrl-C included, removes the temporary file and leaves an existing
    `path` as it was. The bytes are on disk before they get their name, and the name before this
    returns. Temporaries that killed processes of this machine left in the folder are removed when a
    process first writes there.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        old_mode = _mode_of(target)
        if old_mode is not None:
            _require_regular(Path(path), old_mode)
            if not force:
                raise TargetExistsError(path)
        _remove_stale(target.parent)
        temporary = target.with_name(f".{target.name}.{os.getpid()}-{_host()}{_token()}.tmp")
        # "x": a name that is taken fails, so that two writers never share a file.
        file = temporary.open("xb")
        try:
            yield file
            file.flush()
            if old_mode is not None:
                temporary.chmod(stat.S_IMODE(old_mode))
            os.fsync(file.fileno())
            file.close()
            # Asked again, because another process may have finished first.
            if not force and _mode_of(target) is not None:
                raise TargetExistsError(path)
            temporary.replace(target)
        except BaseException:
            # What failed first is what gets reported, not what fails while cleaning up after it.
            with contextlib.suppress(OSError):
                file.close()
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        _sync_folder(target.parent)


def _mode_of(path: Path) -> int | None:
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return None


def _host() -> str:
    """Return 8 hex digits for this machine: a process number means nothing on another one."""
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def _token() -> str:
    return secrets.token_hex(4)


# Once per folder and process: a layout of thousands of files must not list its folder for each.
@functools.lru_cache(maxsize=256)
def _remove_stale(folder: Path) -> None:
    # Windows has no harmless way to ask whether a process lives: os.kill would end it.
    if os.name != "posix":
        return
    with os.scandir(folder) as entries:
        matches = [(entry.path, _TEMPORARY.fullmatch(entry.name)) for entry in entries]
    for name, match in matches:
        if match and match[2] == _host() and not _is_alive(int(match[1])):
            # Another process may be clearing the same file.
            Path(name).unlink(missing_ok=True)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _sync_folder(folder: Path) -> None:
    # Windows cannot open folders, and syncs renames by itself.
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Network and user-space file systems that cannot sync a folder say EINVAL.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)
