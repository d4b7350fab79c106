"""Encoder and decoder for the canonical msgpack subset of COGS files (SPEC 4.1)."""

from __future__ import annotations

import struct
from typing import Final

import msgpack

from cogsplat.codec.errors import FormatError, LimitError

Value = None | bool | int | float | str | bytes | list["Value"] | dict[str, "Value"]

MAX_DEPTH: Final = 8
"""Maximum nesting depth of maps and arrays, the outermost map included (SPEC 4.1)."""

MAX_INTEGER: Final = (1 << 53) - 1
"""Maximum magnitude of an integer: exact in a float64, and so in a browser (SPEC 4.1)."""

MAX_VALUES: Final = 4096
"""Maximum number of values of a map, including keys, maps and arrays (SPEC 9.1)."""

VALUE_BYTES: Final = 64
"""Memory of one value, bytes, counted against a caller's limit (SPEC 9.2).

Measured in CPython 3.11: 24 to 32 bytes for a number, 49 and the characters for a str, 8 for an
entry of a list.
"""

_FLOAT64: Final = struct.Struct(">d")

# By tag: size of the length field, bytes, and the smallest length that needs a field of this size.
_LENGTHS: Final = {
    0xC4: (1, 0),
    0xC5: (2, 1 << 8),
    0xC6: (4, 1 << 16),
    0xD9: (1, 1 << 5),
    0xDA: (2, 1 << 8),
    0xDB: (4, 1 << 16),
    0xDC: (2, 1 << 4),
    0xDD: (4, 1 << 16),
    0xDE: (2, 1 << 4),
    0xDF: (4, 1 << 16),
}


def pack(value: dict[str, Value]) -> bytes:
    """Encode a map canonically: shortest integers, float64, str keys in the given order."""
    packed: bytes = msgpack.packb(value, use_bin_type=True)
    return packed


def unpack(
    data: bytes, where: str, *, max_values: int = MAX_VALUES, allowed_bytes: int | None = None
) -> dict[str, Value]:
    """Decode a map, and refuse non-canonical or oversized encodings.

    Parameters
    ----------
    data : bytes
        Encoding of exactly one map.
    where : str
        Name of the data in messages.
    max_values : int
        Maximum number of values, including the map itself and its keys.
    allowed_bytes : int, optional
        Memory limit of the values, bytes, at `VALUE_BYTES` each; by default none.

    Raises
    ------
    FormatError
        ``msgpack-truncated``, ``msgpack-trailing``, ``msgpack-invalid``, ``msgpack-depth``,
        ``msgpack-count``, ``msgpack-duplicate-key``, ``msgpack-key``, ``msgpack-utf8``,
        ``msgpack-type``, ``msgpack-integer``, ``msgpack-canonical``; the first fault from front to
        back.
    LimitError
        ``decoded-size``: the values exceed `allowed_bytes`.

    Notes
    -----
    The msgpack library is unsuitable for decoding: it allocates arrays of any length that a header
    claims, and hides whether an encoding was the shortest.
    """
    reader = _Reader(data, where, max_values, allowed_bytes)
    value = reader.value(0)
    if not isinstance(value, dict):
        raise reader.error("msgpack-type", f"{type(value).__name__}, expected a map")
    if reader.left:
        raise reader.error("msgpack-trailing", f"{reader.left} bytes behind the map, expected none")
    return value


