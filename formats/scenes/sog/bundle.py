"""Files of a SOG scene: in a ZIP bundle, or in the folder of a ``meta.json``."""

from __future__ import annotations

import errno
import os
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from cogsplat.codec.errors import CogsplatError, FormatError, LimitError, UnsupportedError
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.magic import describe
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.zip_directory import open_zip

META_NAME: Final = "meta.json"

ZIP_MAGIC: Final = b"PK\x03\x04"

_HEAD_BYTES: Final = 64

# WebP does not shrink in a ZIP and JSON is short, so that all files of a bundle together inflate to
# little more than it has bytes; what its directory says of that is not relied on.
_MAX_RATIO: Final = 4
_FREE_BYTES: Final = 1 << 22

# An entry takes 46 bytes and its name, and a scene has eight files. Where the directory lies is
# looked for in the last 64 KiB, which are read twice.
_MAX_DIRECTORY_BYTES: Final = 1 << 18

# The earliest date that ZIP can hold, so that a scene gives the same bytes on any day.
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_UNIX: Final = 3


class SogFiles(ABC):
    """The files of one scene, by the names that its ``meta.json`` gives them."""

    def __init__(self) -> None:
        self._found: dict[str, bytes] = {}

    @property
    @abstractmethod
    def source_bytes(self) -> int:
        """Bytes that lie in the file system: of the bundle, or of the files read by now."""

    @abstractmethod
    def _load(self, name: str, max_bytes: int) -> bytes:
        """Read a file for the first time."""

    def read(self, name: str, max_bytes: int) -> bytes:
        """Return a file's bytes, which are read once however often it is named.

        Raises
        ------
        FormatError
            ``sog-missing-file``, ``sog-file-name``, ``sog-zip``.
        LimitError
            ``sog-file-too-large``; ``sog-zip-ratio``: the files of a bundle inflate to far more
            bytes than it has.
        UnsupportedError
            ``sog-zip-method``.
        StorageError
            As `open_for_read`.
        """
        if name not in self._found:
            self._found[name] = self._load(name, max_bytes)
        return self._found[name]


@contextmanager
def open_files(path: StrPath, where: str) -> Iterator[SogFiles]:
    """Open a bundle, or the folder around a ``meta.json``.

    Raises
    ------
    FormatError
        ``sog-magic``: neither of the two; ``sog-zip``: a damaged bundle.
    LimitError
        ``sog-zip-directory``: a bundle of far more files than a scene has.
    StorageError
        As `open_for_read`.
    """
    with storage_errors(path), open_for_read(path) as file:
        head = file.read(_HEAD_BYTES)
        if not head.startswith(ZIP_MAGIC):
            if head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] != b"{":
                raise FormatError(
                    "sog-magic", f"{where}: is {describe(head)}, expected a SOG bundle or meta.json"
                )
            yield Folder(Path(path), where)
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
            yield _Bundle(archive, where, os.fstat(file.fileno()).st_size)


class Folder(SogFiles):
    """The folder around a ``meta.json``."""

    def __init__(self, meta: Path, where: str) -> None:
        super().__init__()
        self.meta = meta
        self.where = where

    @property
    def source_bytes(self) -> int:
        """Bytes of the files read by now."""
        return sum(map(len, self._found.values()))

    def path(self, name: str) -> Path:
        """Return where a file lies, or raise ``sog-file-name``."""
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


class _Bundle(SogFiles):
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
                "sog-missing-file", f"{where} is not in the ZIP, expected it beside {names}"
            ) from error
        if entry.flag_bits & 1 or entry.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise UnsupportedError(
                "sog-zip-method",
                f"{where} is encrypted or packed by a method of its own, expected "
                "it stored or deflated",
            )
        if entry.file_size > max_bytes:
            raise _too_large(where, str(entry.file_size), max_bytes)
        inflated = entry.file_size + sum(map(len, self._found.values()))
        if inflated > _MAX_RATIO * self.size + _FREE_BYTES:
            raise LimitError(
                "sog-zip-ratio",
                f"{where}: the files read up to it have {inflated} bytes in a bundle of "
                f"{self.size}, expected at most {_MAX_RATIO} times as many",
            )
        with _zip_errors(where), self.archive.open(entry) as file:
            # One byte more: the directory may understate what the stream holds.
            data = file.read(entry.file_size + 1)
        if len(data) != entry.file_size:
            raise FormatError(
                "sog-zip", f"{where} has {len(data)} bytes, expected {entry.file_size}"
            )
        return data


def _too_large(where: str, found: str, max_bytes: int) -> LimitError:
    return LimitError(
        "sog-file-too-large", f"{where} has {found} bytes, expected at most {max_bytes}"
    )


@contextmanager
def _zip_errors(where: str) -> Iterator[None]:
    try:
        yield
    except CogsplatError:
        raise
    except OSError as error:
        # A place outside the file is the archive's fault, anything else the file system's.
        if error.errno != errno.EINVAL:
            raise
        raise FormatError("sog-zip", f"{where}: {error}, expected a whole ZIP file") from error
    # A damaged archive makes zipfile and zlib raise almost anything.
    except Exception as error:
        raise FormatError(
            "sog-zip",
            f"{where}: {str(error)[:200] or type(error).__name__}, expected a whole ZIP file",
        ) from error


def write_bundle(file: BinaryIO, files: Mapping[str, bytes]) -> None:
    """Write files as a ZIP without compression; equal files give equal bytes."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.create_system = _UNIX
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)


def write_folder(meta: Path, files: Mapping[str, bytes], *, force: bool = False) -> None:
    """Write files beside each other, the one called ``meta.json`` last.

    Where a file cannot be written, those of this call that took no other file's place are removed.

    Parameters
    ----------
    meta : Path
        Where ``meta.json`` goes; the others go beside it.
    files : mapping of str to bytes
        By name.
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    StorageError
        As `atomic_write`, ``exists`` among them.
    """
    written: list[Path] = []
    paths = {name: meta.parent / name for name in files if name != META_NAME}
    paths[META_NAME] = meta
    try:
        for name, path in paths.items():
            is_new = not path.exists()
            with atomic_write(path, force) as file:
                file.write(files[name])
            if is_new:
                written.append(path)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise
