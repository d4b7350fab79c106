"""ZIP files of unknown origin, opened without reading a directory of any size."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from typing import IO, BinaryIO, Final, cast

from cogsplat.codec.errors import CogsplatError

# Of the header before an entry's bytes, which its name and extra fields follow (APPNOTE 4.3.7).
_LOCAL_HEADER_BYTES: Final = 30


def open_zip(
    file: BinaryIO, most_bytes: int, refusal: Callable[[str], CogsplatError]
) -> zipfile.ZipFile:
    """Open a ZIP file for reading whose directory is no larger than it has to be.

    `zipfile` reads the whole directory at once and makes an object of about 600 bytes of each of
    its entries, of which a file of a megabyte may have 20,000.

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
    Exception
        Whatever `zipfile.ZipFile` raises for a damaged file.
    """
    rationed = _RationedFile(file, most_bytes, refusal)
    archive = zipfile.ZipFile(cast("BinaryIO", rationed))
    rationed.is_over = True
    return archive


def open_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> IO[bytes]:
    """Open an entry that does not reach into the next one, as newer versions of `zipfile` do.

    The bytes of one that does would be inflated once for each entry that claims them.

    Parameters
    ----------
    archive : zipfile.ZipFile
        Of `open_zip`.
    entry : zipfile.ZipInfo
        One of its directory.

    Returns
    -------
    IO of bytes
        What the entry inflates to, for the caller to close.

    Raises
    ------
    zipfile.BadZipFile
        The entry ends behind the start of another one, or of the directory.
    Exception
        Whatever `zipfile.ZipFile.open` raises for a damaged entry.
    """
    starts = [other.header_offset for other in archive.infolist()]
    end = min([at for at in starts if at > entry.header_offset], default=archive.start_dir)
    found = entry.header_offset + _LOCAL_HEADER_BYTES + entry.compress_size
    if found > end:
        raise zipfile.BadZipFile(f"an entry that ends at byte {found} or later, the next at {end}")
    return archive.open(entry)


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
