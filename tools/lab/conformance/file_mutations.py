"""Seeded mutants of whole COGS files: damaged, truncated, or inconsistent with valid checksums.

Some mutants have damaged or missing bytes, as after a faulty transfer. In the others one table
entry, msgpack value or payload is changed and every length, CRC and hash recomputed, so that
checksums do not reveal the fault.
"""

from __future__ import annotations

import hashlib
import random
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cogsplat.formats.cogs.canonical_msgpack import Value, pack, unpack

from .file_builder import (
    PREAMBLE_BYTES,
    Index,
    column,
    preamble_field,
    split_root,
    table,
    with_root,
)
from .payload_mutations import FLOATS, NUMBERS, mutate_bytes, mutate_number, mutate_payload

_ODD_VALUES: Final[tuple[Value, ...]] = (
    None, True, False, 0, 1, -1, 2, 3, 4, 32, 33, 255, 256, 16384, 65535, 65536, 1 << 31, 1 << 32,
    (1 << 53) - 1, 1 << 53, -(1 << 53), 0.0, -0.0, 0.5, 1.0, -1.0, 1e308, 5e-324, float("inf"),
    float("nan"), "", "a", "RDF", "RUB", "LDF", "RRF", "srgb", "linear", "shape", "colour", "f4",
    "é\U0001f600", "a" * 255, "a" * 256, "\ufeffa", b"", b"\0", b"\0\0\0\0", [], [0.0] * 3,
    [[[[[[[[[0]]]]]]]]], {}, {"a": 0}, {"a!": 0},
)  # fmt: skip
_ODD_KEYS: Final = ("a", "b!", "!", "", "__proto__", "constructor", "splats", "pages", "quality",
                "layer", "first_view", "up", "core_box", "capture", "target", "attributes", "kind",
                "name")  # fmt: skip
_PREAMBLE_FIELDS: Final = ((8, "H"), (10, "H"), (12, "I"), (16, "Q"), (24, "I"), (28, "I"),
                           (40, "B"), (59, "B"))  # fmt: skip

# Kinds of segments whose payload is a msgpack map (SPEC 5.2): cameras and compensation.
_MAP_KINDS: Final = (128, 130)
_ATTRIBUTES_KIND: Final = 129


@dataclass(frozen=True)
class Mutant:
    """A mutated file, and whether decoders should read it as a truncated file.

    Parameters
    ----------
    seed_file : str
        Name of the original file.
    change : str
        Short description of the mutation.
    data : bytes
    partial : bool
        Whether decoders read it as the beginning of a file (SPEC 8.3).
    """

    seed_file: str
    change: str
    data: bytes
    partial: bool


@dataclass
class _Parts:
    """A parsed file.

    Parameters
    ----------
    indexes : list of dict
        Root, then the pages.
    payloads : list of list of bytes
        Payloads of the segments that each index lists.
    pages : list of list of int
        Numbers of the pages that each index lists.
    """

    indexes: list[Index]
    payloads: list[list[bytes]]
    pages: list[list[int]]

    @property
    def places(self) -> list[tuple[int, int]]:
        """Place of every segment: number of the index that lists it, and row in its table."""
        return [(i, row) for i, group in enumerate(self.payloads) for row in range(len(group))]

    def kind(self, place: tuple[int, int]) -> int:
        """Return the kind of the segment at a place: number of its index, and row in its table."""
        index, row = place
        return column(self.indexes[index], "segments", "kind")[row]


def make_mutant(files: Sequence[tuple[str, bytes]], seed: int, number: int) -> Mutant:
    """Return one mutant of a seeded run; it does not depend on the mutants before it.

    Parameters
    ----------
    files : sequence of (str, bytes)
        Names and bytes of valid files.
    seed : int
        Seed of the run.
    number : int
        Number of the mutant in the run.
    """
    rng = random.Random(f"{seed}/{number}")
    name, data = rng.choice(files)
    change = rng.choice(_CHANGES)
    if change == "cut":
        at = rng.randrange(rng.choice((PREAMBLE_BYTES + 8, len(data), len(data))) + 1)
        return Mutant(name, change, data[:at], partial=rng.random() < 0.8)
    if change == "bytes":
        for _ in range(rng.randint(1, 4)):
            data = mutate_bytes(data, rng)
        return Mutant(name, change, data, partial=rng.random() < 0.2)
    if change == "preamble":
        offset, layout = rng.choice(_PREAMBLE_FIELDS)
        limit = 1 << 8 * struct.calcsize(layout)
        near = (
            len(data) + rng.choice((-1, 1)) if layout == "Q" else rng.choice((0, 1, 16320, 16321))
        )
        value = rng.choice((near, *NUMBERS, (1 << 53) - 1, 1 << 53, 1 << 63)) % limit
        return Mutant(name, change, preamble_field(data, offset, layout, value), rng.random() < 0.3)
    _, other = rng.choice(files)
    change, data = _mutate(change, _parse(data), _parse(other), rng)
    if rng.random() < 0.05:
        return Mutant(name, f"{change}, cut", data[: rng.randrange(len(data) + 1)], partial=True)
    return Mutant(name, change, data, partial=rng.random() < 0.1)


_CHANGES: Final = ("bytes", "bytes", "cut", "cut", "preamble") + ("payload",) * 10 + (
    "index bytes", "value", "value", "value", "column", "column", "column", "segments", "segments",
)  # fmt: skip


def _parse(data: bytes) -> _Parts:
    """Parse a valid file into its indexes and payloads."""
    root, behind = split_root(data)
    parts = _Parts([], [], [])
    _parse_index(unpack(root, "root"), behind, 0, parts)
    return parts


def _parse_index(index: Index, data: bytes, at: int, parts: _Parts) -> int:
    """Append an index, whose payloads begin at `at`, and all pages below it; return their end."""
    number = len(parts.indexes)
    parts.indexes.append(index)
    parts.pages.append([])
    at = _read_payloads(index, data, at, parts.payloads)
    lengths = column(index, "pages", "length") if "pages" in index else b""
    for (length,) in struct.iter_unpack("<I", lengths):
        end = at + length
        parts.pages[number].append(len(parts.indexes))
        at = _parse_index(unpack(data[at:end], "page"), data, end, parts)
    return at


def _read_payloads(index: Index, data: bytes, at: int, payloads: list[list[bytes]]) -> int:
    """Append a list of one index's payloads, from `at` on, to `payloads`; return their end."""
    group = []
    for (length,) in struct.iter_unpack("<I", column(index, "segments", "length")):
        group.append(data[at : at + length])
        at += length
    payloads.append(group)
    return at


def _mutate(change: str, parts: _Parts, other: _Parts, rng: random.Random) -> tuple[str, bytes]:
    """Apply one kind of change; return its description and the mutated file."""
    if change == "payload" and parts.places:
        change = _mutate_payload(parts, other, rng)
        return change, _assemble(parts)
    if change == "segments" and parts.places:
        change = _mutate_segments(parts, other, rng)
        return change, _assemble(parts)
    if change == "column":
        index = rng.choice(parts.indexes)
        names = ("segments", "segments", "chunks", *(["pages"] if "pages" in index else []))
        _mutate_column(table(index, rng.choice(names)), rng)
    elif change == "value":
        _mutate_map(rng.choice((parts.indexes[0], parts.indexes[0], *parts.indexes)), rng)
    else:
        return "index bytes", _assemble(parts, broken=(rng.randrange(len(parts.indexes)), rng))
    return change, _assemble(parts, fit_tables=False)


def _mutate_payload(parts: _Parts, other: _Parts, rng: random.Random) -> str:
    """Mutate the payload of a random segment; return the kind of mutation."""
    place = rng.choice(parts.places)
    index, row = place
    payload = parts.payloads[index][row]
    kind = parts.kind(place)
    if kind in _MAP_KINDS and rng.random() < 0.9:
        values = unpack(payload, "payload", max_values=131_072)
        rng.choice((_mutate_map, _mutate_column))(values, rng)
        parts.payloads[index][row] = pack(values)
        return "map of a payload"
    if kind == _ATTRIBUTES_KIND or kind in _MAP_KINDS:
        change = rng.choice((mutate_bytes, mutate_number))
        parts.payloads[index][row] = change(payload, rng) or b"\0"
        return "bytes of a payload"
    borrowed = b"\0\0"
    if other.places:
        i, j = rng.choice(other.places)
        borrowed = other.payloads[i][j]
    what, changed = mutate_payload(payload, borrowed, rng)
    parts.payloads[index][row] = changed or b"\0"
    return what


_WIDTHS: Final = {"kind": 1, "owner": 4, "length": 4, "crc": 4, "hash": 16, "needs": 4}


def _mutate_segments(parts: _Parts, other: _Parts, rng: random.Random) -> str:
    """Swap, move, drop, duplicate or replace a random segment; return the kind of mutation."""
    a, b = rng.choice(parts.places), rng.choice(parts.places)
    index, row = a
    group = parts.payloads[index]
    rows = _rows(parts.indexes[index])
    match rng.randrange(5):
        case 0:
            # Payloads are swapped, their rows of the table stay.
            first, second = group[row], parts.payloads[b[0]][b[1]]
            parts.payloads[index][row], parts.payloads[b[0]][b[1]] = second, first
            return "payloads swapped"
        case 1:
            to = rng.randrange(len(rows))
            rows.insert(to, rows.pop(row))
            group.insert(to, group.pop(row))
            change = "segment moved"
        case 2:
            del rows[row], group[row]
            change = "segment dropped"
        case 3:
            rows.insert(row, rows[row])
            group.insert(row, group[row])
            change = "segment doubled"
        case _:
            if other.places:
                i, j = rng.choice(other.places)
                group[row] = other.payloads[i][j]
            return "payload of another file"
    segments = table(parts.indexes[index], "segments")
    for name, values in zip(_WIDTHS, zip(*rows, strict=True) if rows else [()] * 6, strict=True):
        segments[name] = b"".join(values)
    return change


def _rows(index: Index) -> list[tuple[bytes, ...]]:
    """Return the rows of a segment table, each as the bytes of its columns."""
    columns = []
    for name, width in _WIDTHS.items():
        data = column(index, "segments", name)
        columns.append([data[at : at + width] for at in range(0, len(data), width)])
    return list(zip(*columns, strict=True))


def _mutate_column(columns: Index, rng: random.Random) -> None:
    """Change a number or the length of a random column, or replace it by another column."""
    names = [name for name, value in columns.items() if isinstance(value, bytes)]
    if not names:
        return
    name = rng.choice(names)
    data = columns[name]
    assert isinstance(data, bytes)
    if rng.random() < 0.1:
        value = columns[rng.choice(names)]
        columns[name] = value
    else:
        columns[name] = rng.choice((mutate_number, mutate_number, mutate_bytes))(data, rng)


def _mutate_map(value: Index, rng: random.Random) -> None:
    """Change, add or remove one value anywhere in a map."""
    place: Index | list[Value] = value
    while True:
        inner = place.values() if isinstance(place, dict) else place
        deeper = [entry for entry in inner if isinstance(entry, dict | list) and entry]
        if not deeper or rng.random() < 0.4:
            break
        place = rng.choice(deeper)
    if isinstance(place, dict):
        key = rng.choice(list(place)) if place else "a"
        match rng.randrange(6):
            case 0:
                place.pop(key, None)
            case 1:
                place[rng.choice(_ODD_KEYS)] = rng.choice(_ODD_VALUES)
            case _:
                place[key] = _mutate_value(place.get(key), rng)
        return
    at = rng.randrange(len(place) + 1)
    match rng.randrange(5):
        case 0:
            del place[at : at + 1]
        case 1:
            place.insert(at, rng.choice(_ODD_VALUES))
        case 2:
            place[at:at] = place[at : at + 1] * rng.choice((1, 2, 40))
        case _ if at < len(place):
            place[at] = _mutate_value(place[at], rng)
        case _:
            place.append(None)


