"""Transient failures of requests, progress, and exponential backoff before a retry."""

from __future__ import annotations

import random
import re
import time
from datetime import UTC
from email.utils import parsedate_to_datetime
from typing import Final

from cogsplat.codec.errors import StorageError

from .network_options import KIB, NetworkOptions

PROGRESS_BYTES: Final = 16 * KIB
"""New bytes of a request that count as progress. Fewer would let a server last for days."""

TRANSIENT_STATUSES: Final = frozenset({408, 425, 429, 500, 502, 503, 504})
"""HTTP statuses after which a retry may succeed (RFC 9110, RFC 6585)."""

_SECONDS: Final = re.compile(r"\d{1,9}", re.ASCII)


class TransientError(Exception):
    """Failure of a request that may succeed if it is retried.

    Parameters
    ----------
    code : str
        Reason code of the `StorageError` that is raised once retries are used up.
    message : str
        File, range and fault.
    wait_seconds : float
        Delay before a retry that the server asked for (``Retry-After``), seconds.
    """

    def __init__(self, code: str, message: str, wait_seconds: float = 0.0) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.wait_seconds = wait_seconds

    def as_storage_error(self, attempts: int) -> StorageError:
        """Return the error to raise after the last of `attempts` attempts."""
        times = "1 attempt" if attempts == 1 else f"{attempts} attempts"
        return StorageError(self.code, f"{self.message}; {times} without progress")


class Backoff:
    """Counter of failed attempts of one request, which gives the pause before the next attempt.

    Progress, 16 KiB of new bytes, sets the count of failed attempts to 0.

    Parameters
    ----------
    options : NetworkOptions
        Number of retries and lengths of pauses.
    """

    def __init__(self, options: NetworkOptions) -> None:
        self._options = options
        self._failed = 0
        self._new_bytes = 0
        self._random = options.random or random.random

    def add_bytes(self, count: int) -> bool:
        """Count new bytes of the request; return whether they complete progress."""
        self._new_bytes += count
        if self._new_bytes < PROGRESS_BYTES:
            return False
        self._new_bytes = 0
        self._failed = 0
        return True

    def pause_after(self, error: TransientError) -> float:
        """Count a failed attempt and return the pause before the next one, seconds.

        Raises
        ------
        StorageError
            Retries are used up, or the server asks for a wait beyond `longest_wait_seconds`.
        """
        options = self._options
        self._failed += 1
        if self._failed > options.retries or error.wait_seconds > options.longest_wait_seconds:
            raise error.as_storage_error(self._failed) from error
        doubled = options.pause_seconds * 2.0 ** (self._failed - 1)
        pause = min(options.longest_pause_seconds, doubled)
        return error.wait_seconds + pause / 2 + self._random() * pause / 2


def retry_after_seconds(retry_after: str | None, date: str | None) -> float:
    """Return the delay of a ``Retry-After`` header, seconds (RFC 9110, 10.2.3).

    Parameters
    ----------
    retry_after : str or None
        Value of the header: a number of seconds, or a date by the server's clock.
    date : str or None
        Value of the response's ``Date`` header; None takes the local clock.

    Returns
    -------
    float
        Delay; 0 where the header is missing or malformed.

    Examples
    --------
    >>> from cogsplat.formats.network.backoff import retry_after_seconds
    >>> retry_after_seconds("2", None)
    2.0
    >>> retry_after_seconds("Sun, 22 Nov 2026 07:00:05 GMT", "Sun, 22 Nov 2026 07:00:00 GMT")
    5.0
    """
    text = (retry_after or "").strip()
    if _SECONDS.fullmatch(text):
        return float(text)
    until = _timestamp(text)
    if until is None:
        return 0.0
    now = _timestamp(date or "") or time.time()
    return max(0.0, until - now)


def _timestamp(text: str) -> float | None:
    """Return the POSIX timestamp of an HTTP date, seconds; None where it is malformed."""
    try:
        found = parsedate_to_datetime(text)
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    except Exception:
        # Absurd dates and zones raise exceptions of many types in the standard library.
        return None
