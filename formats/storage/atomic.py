"""Atomic writes of files, and errors of the file system as `StorageError`."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
import secrets
import socket
import stat
import sys
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from cogsplat.codec.errors import StorageError

# Not there on Windows, where nothing is cleared either.
if sys.platform != "win32":
    import fcntl

StrPath = str | os.PathLike[str]

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_PERMISSION = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_NOT_FOUND = frozenset({errno.ENOENT, errno.ENOTDIR})
# What file systems without hard links, such as FAT, and systems that forbid them say.
_NO_LINKS = frozenset({errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK})

# Of the target's name, at most so many bytes go into the temporary's: the rest takes 42, and names
# of more than 255 (on some encrypted file systems 143) bytes are refused.
_MAX_STEM_BYTES = 64

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
        super().__init__("exists", f"{os.fspath(path)}: exists already, expected a new name")


class OutputIsInputError(StorageError):
    """The output is a file that is read for it; a fault of usage, so exit code 2.

    Parameters
    ----------
    path, source : path
        The output and the input; the reason code is ``output-is-input``.
    """

    exit_code = 2

    def __init__(self, path: StrPath, source: StrPath) -> None:
        super().__init__(
            "output-is-input",
            f"{os.fspath(path)}: is the same file as the input {os.fspath(source)}, "
            "expected another one",
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


def check_output(path: StrPath, *, force: bool, inputs: Iterable[StrPath] = ()) -> None:
    """Refuse an output that could not be written, before the work that would fill it.

    Parameters
    ----------
    path : path
        The output. A file is created beside it and removed, to see that its folder takes one.
    force : bool
        Whether an existing file may be replaced.
    inputs : iterable of path
        Files that are read for it. The output may be none of them, whatever `force` says and
        by whatever name: links, hard links and names that differ in case are followed.

    Raises
    ------
    OutputIsInputError
        ``output-is-input``. Exit code 2.
    TargetExistsError
        ``exists``: `path` is there and `force` is not set. Exit code 2.
    StorageError
        ``not-found`` where its folder is not there; ``permission``, which a read-only file system
        gives as well; ``not-a-file``, ``disk-full`` or ``io``.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        mode = _mode_of(target)
        if mode is not None:
            _require_regular(Path(path), mode)
            for source in inputs:
                if Path(source).exists() and target.samefile(source):
                    raise OutputIsInputError(path, source)
            if not force:
                raise TargetExistsError(path)
        temporary, file = _create_temporary(target)
        file.close()
        temporary.unlink()


@contextmanager
def atomic_write(path: StrPath, force: bool = False, *, durable: bool = True) -> Iterator[BinaryIO]:
    """Give a binary file that becomes `path` when the block ends well.

    Parameters
    ----------
    path : path
        The output. A symbolic link is followed: what it points to is replaced.
    force : bool
        Whether an existing file may be replaced; its permission bits are kept.
    durable : bool
        Whether the bytes are on disk before they get their name. Of thousands of files, it is
        faster to call `sync_all` behind the last, before anything else names them.

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
    returns. Of several writers without `force`, exactly one succeeds. Temporaries that killed
    processes of this machine left in the folder are removed when a process first writes there;
    those of live processes are locked (``flock``), which other containers see as well.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        old_mode = _mode_of(target)
        if old_mode is not None:
            _require_regular(Path(path), old_mode)
            if not force:
                raise TargetExistsError(path)
        _remove_stale(target.parent)
        temporary, file = _create_temporary(target)
        try:
            yield file
            file.flush()
            if old_mode is not None:
                temporary.chmod(stat.S_IMODE(old_mode))
            if durable:
                os.fsync(file.fileno())
            if force:
                temporary.replace(target)
            else:
                _move_to_new_name(temporary, target, path)
            # Closed last, because its lock keeps other processes from clearing the temporary.
            file.close()
        except BaseException:
            # What failed first is what gets reported, not what fails while cleaning up after it.
            with contextlib.suppress(OSError):
                file.close()
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        if durable:
            _sync_folder(target.parent)


def sync_all(paths: Iterable[StrPath]) -> None:
    """Have files that were written without `durable` on disk when this returns, with their names.

    Raises
    ------
    StorageError
        ``disk-full`` or ``io``.
    """
    if hasattr(os, "sync"):
        # One call for all file systems: an order faster than one for each of many files.
        os.sync()
        return
    for path in paths:
        # Windows syncs only what is open for writing.
        with storage_errors(path), Path(path).open("r+b") as file:
            os.fsync(file.fileno())


def _create_temporary(target: Path) -> tuple[Path, BinaryIO]:
    """Create a sibling of `target`, locked as long as it is open."""
    # Cut between characters: some file systems refuse names that are no UTF-8.
    stem = os.fsencode(target.name)[:_MAX_STEM_BYTES].decode("utf-8", "ignore") or "output"
    while True:
        temporary = target.with_name(f".{stem}.{os.getpid()}-{_host()}{_token()}.tmp")
        # "x": a name that is taken fails, so that two writers never share a file.
        file = temporary.open("xb")
        try:
            if _lock(file) and _is_at(file, temporary):
                return temporary, file
        except BaseException:
            file.close()
            raise
        # Another process took it for a stale one before it was locked.
        file.close()


def _lock(file: BinaryIO) -> bool:
    """Lock a file for as long as it is open; say whether no other process has."""
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # A file system without locks: nothing there is ever taken for stale.
        return True
    return True


def _is_at(file: BinaryIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _move_to_new_name(temporary: Path, target: Path, path: StrPath) -> None:
    """Give a temporary its name, or raise `TargetExistsError` where another file has it."""
    try:
        if sys.platform == "win32":
            # There, renaming fails where the new name is taken.
            temporary.rename(target)
            return
        try:
            os.link(temporary, target)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            # The name is taken first, by an empty file, and then what belongs there put in place.
            os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            temporary.replace(target)
            return
    except FileExistsError:
        raise TargetExistsError(path) from None
    temporary.unlink()


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
    # Windows removes nothing here: it has no lock that ends with its process and lets others read.
    if sys.platform == "win32":
        return
    with os.scandir(folder) as entries:
        matches = [(entry.path, _TEMPORARY.fullmatch(entry.name)) for entry in entries]
    for name, match in matches:
        # Locks of other machines may be invisible on a shared volume.
        if match and match[2] == _host():
            _remove_unlocked(Path(name))


def _remove_unlocked(path: Path) -> None:
    """Remove a temporary whose writer is gone, which its lock tells: numbers of processes do not.

    Containers that share a volume count their processes each from 1.
    """
    try:
        # Not through a link, and without waiting for the other end of a pipe.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        # Gone by now, or another user's: whoever may remove it will.
        return
    with os.fdopen(descriptor, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            # Another process may be clearing the same file.
            path.unlink(missing_ok=True)


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
