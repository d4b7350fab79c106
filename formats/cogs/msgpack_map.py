"""Maps of a COGS file's msgpack: keys taken one by one, each with its type (SPEC 4.2, 4.3)."""

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
    """A map whose keys are taken one by one, each with its type.

    Parameters
    ----------
    value : Value
        What should be a map.
    where : str
        Names it in messages.
    clause : str
        Of SPEC, that says what it holds.

    Raises
    ------
    FormatError
        ``root-type``, ``root-missing``, ``root-value`` or ``root-columns``, by this and by every
        method.
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
        """Return an error about a key, to be raised."""
        return FormatError(code, f"{self._where}, {key}: {message}", clause=self._clause)

    def has(self, key: str) -> bool:
        """Tell whether a key is there and was not taken."""
        return key in self._value

    def take(self, key: str, kind: type[_T]) -> _T:
        """Return a value of a type; every other method takes by this one."""
        if key not in self._value:
            raise FormatError(
                "root-missing", f"{self._where}: no key {key!r}, expected one", clause=self._clause
            )
        value = self._value.pop(key)
        # bool is an int in Python, and never one here.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"{type(value).__name__}, expected {kind.__name__}", "root-type")
        return value

    def integer(self, key: str, low: int, high: int) -> int:
        """Return an integer from `low` to `high`."""
        value = self.take(key, int)
        if not low <= value <= high:
            raise self.error(key, f"{value}, expected {low} to {high}")
        return value

    def text(self, key: str) -> str:
        """Return a text of at most 255 bytes."""
        value = self.take(key, str)
        if len(value.encode()) > _MAX_TEXT:
            raise self.error(key, f"{len(value)} characters, expected at most {_MAX_TEXT} bytes")
        return value

    def word(self, key: str) -> str:
        """Return a text that the caller compares with those it knows, however long it is."""
        return self.take(key, str)

    def number(self, key: str) -> float:
        """Return a finite number."""
        value = self.take(key, float)
        if not math.isfinite(value):
            raise self.error(key, f"{value}, expected a finite number")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        """Return an array of so many finite numbers."""
        values = self.take(key, list)
        if len(values) != count or not all(
            isinstance(v, float) and math.isfinite(v) for v in values
        ):
            raise self.error(key, f"expected {count} finite float64 numbers")
        return [float(v) for v in values if isinstance(v, float)]

    def column(self, key: str, dtype: str, rows: int | None, width: int = 1) -> NDArray[np.generic]:
        """Return a column of `rows` rows, of any number for None: (r,), or (r, `width`)."""
        data = self.take(key, bytes)
        item = np.dtype(dtype).itemsize * width
        if len(data) % item or (rows is not None and len(data) != rows * item):
            expected = f"{rows} rows" if rows is not None else "whole rows"
            raise self.error(
                key, f"{len(data)} bytes, expected {expected} of {item}", "root-columns"
            )
        flat = np.frombuffer(data, dtype)
        return flat.reshape(-1, width) if width > 1 else flat

    def finish(self) -> None:
        """Refuse what must be understood and is not: unknown keys that end in ``!`` (SPEC 4.3)."""
        for key in self._value:
            if key.endswith("!"):
                raise UnsupportedError(
                    "root-must-understand",
                    f"{self._where}: the key {key!r} must be understood (SPEC 4.3)",
                )
