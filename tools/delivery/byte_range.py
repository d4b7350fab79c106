"""Parser of the ``Range`` header of a request (RFC 9110, 14)."""

from __future__ import annotations

import re
from typing import Final

# At most 19 digits, because Python rejects integers with thousands of digits.
_ONE_RANGE: Final = re.compile(r"bytes\s*=\s*(\d{0,19})\s*-\s*(\d{0,19})", re.ASCII | re.IGNORECASE)


class RangeNotSatisfiableError(ValueError):
    """A range begins behind the end of the file; the response is status 416."""


def parse_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Return the byte range requested by a ``Range`` header.

    Parameters
    ----------
    header : str or None
        Value of the header.
    size : int
        Size of the file, bytes.

    Returns
    -------
    tuple of int, or None
        First byte, and one past the last byte. None means the whole file: there is no header, or
        RFC 9110 lets a server ignore it (malformed, another unit, several ranges).

    Raises
    ------
    RangeNotSatisfiableError
        The range contains no byte of the file.

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
