"""Untrusted ZIP files, opened with a limit on their directory."""

from __future__ import annotations

import errno
import os
import zipfile
from collections.abc import Callable
from typing import BinaryIO, Final, cast

from cogsplat.codec.errors import CogsplatError

# Bytes of the header of an entry, before its name and extra fields (APPNOTE 4.3.7).
_LOCAL_HEADER_BYTES: Final = 30


def open_zip(
    file: BinaryIO, max_bytes: int, refusal: Callable[[str], CogsplatError]
) -> zipfile.ZipFile:
    """Open a ZIP file for reading; refuse a large directory and overlapping entries.

    `zipfile` reads the whole directory at once and makes an object of about 600 bytes per entry. A
    file of a megabyte may have 20,000 entries. Only some versions of `zipfile` check for overlaps.

    Parameters
    ----------
    file : BinaryIO
        Seekable file open for reading.
    max_bytes : int
        Read limit for the directory, bytes. An entry takes 46 bytes and its name; the search for
        the directory's end reads the last 64 KiB of the file twice.
    refusal : callable
        Function that returns the error to raise for a larger directory, from a description.

    Raises
    ------
    CogsplatError
        The error of `refusal`.
    zipfile.BadZipFile
        Entries overlap each other or the directory.
    Exception
        Errors of `zipfile.ZipFile` for a damaged file.
    """
    limited = _LimitedFile(file, max_bytes, refusal)
    archive = zipfile.ZipFile(cast("BinaryIO", limited))
    limited.is_unlimited = True
    _check_overlaps(archive)
    return archive


def _check_overlaps(archive: zipfile.ZipFile) -> None:
    """Refuse overlapping entries, whose shared bytes would be inflated several times."""
    entries = sorted(archive.infolist(), key=lambda entry: entry.header_offset)
    ends = [*(entry.header_offset for entry in entries[1:]), archive.start_dir]
    for entry, end in zip(entries, ends, strict=False):
        found = entry.header_offset + _LOCAL_HEADER_BYTES + entry.compress_size
        if found > end:
            raise zipfile.BadZipFile(
                f"an entry from byte {entry.header_offset} to {found} or later, expected its end "
                f"at {end} or before, where the next one begins"
            )


class _LimitedFile:
    """File with a limit on the bytes read in total, until `is_unlimited` is set."""

    def __init__(
        self, file: BinaryIO, max_bytes: int, refusal: Callable[[str], CogsplatError]
    ) -> None:
        self._file = file
        self._max_bytes = max_bytes
        self._left = max_bytes
        self._refusal = refusal
        self.is_unlimited = False
        self.tell = file.tell
        self.seekable = file.seekable

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the reading position; raise `BadZipFile` for an offset that no file has."""
        try:
            return self._file.seek(offset, whence)
        except (OSError, ValueError, OverflowError) as error:
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            raise zipfile.BadZipFile(f"an offset of {offset}, expected one in the file") from error

    def read(self, size: int = -1) -> bytes:
        """Read at most `size` bytes; raise an error beyond the limit."""
        if self.is_unlimited:
            return self._file.read(size)
        data = self._file.read(self._left + 1 if size < 0 else min(size, self._left + 1))
        if len(data) > self._left:
            raise self._refusal(f"a ZIP directory of more than {self._max_bytes} bytes")
        self._left -= len(data)
        return data
