"""Atomic file writes, and file-system errors as `StorageError`."""

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
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from cogsplat.codec.errors import StorageError

# Windows has no flock; stale temporaries are not removed there.
if sys.platform != "win32":
    import fcntl

StrPath = str | os.PathLike[str]

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_PERMISSION = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_NOT_FOUND = frozenset({errno.ENOENT, errno.ENOTDIR})
# Errors of file systems without hard links, such as FAT, and of systems that forbid hard links.
_NO_LINKS = frozenset({errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK})

# Bytes of the target's name in the name of its temporary, which has 42 more. File systems refuse
# names above 255 bytes, some encrypted ones above 143.
_MAX_STEM_BYTES = 64

# .<target>.<process>-<machine><random>.tmp
_TEMPORARY = re.compile(r"\..+\.([0-9]{1,10})-([0-9a-f]{8})[0-9a-f]{8}\.tmp")


class TargetExistsError(StorageError):
    """Error for an existing output without `force` (``exists``); misuse, so exit code 2.

    Parameters
    ----------
    path : path
        Output file.
    """

    exit_code = 2

    def __init__(self, path: StrPath) -> None:
        super().__init__(
            "exists",
            f"{os.fspath(path)}: exists already, expected a new name; force replaces the file",
        )


class OutputIsInputError(StorageError):
    """Error for an output that is also an input (``output-is-input``); misuse, so exit code 2.

    Parameters
    ----------
    path, source : path
        Output file and input file.
    """

    exit_code = 2

    def __init__(self, path: StrPath, source: StrPath) -> None:
        super().__init__(
            "output-is-input",
            f"{os.fspath(path)}: is the same file as the input {os.fspath(source)}, "
            "expected another one",
        )


def storage_error(error: OSError, path: StrPath) -> StorageError:
    """Convert an `OSError` into a `StorageError`.

    Its code is ``disk-full``, ``permission``, ``not-found``, ``not-a-file`` or ``io``.
    """
    where = error.filename
    # Messages name the output instead of its temporary.
    if not isinstance(where, str) or _TEMPORARY.fullmatch(Path(where).name):
        where = os.fspath(path)
    reason = error.strerror or str(error)
    if error.errno in _DISK_FULL:
        return StorageError("disk-full", f"{where}: {reason}, expected free disk space")
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


def require_regular(path: Path, mode: int) -> None:
    """Refuse a folder, device, pipe or socket, or a link that was not followed, by its mode bits.

    Raises
    ------
    StorageError
        ``not-a-file``.
    """
    if not stat.S_ISREG(mode):
        kind = "a device, pipe or socket"
        if stat.S_ISLNK(mode):
            kind = "a link"
        elif stat.S_ISDIR(mode):
            kind = "a folder"
        raise StorageError("not-a-file", f"{path}: is {kind}, expected a file")


def is_file(path: StrPath) -> bool:
    """Whether a path names a regular file, links followed; False where it cannot be examined.

    `Path.is_file` raises `OSError` for some paths, such as too long ones. The error with a reason
    code is that of opening them.
    """
    return _is_kind(path, stat.S_ISREG)


def is_folder(path: StrPath) -> bool:
    """Whether a path names a folder, links followed; False where it cannot be examined."""
    return _is_kind(path, stat.S_ISDIR)


def exists(path: StrPath) -> bool:
    """Whether a path names anything, links followed; False where it cannot be examined."""
    return _is_kind(path, lambda mode: True)


def _is_kind(path: StrPath, test: Callable[[int], bool]) -> bool:
    """Whether the mode bits of a path pass a test."""
    try:
        return test(Path(path).stat().st_mode)
    except (OSError, ValueError):
        return False


def open_for_read(path: StrPath) -> BufferedReader:
    """Open a regular file for buffered binary reading.

    Raises
    ------
    StorageError
        ``not-found``, ``not-a-file``, ``permission`` or ``io``.

    Notes
    -----
    Reads can fail later: wrap them in `storage_errors`.
    """
    with storage_errors(path):
        # Checked before opening, because opening a pipe blocks until its other end is open.
        require_regular(Path(path), Path(path).stat().st_mode)
        return Path(path).open("rb")


