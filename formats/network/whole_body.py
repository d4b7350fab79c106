"""The bytes of a file whose server knows no ranges: kept as they come, from the first on."""

from __future__ import annotations

import tempfile
from typing import Final

# As much is kept in memory, the rest in a temporary file.
_IN_MEMORY: Final = 16 << 20


class WholeBody:
    """Bytes from the beginning of a file on, in memory and then in a temporary file.

    Used under its owner's lock.

    Attributes
    ----------
    received : int
        Bytes that have come.
    wanted : int
        Bytes that somebody has asked for; what comes later may wait.
    error : BaseException or None
        Why the rest does not come.
    is_complete : bool
        Whether all of the file is there.
    """

    def __init__(self) -> None:
        self.received = 0
        self.wanted = 0
        self.error: BaseException | None = None
        self.is_complete = False
        self._file = tempfile.SpooledTemporaryFile(_IN_MEMORY)  # noqa: SIM115 - see `close`

    def take(self, at: int, part: bytes) -> None:
        """Keep what is new of bytes that stand at `at` in the file."""
        new = part[max(0, self.received - at) :]
        self._file.seek(self.received)
        self._file.write(new)
        self.received += len(new)

    def bytes_at(self, first: int, end: int) -> bytes:
        """Return bytes that have come."""
        self._file.seek(first)
        return self._file.read(end - first)

    def close(self) -> None:
        """Give the memory and the temporary file back."""
        self._file.close()
