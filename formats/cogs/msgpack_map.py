"""Typed access to the msgpack maps of a COGS file (SPEC 4.2, 4.3)."""

from __future__ import annotations

import math
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, UnsupportedError

from .canonical_msgpack import Value

_MAX_TEXT: Final = 255
_T = TypeVar("_T")


class CheckedMap:
    """Msgpack map whose methods remove one key each and check the type of its value.

    Parameters
    ----------
    value : Value
        Unpacked msgpack value.
    where : str
        Name of the map in messages.
    clause : str
        Clause of SPEC that defines the map.

    Raises
    ------
    FormatError
        ``root-type``, ``root-missing``, ``root-value`` or ``root-columns``, by the constructor and
        by every method.
    """

    def __init__(self, value: Value, where: str, clause: str) -> None:
        if not isinstance(value, dict):
            raise FormatError(
                "root-type", f"{where}: {type(value).__name__}, expected a map", clause=clause
            )
        self._value = dict(value)
        self._where = where
        self._clause = clause

    def error(self, key: str, message: str, code: str = "root-value") -> FormatError:
        """Return an error about the value of a key."""
        return FormatError(code, f"{self._where}, {key}: {message}", clause=self._clause)

    def has(self, key: str) -> bool:
        """Whether the map contains a key that was not yet removed by reading it."""
        return key in self._value

    def pop(self, key: str, kind: type[_T]) -> _T:
        """Remove a key and return its value, which must have the given type."""
        if key not in self._value:
            raise FormatError(
                "root-missing", f"{self._where}: no key {key!r}, expected one", clause=self._clause
            )
        value = self._value.pop(key)
        # In Python, bool is a subclass of int.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"{type(value).__name__}, expected {kind.__name__}", "root-type")
        return value

    def array(self, key: str, most: int, *, least: int = 0) -> list[Value]:
        """Remove a key and return its array of `least` to `most` values."""
        values = self.pop(key, list)
        if not least <= len(values) <= most:
            raise self.error(key, f"{len(values)} entries, expected {least} to {most}")
        return values

    def integer(self, key: str, low: int, high: int) -> int:
        """Remove a key and return its integer, from `low` to `high`."""
        value = self.pop(key, int)
        if not low <= value <= high:
            raise self.error(key, f"{value}, expected {low} to {high}")
        return value

    def text(self, key: str) -> str:
        """Remove a key and return its text, of at most 255 bytes."""
        value = self.pop(key, str)
        if len(value.encode()) > _MAX_TEXT:
            raise self.error(key, f"{len(value)} characters, expected at most {_MAX_TEXT} bytes")
        return value

    def word(self, key: str) -> str:
        """Remove a key and return its text of any length, which the caller looks up."""
        return self.pop(key, str)

    def number(self, key: str) -> float:
        """Remove a key and return its finite number."""
        value = self.pop(key, float)
        if not math.isfinite(value):
            raise self.error(key, f"{value}, expected a finite number")
        return value

    def positive(self, key: str) -> float:
        """Remove a key and return its finite number above 0."""
        value = self.number(key)
        if value <= 0:
            raise self.error(key, f"{value}, expected more than 0")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        """Remove a key and return its array of `count` finite numbers."""
        values = self.pop(key, list)
        if len(values) != count or not all(
            isinstance(v, float) and math.isfinite(v) for v in values
        ):
            raise self.error(key, f"expected {count} finite float64 numbers")
        return [float(v) for v in values if isinstance(v, float)]

    def column(self, key: str, dtype: str, rows: int | None, width: int = 1) -> NDArray[np.generic]:
        """Remove a key and return its column of numbers.

        Parameters
        ----------
        key : str
            Key of the column.
        dtype : str
            numpy type of the stored values.
        rows : int or None
            Required number of rows; None for any.
        width : int
            Values per row.

        Returns
        -------
        (r,) or (r, width) array
            One-dimensional for a width of 1.
        """
        data = self.pop(key, bytes)
        item = np.dtype(dtype).itemsize * width
        if len(data) % item or (rows is not None and len(data) != rows * item):
            expected = f"{rows} rows" if rows is not None else "whole rows"
            raise self.error(
                key, f"{len(data)} bytes, expected {expected} of {item}", "root-columns"
            )
        flat = np.frombuffer(data, dtype)
        return flat.reshape(-1, width) if width > 1 else flat

    def finish(self) -> dict[str, Value]:
        """Return the unknown keys that remain; refuse a key that ends in ``!`` (SPEC 4.3)."""
        for key in self._value:
            if key.endswith("!"):
                raise UnsupportedError(
                    "root-must-understand",
                    f"{self._where}: the key {key!r} is unknown and required (SPEC 4.3), expected "
                    "known ones; a newer cogsplat may read the file",
                )
        return self._value
