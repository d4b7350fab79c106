"""The msgpack subset of root and index pages: canonical, shallow, no key twice (SPEC 4)."""

from __future__ import annotations

from typing import Final

import msgpack

from cogsplat.codec.errors import FormatError

Value = None | bool | int | float | str | bytes | list["Value"] | dict[str, "Value"]

MAX_DEPTH: Final = 8
"""Deepest nesting of maps and arrays (SPEC 4.1)."""


def pack(value: dict[str, Value]) -> bytes:
    """Return the canonical encoding: shortest integers, float64, str keys in the given order."""
    packed: bytes = msgpack.packb(value, use_bin_type=True)
    return packed


def unpack(data: bytes, where: str) -> dict[str, Value]:
    """Return the map that `data` holds, or refuse it.

    Parameters
    ----------
    data : bytes
        Exactly one msgpack value.
    where : str
        Names the bytes in messages.

    Raises
    ------
    FormatError
        ``msgpack-truncated``, ``msgpack-trailing``, ``msgpack-invalid``, ``msgpack-depth``,
        ``msgpack-duplicate-key``, ``msgpack-key``, ``msgpack-utf8``, ``msgpack-type``,
        ``msgpack-canonical``.
    """
    limit = len(data)
    try:
        value = msgpack.unpackb(
            data,
            raw=False,
            strict_map_key=False,
            object_pairs_hook=_pairs,
            ext_hook=_refuse_extension,
            # A length above the bytes there are is a cut file: nothing is allocated for it.
            max_str_len=limit,
            max_bin_len=limit,
            max_array_len=limit,
            max_map_len=limit,
            max_ext_len=limit,
        )
    except _RefusedError as refused:
        raise FormatError(refused.code, f"{where}: {refused}", clause="4.1") from None
    except msgpack.ExtraData as error:
        count = len(error.extra)
        raise FormatError(
            "msgpack-trailing", f"{where}: {count} bytes behind the value", clause="4.1"
        ) from None
    except msgpack.StackError:
        raise FormatError(
            "msgpack-depth", f"{where}: nested deeper than {MAX_DEPTH}", clause="4.1"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(
            "msgpack-utf8", f"{where}: a string that is not UTF-8", clause="4.1"
        ) from None
    except msgpack.FormatError:
        raise FormatError(
            "msgpack-invalid", f"{where}: the reserved byte 0xc1", clause="4.1"
        ) from None
    except ValueError as error:
        raise FormatError("msgpack-truncated", f"{where}: {error}", clause="4.1") from None
    if not isinstance(value, dict):
        raise FormatError(
            "msgpack-type", f"{where}: {type(value).__name__}, expected a map", clause="4.1"
        )
    _check(value, 1, where)
    if pack(value) != data:
        raise FormatError(
            "msgpack-canonical",
            f"{where}: not the shortest encoding of its values, or a float32",
            clause="4.1",
        )
    return value


class _RefusedError(Exception):
    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def _pairs(pairs: list[tuple[Value, Value]]) -> dict[str, Value]:
    out: dict[str, Value] = {}
    for key, value in pairs:
        if not isinstance(key, str):
            raise _RefusedError("msgpack-key", f"a key of type {type(key).__name__}, expected str")
        if key in out:
            raise _RefusedError("msgpack-duplicate-key", f"the key {key!r} twice")
        out[key] = value
    return out


def _refuse_extension(code: int, data: bytes) -> Value:
    raise _RefusedError("msgpack-type", f"an extension of type {code}, expected none")


def _check(value: object, depth: int, where: str) -> None:
    if depth > MAX_DEPTH:
        raise FormatError("msgpack-depth", f"{where}: nested deeper than {MAX_DEPTH}", clause="4.1")
    if isinstance(value, dict):
        for item in value.values():
            _check(item, depth + 1, where)
    elif isinstance(value, list):
        for item in value:
            _check(item, depth + 1, where)
    elif not isinstance(value, (bool, int, float, str, bytes, type(None))):
        # Timestamps come out of the library as objects of their own.
        raise FormatError(
            "msgpack-type",
            f"{where}: a {type(value).__name__}, expected map, array, str, bin, number, bool, nil",
            clause="4.1",
        )