def check_output(path: StrPath, *, force: bool, inputs: Iterable[StrPath] = ()) -> None:
    """Check that an output can be written, before the work that produces it.

    Parameters
    ----------
    path : path
        Output file. The check creates and removes a temporary file in its folder.
    force : bool
        Whether an existing file may be replaced.
    inputs : iterable of path
        Input files, none of which may be the output, even with `force`. Symbolic links, hard links
        and names that differ in case are resolved.

    Raises
    ------
    OutputIsInputError
        ``output-is-input``. Exit code 2.
    TargetExistsError
        ``exists``: `path` exists and `force` is not set. Exit code 2.
    StorageError
        ``not-found``: the folder does not exist; ``permission``, also for a read-only file system;
        ``not-a-file``, ``disk-full`` or ``io``.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        # A process may have been killed between its rename and the removal of its temporary.
        _remove_stale(target.parent)
        mode = _mode_of(target)
        if mode is not None:
            require_regular(Path(path), mode)
            for source in inputs:
                if exists(source) and target.samefile(source):
                    raise OutputIsInputError(path, source)
            if not force:
                raise TargetExistsError(path)
        temporary, file = _create_temporary(target)
        file.close()
        # Unlocked since it was closed: another process may have removed it as stale.
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_write(
    path: StrPath, force: bool = False, *, durable: bool = True, follow_links: bool = True
) -> Iterator[BinaryIO]:
    """Open a temporary file that is renamed to `path` when the block ends without an error.

    Parameters
    ----------
    path : path
        Output file. The target of a symbolic link is replaced, not the link.
    force : bool
        Whether to replace an existing file; its permission bits are kept.
    durable : bool
        Whether to sync the bytes to disk before the rename. For thousands of files, one `sync_all`
        at the end is faster.
    follow_links : bool
        Whether `path` may be a symbolic link. Auxiliary files, such as those of a cache, refuse it.

    Yields
    ------
    BinaryIO
        Temporary file in the folder of `path`, buffered and seekable.

    Raises
    ------
    TargetExistsError
        ``exists``: `path` exists and `force` is not set. Exit code 2.
    StorageError
        ``disk-full``, ``permission``, ``not-found`` (the folder), ``not-a-file``, ``io``.

    Notes
    -----
    An error in the block, Ctrl-C included, removes the temporary file and keeps an existing `path`
    unchanged. With `durable`, bytes and rename are on disk on return. Of several writers without
    `force`, exactly one succeeds. The first write of a process to a folder removes temporaries that
    killed processes of this machine left there. Temporaries in use are locked (``flock``), also
    against other containers.
    """
    with storage_errors(path):
        target = Path(os.path.realpath(path))
        if not follow_links:
            target = Path(os.path.realpath(Path(path).parent), Path(path).name)
        old_mode = _mode_of(target)
        if old_mode is not None:
            require_regular(Path(path), old_mode)
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
            # Closed last, because its lock keeps other processes from removing the temporary.
            file.close()
        except BaseException:
            # Errors of the clean-up must not hide the error of the block.
            with contextlib.suppress(OSError):
                file.close()
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        if durable:
            _sync_folder(target.parent)


def sync_all(paths: Iterable[StrPath]) -> None:
    """Sync files that `atomic_write` wrote without `durable`, and their names, to disk.

    Parameters
    ----------
    paths : iterable of path
        Files to sync.

    Raises
    ------
    StorageError
        ``disk-full`` or ``io``.
    """
    if hasattr(os, "sync"):
        # One sync of all file systems is ten times faster than one per file for many files.
        os.sync()
        return
    for path in paths:
        # Windows syncs only files that are open for writing.
        with storage_errors(path), Path(path).open("r+b") as file:
            os.fsync(file.fileno())


def _create_temporary(target: Path) -> tuple[Path, BinaryIO]:
    """Create a temporary file in the folder of `target`, locked while it is open."""
    # Cut between characters, because some file systems refuse names that are not UTF-8.
    stem = os.fsencode(target.name)[:_MAX_STEM_BYTES].decode("utf-8", "ignore") or "output"
    while True:
        temporary = target.with_name(f".{stem}.{os.getpid()}-{host_digits()}{_token()}.tmp")
        # "x" fails for an existing name, so that two writers never share a file.
        file = temporary.open("xb")
        try:
            if lock(file) and _is_same_file(file, temporary):
                return temporary, file
        except BaseException:
            file.close()
            raise
        # Another process removed the file as stale before it was locked.
        file.close()


def lock(file: BinaryIO) -> bool:
    """Lock a file while it is open; return False if another process holds the lock."""
    # Without locks no temporary counts as stale, so that nobody else removes the file.
    return _try_lock(file) is not False


def is_abandoned(file: BinaryIO) -> bool:
    """Whether no process holds the lock of a file; False where files cannot be locked."""
    return _try_lock(file) is True


def _try_lock(file: BinaryIO) -> bool | None:
    """Lock a file; return False if another process holds the lock, None if there are no locks."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # A file system without locks.
        return None
    return True


def _is_same_file(file: BinaryIO, path: Path) -> bool:
    """Whether `path` still names the open file."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _move_to_new_name(temporary: Path, target: Path, path: StrPath) -> None:
    """Rename a temporary to `target`; raise `TargetExistsError` if the target exists."""
    try:
        if sys.platform == "win32":
            # On Windows, renaming fails for an existing name.
            temporary.rename(target)
            return
        try:
            os.link(temporary, target)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            # Reserve the name with an empty file, then replace that file.
            os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            temporary.replace(target)
            return
    except FileExistsError:
        raise TargetExistsError(path) from None
    temporary.unlink()


def _mode_of(path: Path) -> int | None:
    """Return the mode bits of a file or link, or None if it does not exist."""
    try:
        return path.lstat().st_mode
    except FileNotFoundError:
        return None


def host_digits() -> str:
    """Return 8 hex digits of this machine, because process numbers repeat across machines."""
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def _token() -> str:
    """Return 8 random hex digits."""
    return secrets.token_hex(4)


# Cached: writing thousands of files must not list their folder for each of them.
@functools.lru_cache(maxsize=256)
def _remove_stale(folder: Path) -> None:
    """Remove temporaries of ended processes from a folder, once per process."""
    # Windows has no lock that ends with its process and still lets others read.
    if sys.platform == "win32":
        return
    with os.scandir(folder) as entries:
        matches = [(entry.path, _TEMPORARY.fullmatch(entry.name)) for entry in entries]
    for name, match in matches:
        # Locks of other machines may be invisible on a shared volume.
        if match and match[2] == host_digits():
            _remove_unlocked(Path(name))


def _remove_unlocked(path: Path) -> None:
    """Remove a temporary that no process has locked.

    Process numbers do not identify its writer: containers on a shared volume all count from 1.
    """
    try:
        # Do not follow links, nor wait for the other end of a pipe.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        # Already removed, or owned by another user.
        return
    with os.fdopen(descriptor, "rb") as file:
        if is_abandoned(file) and stat.S_ISREG(os.fstat(descriptor).st_mode):
            # Another process may be removing the same file.
            path.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Sync the names in a folder to disk."""
    # Windows cannot open folders, and syncs renames by itself.
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Network and user-space file systems that cannot sync a folder return EINVAL.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)
