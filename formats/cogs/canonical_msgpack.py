"""The msgpack subset of root, pages, cameras and compensation: canonical, shallow (SPEC 4.1)."""

from __future__ import annotations

import struct
from typing import Final

import msgpack

from cogsplat.codec.errors import FormatError, LimitError

Value = None | bool | int | float | str | bytes | list["Value"] | dict[str, "Value"]

MAX_DEPTH: Final = 8
"""Deepest nesting of maps and arrays, the outermost map counted (SPEC 4.1)."""

MAX_INTEGER: Final = (1 << 53) - 1
"""Largest magnitude of an integer: what a float64 and so a browser holds exactly (SPEC 4.1)."""

MAX_VALUES: Final = 4096
"""Most values of a map, keys and the maps and arrays themselves counted (SPEC 9.1)."""

VALUE_BYTES: Final = 64
"""What one value takes in memory, counted against a caller's limit (SPEC 9.2).

Measured in CPython 3.11: 24 to 32 bytes for a number, 49 and its characters for a str, 8 for the
place of either in a list.
"""

_FLOAT64: Final = struct.Struct(">d")

# Tag to bytes of the length behind it, and the least length that no shorter header holds.
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
    """Return the canonical encoding: shortest integers, float64, str keys in the given order."""
    packed: bytes = msgpack.packb(value, use_bin_type=True)
    return packed


def unpack(
    data: bytes, where: str, *, most_values: int = MAX_VALUES, allowed_bytes: int | None = None
) -> dict[str, Value]:
    """Return the map that `data` holds, or refuse it.

    Parameters
    ----------
    data : bytes
        Exactly one msgpack value.
    where : str
        Names the bytes in messages.
    most_values : int
        Values that the map may hold, itself and its keys counted.
    allowed_bytes : int, optional
        What the values may take in memory, `VALUE_BYTES` each; not limited by default.

    Raises
    ------
    FormatError
        ``msgpack-truncated``, ``msgpack-trailing``, ``msgpack-invalid``, ``msgpack-depth``,
        ``msgpack-count``, ``msgpack-duplicate-key``, ``msgpack-key``, ``msgpack-utf8``,
        ``msgpack-type``, ``msgpack-integer``, ``msgpack-canonical``; the first that a reading
        from front to back meets.
    LimitError
        ``decoded-size``: more than `allowed_bytes`.

    Notes
    -----
    Our own reader, because msgpack's allocates the lists that a nest of hostile headers claims
    before it misses their elements, and tells neither float32 nor long integers from short ones.
    """
    reader = _Reader(data, where, most_values, allowed_bytes)
    value = reader.value(0)
    if not isinstance(value, dict):
        raise reader.error("msgpack-type", f"{type(value).__name__}, expected a map")
    if reader.left:
        raise reader.error("msgpack-trailing", f"{reader.left} bytes behind the map, expected none")
    return value


class _Reader:
    """Reads values front to back; nothing is allocated for elements that are not there."""

    def __init__(
        self, data: bytes, where: str, most_values: int, allowed_bytes: int | None
    ) -> None:
        self._data = data
        self._where = where
        self._position = 0
        self._most = most_values
        self._allowed = allowed_bytes
        self._values = 1

    @property
    def left(self) -> int:
        """Bytes not read yet."""
        return len(self._data) - self._position

    def error(self, code: str, message: str) -> FormatError:
        return FormatError(
            code, f"{self._where}: {message}, at its byte {self._position}", clause="4.1"
        )

    def value(self, depth: int) -> Value:
        """Read one value inside `depth` maps and arrays."""
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
        if count > self.left:
            raise self.error("msgpack-truncated", f"{self.left} bytes left, expected {count}")
        self._position += count
        return self._data[self._position - count : self._position]

    def _unsigned(self, size: int) -> int:
        return int.from_bytes(self._bytes(size), "big")

    def _length(self, tag: int) -> int:
        size, shortest = _LENGTHS[tag]
        length = self._unsigned(size)
        if length < shortest:
            raise self.error("msgpack-canonical", f"length {length} in {size} bytes, too many")
        return length

    def _integer(self, tag: int) -> int:
        size = 1 << (tag & 3)
        value = self._unsigned(size)
        if tag < 0xD0:
            shorter = value < (0x80 if size == 1 else 1 << 4 * size)
        else:
            value -= 1 << 8 * size if value >> (8 * size - 1) else 0
            shorter = value >= (-0x20 if size == 1 else -(1 << (4 * size - 1)))
        if shorter:
            raise self.error("msgpack-canonical", f"integer {value} in {size} bytes, too many")
        if abs(value) > MAX_INTEGER:
            raise self.error("msgpack-integer", f"{value}, expected at most 2^53 - 1 either way")
        return value

    def _text(self, length: int) -> str:
        try:
            return self._bytes(length).decode("utf-8")
        except UnicodeDecodeError:
            raise self.error("msgpack-utf8", "a string that is not UTF-8") from None

    def _enter(self, values: int, depth: int) -> int:
        """Check what a map or an array states before its first value is read."""
        if depth == MAX_DEPTH:
            raise self.error("msgpack-depth", f"nested deeper than {MAX_DEPTH}")
        # Every value takes a byte at least.
        if values > self.left:
            raise self.error("msgpack-truncated", f"{self.left} bytes left for {values} values")
        self._values += values
        if self._values > self._most:
            raise self.error(
                "msgpack-count", f"{self._values} values, expected at most {self._most}"
            )
        if self._allowed is not None and self._values * VALUE_BYTES > self._allowed:
            raise LimitError(
                "decoded-size",
                f"{self._where}: {self._values} values, expected at most "
                f"{self._allowed // VALUE_BYTES} in {self._allowed} bytes (SPEC 9.2)",
            )
        return depth + 1

    def _array(self, length: int, depth: int) -> list[Value]:
        inside = self._enter(length, depth)
        return [self.value(inside) for _ in range(length)]

    def _map(self, length: int, depth: int) -> dict[str, Value]:
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
