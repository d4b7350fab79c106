"""Byte counts in options: 65536, 64KiB, 1.5MB, or a share of a file such as 20%."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

_UNITS: Final = {
    "": 1,
    "b": 1,
    "kb": 1000,
    "mb": 1000**2,
    "gb": 1000**3,
    "kib": 1 << 10,
    "mib": 1 << 20,
    "gib": 1 << 30,
}
_BYTES: Final = re.compile(r"([0-9]{1,18}(?:\.[0-9]{1,9})?)\s*(%|[a-z]*)", re.IGNORECASE)


@dataclass(frozen=True)
class ByteCount:
    """Number of bytes, or share of a file's length.

    Parameters
    ----------
    amount : Fraction
        Number of bytes, or the share.
    is_share : bool
        Whether `amount` is a share of the file, 0 to 1.
    """

    amount: Fraction
    is_share: bool

    def of(self, file_bytes: int) -> int:
        """Return the number of bytes in a file of `file_bytes`, capped at its length."""
        return min(self.uncapped(file_bytes), file_bytes)

    def uncapped(self, file_bytes: int) -> int:
        """Return the number of bytes in a file of `file_bytes`, rounded down, without a cap."""
        return int(self.amount * file_bytes if self.is_share else self.amount)


def parse_byte_count(text: str) -> ByteCount:
    """Parse a number of bytes such as ``64KiB``, or a percentage of a file such as ``20%``.

    Raises
    ------
    ValueError
        The text has another form.

    Examples
    --------
    >>> parse_byte_count("1.5KiB").of(10_000), parse_byte_count("20%").of(10_000)
    (1536, 2000)
    """
    match = _BYTES.fullmatch(text.strip())
    unit = match[2].lower() if match else ""
    if match and unit == "%" and Fraction(match[1]) <= 100:
        return ByteCount(Fraction(match[1]) / 100, is_share=True)
    if match and unit in _UNITS:
        return ByteCount(Fraction(match[1]) * _UNITS[unit], is_share=False)
    raise ValueError(f"{text!r}, expected bytes such as 65536, 64KiB, 1.5MB or 20%")


def parse_bytes(text: str) -> int:
    """Parse a number of bytes such as ``65536``, ``64KiB`` or ``1.5MB``; refuse a percentage.

    Returns
    -------
    int
        Number of bytes, rounded down.

    Raises
    ------
    ValueError
        The text has another form, or is a share such as ``20%``.

    Examples
    --------
    >>> parse_bytes("1.5KiB")
    1536
    """
    found = parse_byte_count(text)
    if found.is_share:
        raise ValueError(f"{text!r}, expected bytes such as 65536, 64KiB or 1.5MB")
    return int(found.amount)
