"""Strict JSON parsing with a memory limit, and typed access to the values of an object."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import FormatError, LimitError

from .json_stream import refuse_constant
from .limits import Limits

_MAX_SHOWN: Final = 40


@dataclass(frozen=True)
class JsonObject:
    """JSON object with typed access to its values.

    A value of another type raises a `FormatError` with the file, the key and the expected type.

    Parameters
    ----------
    values : dict
        Parsed object.
    where : str
        File and place in the file, for messages.
    code : str
        Reason code of the errors.
    """

    values: dict[str, object]
    where: str
    code: str

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def number(self, key: str, default: float | None = None) -> float:
        """Return the finite number under a key, or `default` if the key is missing."""
        if key not in self.values and default is not None:
            return default
        return self._number(key, self.values.get(key))

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return the whole number under a key, from `low` to `high`; 3.0 counts as whole."""
        number = self.number(key, None if default is None else float(default))
        if not number.is_integer() or not low <= number <= high:
            raise self.wrong(key, f"a whole number from {low} to {high}")
        return int(number)

    def text(self, key: str, default: str | None = None) -> str:
        """Return the string under a key, or `default` if the key is missing."""
        value = self.values.get(key, default)
        if not isinstance(value, str):
            raise self.wrong(key, "a string")
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """Return the boolean under a key, or `default` if the key is missing."""
        value = self.values.get(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def child(self, key: str) -> JsonObject:
        """Return the object under a key."""
        value = self.values.get(key)
        if not isinstance(value, dict):
            raise self.wrong(key, "an object")
        return JsonObject(value, f"{self.where}, {key}", self.code)

    def children(self, key: str) -> list[JsonObject]:
        """Return the array of objects under a key; empty if the key is missing."""
        return [
            JsonObject(self._object(key, item), f"{self.where}, {key} {index}", self.code)
            for index, item in enumerate(self._array(key))
        ]

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        """Return the array of finite numbers under a key; `count` is its required length."""
        value = self.values.get(key)
        if not isinstance(value, list) or (count is not None and len(value) != count):
            raise self.wrong(key, f"an array of {'' if count is None else f'{count} '}numbers")
        return [self._number(key, item) for item in value]

    def texts(self, key: str, count: int | None = None) -> list[str]:
        """Return the array of strings under a key; `count` is its required length.

        A missing key counts as an empty array.
        """
        found = [item for item in self._array(key) if isinstance(item, str)]
        if len(found) != len(self._array(key)) or (count is not None and len(found) != count):
            raise self.wrong(key, f"an array of {'' if count is None else f'{count} '}strings")
        return found

    def integers(self, key: str, low: int, high: int) -> list[int]:
        """Return the array of whole numbers from `low` to `high` under a key, empty if missing."""
        found = []
        for item in self._array(key):
            number = self._number(key, item)
            if not number.is_integer() or not low <= number <= high:
                raise self.wrong(key, f"whole numbers from {low} to {high}")
            found.append(int(number))
        return found

    def wrong(self, key: str, expected: str) -> FormatError:
        """Return the error for a wrong or missing value under `key`."""
        found = f"is {_shown(self.values[key])}" if key in self.values else "is missing"
        return FormatError(self.code, f"{self.where}: {key!r} {found}, expected {expected}")

    def _array(self, key: str) -> list[object]:
        """Return the array under a key; empty if the key is missing."""
        value = self.values.get(key, [])
        if not isinstance(value, list):
            raise self.wrong(key, "an array")
        return value

    def _object(self, key: str, item: object) -> dict[str, object]:
        """Return an item of the array under a key, which must be an object."""
        if not isinstance(item, dict):
            raise self.wrong(key, "an array of objects")
        return item

    def _number(self, key: str, value: object) -> float:
        """Return a value under a key, which must be a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong(key, "numbers" if isinstance(value, list) else "a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.wrong(key, "a number that fits a double")
        return number


def parse_object(data: bytes, where: str, code: str, *, limits: Limits | None = None) -> JsonObject:
    """Parse JSON text whose outermost value is an object.

    Parameters
    ----------
    data : bytes
        UTF-8, with or without a byte order mark.
    where : str
        Name of the file for messages.
    code : str
        Reason code of every syntax error.
    limits : Limits, optional
        Limits; `Limits.small_bytes` caps the memory of the parsed objects.

    Raises
    ------
    LimitError
        ``json-too-long``.
    FormatError
        `code`: a syntax error, NaN, Infinity, or a value other than an object.
    """
    allowed = (limits or Limits()).small_bytes
    cost = _cost(data)
    if cost > allowed:
        raise LimitError(
            "json-too-long",
            f"{where}: {len(data)} bytes of JSON, up to {cost} bytes of memory when parsed, "
            f"expected at most {allowed}",
        )
    try:
        value: object = json.loads(
            data.removeprefix(b"\xef\xbb\xbf"), parse_constant=refuse_constant
        )
    # RecursionError: nested deeper than the parser goes.
    except (ValueError, RecursionError) as error:
        raise FormatError(code, f"{where}: {error}, expected a JSON object") from error
    if not isinstance(value, dict):
        raise FormatError(code, f"{where}: is {_shown(value)}, expected a JSON object")
    return JsonObject(value, where, code)


# Allocations of CPython 3.11 to 3.13, measured with tracemalloc and rounded up: a dictionary with
# its first key; each further key with its entry in the parser's key cache; a list with its first
# item; each further item with a number; a string without its characters.
_DICT_BYTES: Final = 264
_KEY_BYTES: Final = 256
_LIST_BYTES: Final = 120
_ITEM_BYTES: Final = 48
_QUOTE_BYTES: Final = 32
# The text and the strings cut from it, of one or four bytes a character.
_TEXT_COPIES: Final = 2
_WIDEST_CHARACTER: Final = 4


def _cost(data: bytes) -> int:
    """Return an estimate of the peak memory of parsing a text, bytes, without parsing it."""
    width = 1 if data.isascii() else _WIDEST_CHARACTER
    # An escape such as \ud83d makes an ASCII text a string of wide characters.
    if b"\\u" in data:
        width = _WIDEST_CHARACTER
    return (
        _DICT_BYTES * data.count(b"{")
        + _KEY_BYTES * data.count(b":")
        + _LIST_BYTES * data.count(b"[")
        + _ITEM_BYTES * data.count(b",")
        + _QUOTE_BYTES * data.count(b'"')
        + _TEXT_COPIES * width * len(data)
    )


def _shown(value: object) -> str:
    """Return a short text for a JSON value, for messages."""
    if isinstance(value, list):
        return f"an array of {len(value)}"
    if isinstance(value, dict):
        return "an object"
    text = json.dumps(value)
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + "..."
