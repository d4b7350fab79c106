"""Content of a response: a file or bytes in memory, with size and ETag."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.formats.storage.atomic import open_for_read

# O_NONBLOCK: opening a pipe that replaced the file would wait for its other end. Windows lacks it.
_FLAGS: Final = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)

SendFile = Callable[[int, int, int], int]
"""Function that sends bytes of a file to a peer, as far as they can be sent without waiting.

It takes the descriptor, the first byte and the number of bytes, and returns the number sent."""


class ContentChangedError(OSError):
    """A file was replaced or truncated during a response, which then breaks off."""


@dataclass(frozen=True)
class Content:
    """Content of a response.

    A file is open during a read only, so that slow peers hold no descriptors.

    Parameters
    ----------
    source : Path or bytes
        The file, or the content itself.
    size : int
        Size, bytes.
    etag : str
        Strong ETag, which changes with the content.
    """

    source: Path | bytes
    size: int
    etag: str

    def read(self, first: int, end: int) -> bytes:
        """Return the bytes from `first` to `end`.

        Raises
        ------
        ContentChangedError
            The file is not the one of the ETag any more.
        OSError
            The file cannot be read.
        """
        if isinstance(self.source, bytes):
            return self.source[first:end]
        with self._opened() as descriptor:
            os.lseek(descriptor, first, os.SEEK_SET)
            block = os.read(descriptor, end - first)
        if len(block) != end - first:
            raise ContentChangedError(f"{self.source}: was truncated while it was sent")
        return block

    def send(self, send_file: SendFile, first: int, end: int) -> int:
        """Send bytes of a file with a function; return the number sent, 0 for content in memory.

        Raises
        ------
        ContentChangedError
            The file is not the one of the ETag any more.
        OSError
            The file cannot be read, or the peer is gone.
        """
        if isinstance(self.source, bytes):
            return 0
        with self._opened() as descriptor:
            return send_file(descriptor, first, end - first)

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """Open the file for a block, if it is still the one of the ETag."""
        # A fifth of the time of `open_for_read`, which prepares reading ahead.
        descriptor = os.open(self.source, _FLAGS)
        try:
            if _size_and_etag(descriptor) != (self.size, self.etag):
                raise ContentChangedError(f"{self.source!s}: was changed while it was sent")
            yield descriptor
        finally:
            os.close(descriptor)


def file_content(path: Path) -> Content:
    """Return the content of a file.

    Raises
    ------
    StorageError
        The file cannot be opened.
    """
    with open_for_read(path) as file:
        return Content(path, *_size_and_etag(file.fileno()))


def bytes_content(data: bytes) -> Content:
    """Return the content of bytes in memory."""
    return Content(data, len(data), f'"{hashlib.sha256(data).hexdigest()[:32]}"')


def _size_and_etag(descriptor: int) -> tuple[int, str]:
    """Return the size and ETag of an open file."""
    status = os.fstat(descriptor)
    etag = f'"{status.st_mtime_ns:x}-{status.st_size:x}-{status.st_ino:x}"'
    return status.st_size, etag
