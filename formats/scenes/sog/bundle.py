"""The files of a SOG scene, in a ZIP bundle or in the folder of a ``meta.json``."""

from __future__ import annotations

import errno
import os
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from cogsplat.codec.errors import FormatError, LimitError, UnsupportedError
from cogsplat.formats.storage.atomic import (
    StrPath,
    atomic_write,
    exists,
    open_for_read,
    storage_errors,
)
from cogsplat.formats.storage.magic import describe
from cogsplat.formats.storage.parser_errors import parser_errors
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.zip_directory import open_zip

META_NAME: Final = "meta.json"

ZIP_MAGIC: Final = b"PK\x03\x04"

_HEAD_BYTES: Final = 64

# Limit on the inflated bytes of a bundle: this multiple of its size, plus a constant. WebP does not
# shrink in a ZIP and JSON is short, so a valid bundle inflates to little more than its size.
_MAX_RATIO: Final = 4
_FREE_BYTES: Final = 1 << 22

# A directory entry takes 46 bytes and its name, and a scene has eight files. The search for the
# directory reads the last 64 KiB twice.
_MAX_DIRECTORY_BYTES: Final = 1 << 18

# The earliest date of ZIP, so that equal scenes give equal bytes on any day.
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_UNIX: Final = 3


class SogFiles(ABC):
    """The files of one SOG scene, by their names in ``meta.json``."""

    def __init__(self) -> None:
        self._found: dict[str, bytes] = {}

    @property
    @abstractmethod
    def source_bytes(self) -> int:
        """Bytes in the file system: the size of the bundle, or of the files read so far."""

    @abstractmethod
    def _load(self, name: str, max_bytes: int) -> bytes:
        """Read a file for the first time."""

    def read(self, name: str, max_bytes: int) -> bytes:
        """Return the bytes of a file; repeated calls return a cached copy.

        Parameters
        ----------
        name : str
            Name of the file in ``meta.json``.
        max_bytes : int
            Limit on the file's size, bytes.

        Raises
        ------
        FormatError
            ``sog-missing-file``, ``sog-file-name``, ``sog-zip``.
        LimitError
            ``sog-file-too-large``; ``sog-zip-ratio``: the files of a bundle inflate to more than
            4 times its size.
        UnsupportedError
            ``sog-zip-method``.
        StorageError
            See `open_for_read`.
        """
        if name not in self._found:
            self._found[name] = self._load(name, max_bytes)
        return self._found[name]


@contextmanager
def open_files(path: StrPath, where: str) -> Iterator[SogFiles]:
    """Open a SOG bundle, or the folder of a ``meta.json``.

    Parameters
    ----------
    path : path
        The bundle or the ``meta.json``.
    where : str
        Name of the file for messages.

    Raises
    ------
    FormatError
        ``sog-magic``: the file is no bundle and no ``meta.json``; ``sog-zip``: a damaged bundle.
    LimitError
        ``sog-zip-directory``: the bundle's directory exceeds 256 KiB.
    StorageError
        See `open_for_read`.
    """
    with storage_errors(path), open_for_read(path) as file:
        head = file.read(_HEAD_BYTES)
        if not head.startswith(ZIP_MAGIC):
            if head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] != b"{":
                raise FormatError(
                    "sog-magic", f"{where}: is {describe(head)}, expected a SOG bundle or meta.json"
                )
            yield SogFolder(Path(path), where)
            return
        with _zip_errors(where):
            archive = open_zip(
                file,
                _MAX_DIRECTORY_BYTES,
                lambda found: LimitError(
                    "sog-zip-directory", f"{where}: {found}, expected the few files of a scene"
                ),
            )
        with archive:
            yield _SogBundle(archive, where, os.fstat(file.fileno()).st_size)