class _Reader:
    """Decoder that reads values front to back and allocates nothing for missing elements."""

    def __init__(self, data: bytes, where: str, max_values: int, allowed_bytes: int | None) -> None:
        self._data = data
        self._where = where
        self._position = 0
        self._max_values = max_values
        self._allowed = allowed_bytes
        self._values = 1

    @property
    def left(self) -> int:
        """Number of unread bytes."""
        return len(self._data) - self._position

    def error(self, code: str, message: str) -> FormatError:
        """Return an error at the current position."""
        return FormatError(
            code, f"{self._where}: {message}, at its byte {self._position}", clause="4.1"
        )

    def value(self, depth: int) -> Value:
        """Read one value at a nesting depth."""
        tag = self._unsigned(1)
        if tag < 0x80:
            return tag
        if tag < 0x90:
            return self._map(tag & 0x0F, depth)
        if tag < 0xA0:
            return self._array(tag & 0x0F, depth)
        if tag < 0xC0:
            return self._text(tag & 0x1F)
        if tag >= 0xE0:
            return tag - 0x100
        match tag:
            case 0xC0:
                return None
            case 0xC2 | 0xC3:
                return tag == 0xC3
            case 0xC4 | 0xC5 | 0xC6:
                return self._bytes(self._length(tag))
            case 0xCB:
                number: float = _FLOAT64.unpack(self._bytes(8))[0]
                return number
            case 0xCC | 0xCD | 0xCE | 0xCF | 0xD0 | 0xD1 | 0xD2 | 0xD3:
                return self._integer(tag)
            case 0xD9 | 0xDA | 0xDB:
                return self._text(self._length(tag))
            case 0xDC | 0xDD:
                return self._array(self._length(tag), depth)
            case 0xDE | 0xDF:
                return self._map(self._length(tag), depth)
            case 0xCA:
                raise self.error("msgpack-canonical", "a float32, expected float64")
            case 0xC1:
                raise self.error("msgpack-invalid", "the reserved byte 0xc1, expected a value")
        raise self.error("msgpack-type", f"an extension (0x{tag:02x}), expected none")

    def _bytes(self, count: int) -> bytes:
        """Read `count` bytes."""
        if count > self.left:
            raise self.error("msgpack-truncated", f"{self.left} bytes left, expected {count}")
        self._position += count
        return self._data[self._position - count : self._position]

    def _unsigned(self, size: int) -> int:
        """Read an unsigned integer of `size` bytes."""
        return int.from_bytes(self._bytes(size), "big")

    def _length(self, tag: int) -> int:
        """Read the length of a text, byte string, array or map, in its shortest form."""
        size, shortest = _LENGTHS[tag]
        length = self._unsigned(size)
        if length < shortest:
            raise self.error(
                "msgpack-canonical", f"length {length} in {size} bytes, expected the shortest form"
            )
        return length

    def _integer(self, tag: int) -> int:
        """Read an integer in its shortest form."""
        size = 1 << (tag & 3)
        value = self._unsigned(size)
        if tag < 0xD0:
            shorter = value < (0x80 if size == 1 else 1 << 4 * size)
        else:
            value -= 1 << 8 * size if value >> (8 * size - 1) else 0
            shorter = value >= (-0x20 if size == 1 else -(1 << (4 * size - 1)))
        if shorter:
            raise self.error(
                "msgpack-canonical", f"integer {value} in {size} bytes, expected the shortest form"
            )
        if abs(value) > MAX_INTEGER:
            raise self.error("msgpack-integer", f"{value}, expected a magnitude up to 2^53 - 1")
        return value

    def _text(self, length: int) -> str:
        """Read a text of `length` bytes of UTF-8."""
        try:
            return self._bytes(length).decode("utf-8")
        except UnicodeDecodeError:
            raise self.error(
                "msgpack-utf8", "a string with invalid bytes, expected UTF-8"
            ) from None

    def _enter(self, values: int, depth: int) -> int:
        """Check depth and value count of a map or array; return the depth of its values."""
        if depth == MAX_DEPTH:
            raise self.error("msgpack-depth", f"a deeper nesting, expected at most {MAX_DEPTH}")
        # Every value takes at least one byte.
        if values > self.left:
            raise self.error(
                "msgpack-truncated", f"{self.left} bytes left, expected {values} for as many values"
            )
        self._values += values
        if self._values > self._max_values:
            raise self.error(
                "msgpack-count", f"{self._values} values, expected at most {self._max_values}"
            )
        if self._allowed is not None and self._values * VALUE_BYTES > self._allowed:
            raise LimitError(
                "decoded-size",
                f"{self._where}: {self._values} values, expected at most "
                f"{self._allowed // VALUE_BYTES} in {self._allowed} bytes (SPEC 9.2)",
            )
        return depth + 1

    def _array(self, length: int, depth: int) -> list[Value]:
        """Read the values of an array."""
        inside = self._enter(length, depth)
        return [self.value(inside) for _ in range(length)]

    def _map(self, length: int, depth: int) -> dict[str, Value]:
        """Read the keys and values of a map."""
        inside = self._enter(2 * length, depth)
        out: dict[str, Value] = {}
        for _ in range(length):
            key = self.value(inside)
            if not isinstance(key, str):
                raise self.error("msgpack-key", f"a key of {type(key).__name__}, expected str")
            if key in out:
                raise self.error("msgpack-duplicate-key", f"the key {key!r} twice, expected once")
            out[key] = self.value(inside)
        return out
