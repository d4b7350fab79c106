"""The ``Range`` header of a request (RFC 9110, 14)."""

from __future__ import annotations

import re
from typing import Final

# No file has a length of more digits than 19; Python refuses numbers of thousands.
_ONE_RANGE: Final = re.compile(r"bytes\s*=\s*(\d{0,19})\s*-\s*(\d{0,19})", re.ASCII | re.IGNORECASE)


class RangeNotSatisfiableError(ValueError):
    """A range begins behind the end of the file; the answer is status 416."""


def parse_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Return the bytes that a ``Range`` header asks for.

    Parameters
    ----------
    header : str or None
        Its value.
    size : int
        Of the file, bytes.

    Returns
    -------
    tuple of int, or None
        First byte and the end behind the last one. None where the whole file is to be sent: without
        a header, with one that is malformed or has another unit, and with several ranges, all of
        which RFC 9110 lets a server ignore.

    Raises
    ------
    RangeNotSatisfiableError
        No byte of the file is in the range.

    Examples
    --------
    >>> from cogsplat.tools.delivery.byte_range import parse_range
    >>> parse_range("bytes=0-65535", 100_000)
    (0, 65536)
    >>> parse_range("bytes=-10", 100_000)
    (99990, 100000)
    """
    match = _ONE_RANGE.fullmatch((header or "").strip())
    if match is None or not (match[1] or match[2]):
        return None
    if not match[1]:
        first, end = max(0, size - int(match[2])), size
    else:
        first, end = int(match[1]), min(size, int(match[2]) + 1 if match[2] else size)
        if match[2] and int(match[2]) < first:
            return None
    if first >= end:
        raise RangeNotSatisfiableError(f"{header} of {size} bytes")
    return first, end
