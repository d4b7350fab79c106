"""ZIP files of unknown origin, opened without reading a directory of any size."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from typing import BinaryIO, Final, cast

from cogsplat.codec.errors import CogsplatError

# Of the header before an entry's bytes, which its name and extra fields follow (APPNOTE 4.3.7).
_LOCAL_HEADER_BYTES: Final = 30


def open_zip(
    file: BinaryIO, most_bytes: int, refusal: Callable[[str], CogsplatError]
) -> zipfile.ZipFile:
    """Open a ZIP file for reading whose directory is no larger than it has to be and true.

    `zipfile` reads the whole directory at once and makes an object of about 600 bytes of each of
    its entries, of which a file of a megabyte may have 20,000. Whether entries overlap is checked
    by some versions of it only.

    Parameters
    ----------
    file : BinaryIO
        Open for reading; it can seek.
    most_bytes : int
        Of the directory, and of the 64 KiB in which its end is looked for, which are read twice.
        An entry takes 46 bytes and its name.
    refusal : callable
        Returns the error to raise for a larger one, given what was found.

    Raises
    ------
    CogsplatError
        That of `refusal`.
    zipfile.BadZipFile
        An entry reaches into another one or into the directory.
    Exception
        Whatever `zipfile.ZipFile` raises for a damaged file.
    """
    rationed = _RationedFile(file, most_bytes, refusal)
    archive = zipfile.ZipFile(cast("BinaryIO", rationed))
    rationed.is_over = True
    _check_extents(archive)
    return archive


def _check_extents(archive: zipfile.ZipFile) -> None:
    """Refuse entries that claim the same bytes, which would be inflated once for each of them."""
    entries = sorted(archive.infolist(), key=lambda entry: entry.header_offset)
    ends = [*(entry.header_offset for entry in entries[1:]), archive.start_dir]
    for entry, end in zip(entries, ends, strict=False):
        found = entry.header_offset + _LOCAL_HEADER_BYTES + entry.compress_size
        if found > end:
            raise zipfile.BadZipFile(
                f"an entry from byte {entry.header_offset} to {found} or later, the next at {end}"
            )


class _RationedFile:
    """A file that gives only so many bytes until the ration is over."""

    def __init__(
        self, file: BinaryIO, most_bytes: int, refusal: Callable[[str], CogsplatError]
    ) -> None:
        self._file = file
        self._most = most_bytes
        self._left = most_bytes
        self._refusal = refusal
        self.is_over = False
        self.seek = file.seek
        self.tell = file.tell
        self.seekable = file.seekable

    def read(self, size: int = -1) -> bytes:
        if self.is_over:
            return self._file.read(size)
        data = self._file.read(self._left + 1 if size < 0 else min(size, self._left + 1))
        if len(data) > self._left:
            raise self._refusal(f"a ZIP directory of more than {self._most} bytes")
        self._left -= len(data)
        return data
