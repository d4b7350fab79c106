"""Records of COLMAP's files: bytes off a file whose size is known, and lines of any length."""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

from cogsplat.codec.errors import FormatError, TruncatedError

COUNT = struct.Struct("<Q")
"""How many records follow."""

MAX_NAME_BYTES = 4096
"""Longest name that is read, and its zero byte."""

MAX_LINE_BYTES = 65536
"""Longest line of which more is read than its beginning."""

_BLOCK_BYTES = 1 << 16


class RecordReader:
    """Takes records off a file whose size is known, and never more than is there."""

    def __init__(self, file: BinaryIO, where: str) -> None:
        self.file = file
        self.where = where
        self.size = os.fstat(file.fileno()).st_size
        self.offset = 0
        # Records are short and many: they are cut from blocks, not read one by one.
        self._block = b""
        self._block_offset = 0

    def take(self, length: int, what: str) -> bytes:
        """Return the next bytes and go on behind them."""
        self.require(length, what)
        data = self._next(length)
        if len(data) != length:
            raise self.truncated(length, what)
        self.offset += length
        return data

    def _next(self, length: int) -> bytes:
        """Return the next bytes, fewer where the file ends, without going on."""
        at = self.offset - self._block_offset
        if at + length > len(self._block):
            self.file.seek(self.offset)
            self._block = self.file.read(max(length, _BLOCK_BYTES))
            self._block_offset = self.offset
            at = 0
        return self._block[at : at + length]

    def skip(self, length: int, what: str) -> None:
        """Go on behind the next bytes."""
        self.require(length, what)
        self.offset += length

    def require(self, length: int, what: str) -> None:
        """Refuse a file that ends before so many bytes more."""
        if length > self.size - self.offset:
            raise self.truncated(length, what)

    def truncated(self, length: int, what: str) -> TruncatedError:
        """Return the refusal of a file that ends before so many bytes more."""
        return TruncatedError(
            "colmap-truncated",
            f"{self.where}: {self.size} bytes, expected {length} more from byte {self.offset} on "
            f"for {what}",
            offset=self.offset,
            needed=self.offset + length,
        )

    def count(self, least_bytes: int, what: str) -> int:
        """Read a count of records that take at least so many bytes each."""
        count: int = COUNT.unpack(self.take(COUNT.size, f"the count of {what}"))[0]
        self.require(count * least_bytes, f"{count} {what}")
        return count

    def name(self, what: str) -> str:
        """Return a name that a zero byte ends."""
        data = self._next(min(MAX_NAME_BYTES, max(self.size - self.offset, 0)))
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

    def finish(self) -> None:
        """Refuse bytes behind the last record."""
        if self.offset != self.size:
            raise FormatError(
                "colmap-trailing-bytes",
                f"{self.where}: {self.size} bytes, expected {self.offset}",
                offset=self.offset,
            )


def skip_line(file: BinaryIO) -> None:
    """Read to the end of a line of any length, of which nothing is kept."""
    while (piece := file.readline(MAX_LINE_BYTES)) and not piece.endswith(b"\n"):
        pass
