"""Annotated hex dump of a small file, as SPEC's appendix shows it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from cogsplat.codec.streams.records import Attribute, Kind
from cogsplat.formats.cogs.canonical_msgpack import Value, pack, unpack
from cogsplat.formats.cogs.layout import SegmentKind

from .file_builder import PAYLOAD_HEAD, PREAMBLE_BYTES

_Piece = tuple[int, str]

# Bytes of the file on one line of the dump.
_LINE: Final = 16
# Types of the columns of the segment and chunk tables, as `struct` names them (SPEC 5.3, 5.4).
_COLUMNS: Final = {
    "kind": "B",
    "owner": "I",
    "length": "I",
    "crc": "I",
    "hash": "",
    "needs": "I",
    "splats": "I",
    "box": "f",
    "contribution": "d",
}


def dump(data: bytes) -> list[str]:
    """Return the lines of a file's hex dump, each with offset, bytes and meaning.

    Parameters
    ----------
    data : bytes
        A valid file without pages and without byte planes: every grid has one level.
    """
    lines = []
    position = 0
    for size, meaning in _pieces(data):
        for start in range(0, size, _LINE):
            part = data[position + start : position + min(start + _LINE, size)]
            text = "" if start else meaning
            lines.append(f"{position + start:5d}  {part.hex(' '):47}  {text}".rstrip())
        position += size
    return lines


def _pieces(data: bytes) -> Iterator[_Piece]:
    """Yield the size and the meaning of each part of the file, in file order."""
    root_length, file_length, root_crc = struct.unpack_from("<IQI", data, 12)
    yield 8, "magic: 89, COGS, CR LF, 1a"
    yield 2, f"major version {struct.unpack_from('<H', data, 8)[0]}"
    yield 2, f"minor version {struct.unpack_from('<H', data, 10)[0]}"
    yield 4, f"root_length: {root_length}"
    yield 8, f"file_length: {file_length}"
    yield 4, f"root_crc: {root_crc:08x}"
    yield 32, "reserved"
    yield 4, f"preamble_crc: {struct.unpack_from('<I', data, 60)[0]:08x}"
    root = unpack(data[PREAMBLE_BYTES : PREAMBLE_BYTES + root_length], "root")
    yield 1, f"map of {len(root)}"
    position = PREAMBLE_BYTES + root_length
    for key, value in root.items():
        yield from _entry(key, value, "")
    table = root["segments"]
    if not isinstance(table, dict) or not isinstance(table["kind"], bytes):
        raise TypeError("segments is no table")
    lengths = struct.unpack(f"<{len(table['kind'])}I", _bin(table["length"]))
    for kind, length in zip(table["kind"], lengths, strict=True):
        name = SegmentKind(kind).name.lower()
        yield from _payload(data[position : position + length], name)
        position += length


def _bin(value: Value) -> bytes:
    """Return a value, checked to be bytes."""
    if not isinstance(value, bytes):
        raise TypeError(f"{type(value).__name__}, expected bin")
    return value


def _size(value: Value) -> int:
    # The value is packed in a map of one empty key, whose two bytes are subtracted.
    """Return the packed size of a value, bytes."""
    return len(pack({"": value})) - 2


def _entry(key: str, value: Value, indent: str) -> Iterator[_Piece]:
    """Yield size and meaning of one entry of the root, and of the entries nested in it."""
    size = _size(key)
    if isinstance(value, dict):
        yield size + 1, f'{indent}"{key}": map of {len(value)}'
        for inner, content in value.items():
            yield from _entry(inner, content, indent + "  ")
    elif isinstance(value, bytes):
        yield size + _size(value), f'{indent}"{key}": bin of {len(value)}{_column(key, value)}'
    else:
        text = str(value).replace("'", '"') if not isinstance(value, str) else f'"{value}"'
        yield size + _size(value), f'{indent}"{key}": {text}'


def _column(key: str, value: bytes) -> str:
    """Return the numbers of a packed column as text, "" for a column without a layout."""
    layout = _COLUMNS[key]
    if not layout:
        return ""
    numbers = struct.unpack(f"<{len(value) // struct.calcsize(layout)}{layout}", value)
    shown = [f"{n:08x}" if key == "crc" else f"{n:g}" for n in numbers]
    return ": " + ", ".join(shown)


def _payload(payload: bytes, name: str) -> Iterator[_Piece]:
    """Yield the size and description of each part of a payload, stream by stream."""
    (count,) = struct.unpack_from("<H", payload)
    yield PAYLOAD_HEAD, f"{name}: {count} streams"
    position = PAYLOAD_HEAD
    for _ in range(count):
        fields = struct.unpack_from("<BBBBIHH", payload, position)
        attribute, kind, components, flags, rows, planes, size = fields
        yield 2, f"stream: {Attribute(attribute).name.lower()}, {Kind(kind).name.lower()}"
        yield 2, f"  components {components}, flags {flags}"
        yield 4, f"  rows {rows}"
        yield 4, f"  planes {planes}, bytes of parameters {size}"
        position += 12
        if kind == Kind.QUAT:
            yield 4, f"  largest component {payload[position]}, padding"
        for start in range(size % 12, size, 12):
            low, high, levels = struct.unpack_from("<ffI", payload, position + start)
            yield 12, f"  grid {low:g} to {high:g}, levels {levels}"
        position += size
        if planes:
            raise ValueError(f"{planes} planes: only files without any can be shown")
