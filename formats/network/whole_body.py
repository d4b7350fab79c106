"""Buffer for a file from a server without range requests."""

from __future__ import annotations

import tempfile
from typing import Final

from cogsplat.formats.storage.atomic import storage_errors

# Bytes kept in memory; a longer body goes to a temporary file.
_IN_MEMORY: Final = 16 << 20

_NAME: Final = "temporary file of a download"


class WholeBody:
    """Received prefix of a file, in memory or, beyond 16 MiB, in a temporary file.

    Not thread-safe: the owner holds a lock.

    Attributes
    ----------
    received : int
        Bytes received so far.
    wanted : int
        Bytes from the beginning that readers have requested; the download may pause behind them.
    error : BaseException or None
        Error that ended the download.
    is_complete : bool
        Whether the whole file was received.
    """

    def __init__(self) -> None:
        self.received = 0
        self.wanted = 0
        self.error: BaseException | None = None
        self.is_complete = False
        self._file = tempfile.SpooledTemporaryFile(_IN_MEMORY)  # noqa: SIM115 - see `close`

    def receive(self, at: int, part: bytes, size: int | None) -> int:
        """Append the bytes of a part that were not received yet; parts leave no gaps.

        Parameters
        ----------
        at : int
            Offset of the part in the file, bytes.
        part : bytes
            Received bytes.
        size : int or None
            Length of the file, bytes, if known; bytes beyond it are dropped.

        Returns
        -------
        int
            Number of new bytes.

        Raises
        ------
        StorageError
            ``disk-full``, ``permission``, ``io``: the temporary file cannot be written.
        """
        new = part[max(0, self.received - at) : None if size is None else max(0, size - at)]
        with storage_errors(_NAME):
            self._file.seek(self.received)
            self._file.write(new)
        self.received += len(new)
        return len(new)

    def bytes_at(self, first: int, end: int) -> bytes:
        """Return received bytes from `first` up to `end`."""
        with storage_errors(_NAME):
            self._file.seek(first)
            return self._file.read(end - first)

    def close(self) -> None:
        """Free the memory and delete the temporary file."""
        self._file.close()
