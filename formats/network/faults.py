"""What goes wrong with requests: faults that pass, and pauses before asking again."""

from __future__ import annotations

import random
import re
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Final

from cogsplat.codec.errors import StorageError

from .options import NetworkOptions

PASSING_STATUSES: Final = frozenset({408, 425, 429, 500, 502, 503, 504})
"""Statuses after which the same request may succeed (RFC 9110, RFC 6585)."""

_SECONDS: Final = re.compile(r"\d{1,9}", re.ASCII)


class PassingFault(Exception):  # noqa: N818 - it becomes a `StorageError` where it does not pass
    """A request failed in a way that may pass: it is worth asking again.

    Parameters
    ----------
    code : str
        Reason code, where it does not pass.
    message : str
    wait_seconds : float
        What the server asked to wait for.
    """

    def __init__(self, code: str, message: str, wait_seconds: float = 0.0) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.wait_seconds = wait_seconds

    def lasting(self, attempts: int) -> StorageError:
        """Return the error that is raised when no more attempts are made."""
        times = "1 attempt" if attempts == 1 else f"{attempts} attempts"
        return StorageError(self.code, f"{self.message}; {times} without a new byte")


class Backoff:
    """Counts attempts without a new byte, and says how long to wait before the next.

    Parameters
    ----------
    options : NetworkOptions
    """

    def __init__(self, options: NetworkOptions) -> None:
        self._options = options
        self._failed = 0
        self._random = options.random or random.random

    def progressed(self) -> None:
        """Forget the failures so far: a byte came that had not come before."""
        self._failed = 0

    def pause_after(self, fault: PassingFault) -> float:
        """Return the seconds to wait before the next attempt.

        Raises
        ------
        StorageError
            There is none: the attempts are used up, or the server asks for too long a wait.
        """
        options = self._options
        self._failed += 1
        if self._failed > options.retries or fault.wait_seconds > options.longest_wait_seconds:
            raise fault.lasting(self._failed) from fault
        doubled = options.pause_seconds * 2.0 ** (self._failed - 1)
        pause = min(options.longest_pause_seconds, doubled)
        return fault.wait_seconds + pause / 2 + self._random() * pause / 2


def wait_asked_for(retry_after: str | None, date: str | None) -> float:
    """Return the wait that a server asks for, seconds (RFC 9110, 10.2.3).

    Parameters
    ----------
    retry_after : str or None
        A number of seconds or a date, by the server's own clock.
    date : str or None
        The answer's ``Date``.

    Returns
    -------
    float
        0 where the header is not there or says nothing that can be read.

    Examples
    --------
    >>> from cogsplat.formats.network.faults import wait_asked_for
    >>> wait_asked_for("2", None)
    2.0
    >>> wait_asked_for("Sun, 22 Nov 2026 07:00:05 GMT", "Sun, 22 Nov 2026 07:00:00 GMT")
    5.0
    """
    text = (retry_after or "").strip()
    if _SECONDS.fullmatch(text):
        return float(text)
    until = _date(text)
    if until is None:
        return 0.0
    now = _date(date or "") or datetime.now(UTC)
    return max(0.0, (until - now).total_seconds())


def _date(text: str) -> datetime | None:
    try:
        found = parsedate_to_datetime(text)
    except ValueError:
        return None
    return found if found.tzinfo else found.replace(tzinfo=UTC)