class SogFolder(SogFiles):
    """The files of a SOG scene in the folder of its ``meta.json``."""

    def __init__(self, meta: Path, where: str) -> None:
        super().__init__()
        self.meta = meta
        self.where = where

    @property
    def source_bytes(self) -> int:
        """Bytes of the files read so far."""
        return sum(map(len, self._found.values()))

    def path(self, name: str) -> Path:
        """Return the path of a file, or raise ``sog-file-name``."""
        if name == META_NAME:
            return self.meta
        return sibling(self.meta.parent, name, self.where, "sog-file-name")

    def _load(self, name: str, max_bytes: int) -> bytes:
        path = self.path(name)
        with storage_errors(path), open_for_read(path) as file:
            data = file.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise _too_large(f"{self.where}: {name!r}", f"more than {max_bytes}", max_bytes)
        return data


class _SogBundle(SogFiles):
    """The files of a SOG scene in a ZIP bundle."""

    def __init__(self, archive: zipfile.ZipFile, where: str, size: int) -> None:
        super().__init__()
        self.archive = archive
        self.where = where
        self.size = size

    @property
    def source_bytes(self) -> int:
        return self.size

    def _load(self, name: str, max_bytes: int) -> bytes:
        where = f"{self.where}: {name!r}"
        try:
            entry = self.archive.getinfo(name)
        except KeyError as error:
            names = ", ".join(map(repr, self.archive.namelist()[:12])) or "nothing"
            raise FormatError(
                "sog-missing-file", f"{where} is not in the ZIP, expected it next to {names}"
            ) from error
        if entry.flag_bits & 1 or entry.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise UnsupportedError(
                "sog-zip-method",
                f"{where} is encrypted or compressed by another method, expected "
                "it stored or deflated",
            )
        if entry.file_size > max_bytes:
            raise _too_large(where, str(entry.file_size), max_bytes)
        inflated = entry.file_size + sum(map(len, self._found.values()))
        if inflated > _MAX_RATIO * self.size + _FREE_BYTES:
            raise LimitError(
                "sog-zip-ratio",
                f"{where}: inflated bytes reach {inflated} in a bundle of {self.size} bytes, "
                f"expected at most {_MAX_RATIO} times its size",
            )
        with _zip_errors(where), self.archive.open(entry) as file:
            # Read one byte more, because the directory may understate the stream's length.
            data = file.read(entry.file_size + 1)
        if len(data) != entry.file_size:
            raise FormatError(
                "sog-zip", f"{where} has {len(data)} bytes, expected {entry.file_size}"
            )
        return data


def _too_large(where: str, found: str, max_bytes: int) -> LimitError:
    """Return the error about a file above its size limit."""
    return LimitError(
        "sog-file-too-large", f"{where} has {found} bytes, expected at most {max_bytes}"
    )


@contextmanager
def _zip_errors(where: str) -> Iterator[None]:
    """Turn exceptions of a damaged ZIP file into ``sog-zip``, as a context manager."""

    def refusal(found: str) -> FormatError:
        return FormatError("sog-zip", f"{where}: {found}, expected a whole ZIP file")

    try:
        with parser_errors(refusal, passed=(OSError,)):
            yield
    except OSError as error:
        # EINVAL is an offset outside the file: a damaged archive, not a file system error.
        if error.errno != errno.EINVAL:
            raise
        raise refusal(str(error)) from error


def write_bundle(file: BinaryIO, files: Mapping[str, bytes]) -> None:
    """Write files as an uncompressed ZIP; equal files give equal bytes."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.create_system = _UNIX
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)


def write_folder(meta: Path, files: Mapping[str, bytes], *, force: bool = False) -> None:
    """Write a SOG scene's files to one folder, ``meta.json`` last.

    If a write fails, the new files of this call are removed; replaced files are not restored.

    Parameters
    ----------
    meta : Path
        Path of ``meta.json``; other files go to its folder.
    files : mapping of str to bytes
        Contents by file name.
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    StorageError
        See `atomic_write`, e.g. ``exists``.
    """
    written: list[Path] = []
    paths = {name: meta.parent / name for name in files if name != META_NAME}
    paths[META_NAME] = meta
    try:
        for name, path in paths.items():
            is_new = not exists(path)
            with atomic_write(path, force) as file:
                file.write(files[name])
            if is_new:
                written.append(path)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise
