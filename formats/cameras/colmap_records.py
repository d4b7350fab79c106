"""Low-level reading of COLMAP's files: binary records, and text lines of any length."""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

from cogsplat.codec.errors import FormatError, TruncatedError

COUNT = struct.Struct("<Q")
"""Number of the records that follow, a 64-bit integer."""

MAX_NAME_BYTES = 4096
"""Limit on an image's name, including its zero byte."""

MAX_LINE_BYTES = 65536
"""Limit on a line of text; the rest of a longer line of points is skipped."""

_BLOCK_BYTES = 1 << 16


class RecordReader:
    """Reader of binary records, which checks each length against the file's size first.

    Parameters
    ----------
    file : BinaryIO
        The open file.
    where : str
        Name of the file for messages.
    """

    def __init__(self, file: BinaryIO, where: str) -> None:
        self.file = file
        self.where = where
        self.size = os.fstat(file.fileno()).st_size
        self.offset = 0
        # Records are short and numerous, so the file is read in blocks.
        self._block = b""
        self._block_offset = 0

    def read(self, length: int, what: str) -> bytes:
        """Return the next `length` bytes; `what` names their content in messages."""
        self.require(length, what)
        data = self._peek(length)
        if len(data) != length:
            raise self.truncated(length, what)
        self.offset += length
        return data

    def _peek(self, length: int) -> bytes:
        """Return the next bytes without advancing; fewer than `length` at the end of the file."""
        at = self.offset - self._block_offset
        if at + length > len(self._block):
            self.file.seek(self.offset)
            self._block = self.file.read(max(length, _BLOCK_BYTES))
            self._block_offset = self.offset
            at = 0
        return self._block[at : at + length]

    def skip(self, length: int, what: str) -> None:
        """Skip the next `length` bytes."""
        self.require(length, what)
        self.offset += length

    def require(self, length: int, what: str) -> None:
        """Raise `TruncatedError` if fewer than `length` bytes remain."""
        if length > self.size - self.offset:
            raise self.truncated(length, what)

    def truncated(self, length: int, what: str) -> TruncatedError:
        """Return the error about a file in which fewer than `length` bytes remain."""
        return TruncatedError(
            "colmap-truncated",
            f"{self.where}: {self.size} bytes, expected {length} from byte {self.offset} for "
            f"{what}",
            offset=self.offset,
            needed=self.offset + length,
        )

    def read_count(self, min_bytes: int, what: str) -> int:
        """Read a number of records, and check it against the bytes left in the file.

        Parameters
        ----------
        min_bytes : int
            Smallest size of one record, bytes.
        what : str
            Plural noun of the records for messages.
        """
        count: int = COUNT.unpack(self.read(COUNT.size, f"the count of {what}"))[0]
        self.require(count * min_bytes, f"{count} {what}")
        return count

    def read_name(self, what: str) -> str:
        """Return the next zero-terminated name; `what` names its record in messages."""
        data = self._peek(min(MAX_NAME_BYTES, max(self.size - self.offset, 0)))
        end = data.find(b"\0")
        if end < 0 and len(data) < MAX_NAME_BYTES:
            raise self.truncated(len(data) + 1, f"the name of {what}")
        if end < 0:
            raise FormatError(
                "colmap-malformed",
                f"{self.where}: the name of {what} at byte {self.offset} is longer than "
                f"{MAX_NAME_BYTES - 1} bytes, expected a zero byte",
                offset=self.offset,
            )
        self.offset += end + 1
        return data[:end].decode("utf-8", "replace")

    def require_end(self) -> None:
        """Raise ``colmap-trailing-bytes`` if bytes remain."""
        if self.offset != self.size:
            raise FormatError(
                "colmap-trailing-bytes",
                f"{self.where}: {self.size} bytes, expected {self.offset}",
                offset=self.offset,
            )


def skip_line(file: BinaryIO) -> None:
    """Skip the rest of a line of any length."""
    while (piece := file.readline(MAX_LINE_BYTES)) and not piece.endswith(b"\n"):
        pass