def _mutate_value(value: Value, rng: random.Random) -> Value:
    """Return a value near the given one, or a random value."""
    if isinstance(value, bytes) and rng.random() < 0.7:
        return mutate_number(value, rng)
    if isinstance(value, float) and rng.random() < 0.6:
        return rng.choice((*FLOATS, -value, value * 2, 1e308, 5e-324))
    if isinstance(value, int) and rng.random() < 0.6:
        near = value + rng.choice((-1, 1))
        return near if not isinstance(value, bool) else rng.choice((0, 1, not value))
    if isinstance(value, str) and value and rng.random() < 0.4:
        return value.swapcase() if rng.random() < 0.5 else value + value
    return rng.choice(_ODD_VALUES)


def _assemble(
    parts: _Parts, *, fit_tables: bool = True, broken: tuple[int, random.Random] | None = None
) -> bytes:
    """Pack a parsed file into bytes; lengths, CRCs and hashes are recomputed.

    Parameters
    ----------
    parts : _Parts
    fit_tables : bool
        Whether segment tables are recomputed from the payloads.
    broken : (int, Random), optional
        Number of the index whose packed bytes are mutated, 0 for the root; random generator.
    """
    # Bytes of each index and of all that is below it, from the last on, as an index lists pages.
    stored: dict[int, tuple[bytes, bytes]] = {}
    for number in reversed(range(len(parts.indexes))):
        index, group = parts.indexes[number], parts.payloads[number]
        pages = [stored[page] for page in parts.pages[number]]
        if fit_tables:
            _fit_table(table(index, "segments"), group)
        if isinstance(index.get("pages"), dict):
            _fit_pages(parts, number, pages, counts=fit_tables)
        body = pack(index)
        if broken and broken[0] == number:
            body = mutate_bytes(body, broken[1]) or b"\0"
        stored[number] = body, b"".join([*group, *(part for pair in pages for part in pair)])
    return with_root(*stored[0])


def _fit_table(segments: Index, group: Sequence[bytes]) -> None:
    """Recompute length, CRC and hash of each row of a segment table."""
    words = [(len(part), zlib.crc32(part)) for part in group]
    segments["length"] = struct.pack(f"<{len(group)}I", *(length for length, _ in words))
    segments["crc"] = struct.pack(f"<{len(group)}I", *(crc for _, crc in words))
    segments["hash"] = b"".join(hashlib.sha256(part).digest()[:16] for part in group)


def _fit_pages(
    parts: _Parts, number: int, pages: Sequence[tuple[bytes, bytes]], *, counts: bool
) -> None:
    """Recompute length and CRC in the rows of the pages of an index; with `counts`, all sums."""
    rows = table(parts.indexes[number], "pages")
    changed: Index = {
        "length": struct.pack(f"<{len(pages)}I", *(len(page) for page, _ in pages)),
        "crc": struct.pack(f"<{len(pages)}I", *(zlib.crc32(page) for page, _ in pages)),
    }
    if counts:
        sums = [_sums(parts, page) for page in parts.pages[number]]
        changed["segments"] = struct.pack(f"<{len(pages)}I", *(segments for segments, _ in sums))
        changed["chunks"] = struct.pack(f"<{len(pages)}I", *(chunks for _, chunks in sums))
        changed["span"] = struct.pack(f"<{len(pages)}Q", *(len(below) for _, below in pages))
    # A value that a mutation replaced by another type or length stays.
    for name, value in changed.items():
        old = rows.get(name)
        if isinstance(old, bytes) and isinstance(value, bytes) and len(old) == len(value):
            rows[name] = value


def _sums(parts: _Parts, number: int) -> tuple[int, int]:
    """Return the numbers of segments and chunks below a page."""
    below = [_sums(parts, page) for page in parts.pages[number]]
    segments = len(parts.payloads[number]) + sum(own for own, _ in below)
    chunks = len(column(parts.indexes[number], "chunks", "splats")) // 4
    return segments, chunks + sum(own for _, own in below)
