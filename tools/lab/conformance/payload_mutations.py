"""Mutations of payloads: one record, parameter or plane is changed at a time (SPEC 6).

A plane is decompressed, mutated and compressed again, so that most mutants pass the checks of
frames and reach the checks of codes.
"""

from __future__ import annotations

import random
import struct
from typing import Final, TypeVar

import zstandard

from . import file_builder
from .file_builder import PAYLOAD_HEAD, Record, pack_symbols, poke

NUMBERS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 16, 17, 31, 32, 64, 65, 127, 128, 255, 256, 257,
                  4095, 4096, 65535, 65536, 65537, 1 << 17, (1 << 17) + 1, 1 << 18, (1 << 18) + 1,
                  1 << 20, (1 << 20) + 1, 1 << 23, (1 << 23) + 1, (1 << 24) - 2, (1 << 24) - 1,
                  1 << 24, (1 << 24) + 1, (1 << 30) - 1, 1 << 30, (1 << 31) - 1, 1 << 31,
                  (1 << 32) - 1)  # fmt: skip
"""Unsigned integers at the limits of SPEC 9.1 and next to them."""

FLOATS: Final = (0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 0.3, 1e-45, -1e-45, 1e-38, 2.0**32, 2.0**33,
                 1e6, -1e6, 1.1e6, 2.0**100, -(2.0**100), 2.0**101, 3e38, float("inf"),
                 float("-inf"), float("nan"))  # fmt: skip
"""Floats at the limits of SPEC 6 and next to them."""

_T = TypeVar("_T")

_COMPRESSED, _PACKED = 1 << 31, 1 << 30
_STORED_MASK: Final = _PACKED - 1

# Largest plane that is decompressed for a mutation, bytes; larger ones are mutated compressed.
_LARGEST_PLANE: Final = 1 << 18


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return `data` after one random edit: bytes changed, cut, duplicated, reversed or added."""
    out = bytearray(data)
    at = rng.randrange(len(out) + 1)
    width = rng.choice((1, 1, 2, 4, 16))
    match rng.randrange(7):
        case 0 | 1 if at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        case 2 if at < len(out):
            out[at] = rng.choice((0, 1, 2, 127, 128, 254, 255))
        case 3:
            del out[at : at + width]
        case 4:
            out[at:at] = rng.randbytes(width)
        case 5:
            out[at:at] = out[at : at + width]
        case _:
            out[at : at + width] = out[at : at + width][::-1]
    return bytes(out)


def mutate_number(data: bytes, rng: random.Random) -> bytes:
    """Return `data` with one number changed by 1 or 2, or set to one of `NUMBERS` or `FLOATS`."""
    size, layout = rng.choice(((4, "f"), (4, "I"), (4, "I"), (2, "H"), (1, "B")))
    if len(data) < size:
        return data + b"\0"
    at = rng.randrange(len(data) - size + 1)
    if rng.random() < 0.8:
        at -= at % size
    if layout == "f":
        return poke(data, at, layout, rng.choice(FLOATS))
    limit = 1 << 8 * size
    if rng.random() < 0.5:
        (value,) = struct.unpack_from(f"<{layout}", data, at)
        return poke(data, at, layout, (value + rng.choice((-2, -1, 1, 2))) % limit)
    return poke(data, at, layout, rng.choice(NUMBERS) % limit)


def parse_records(payload: bytes) -> list[Record]:
    """Parse the records of a payload, with their planes.

    Raises
    ------
    struct.error, ValueError
        The payload is malformed, as after an earlier mutation.
    """
    (count,) = struct.unpack_from("<H", payload)
    records, sizes, at = [], [], PAYLOAD_HEAD
    for _ in range(count):
        *fields, planes, params = struct.unpack_from("<BBBBIHH", payload, at)
        at += 12
        records.append(Record(list(fields), payload[at : at + params]))
        at += params
        sizes.append(struct.unpack_from(f"<{planes}I", payload, at))
        at += 4 * planes
    for record, words in zip(records, sizes, strict=True):
        for word in words:
            end = at + (word & _STORED_MASK)
            record.planes.append((word, payload[at:end]))
            at = end
    if at != len(payload):
        raise ValueError(f"planes end at byte {at} of {len(payload)}")
    return records


def mutate_payload(payload: bytes, other: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Mutate the payload of a head, tail, refinement or codebook.

    Parameters
    ----------
    payload : bytes
    other : bytes
        Another payload, whose records may be copied.
    rng : Random

    Returns
    -------
    (str, bytes)
        Kind of mutation, and the mutated payload.
    """
    try:
        records = parse_records(payload)
        others = parse_records(other)
    except (struct.error, ValueError):
        return "payload bytes", mutate_bytes(payload, rng)
    if not records or rng.random() < 0.1:
        return "payload bytes", mutate_bytes(payload, rng)
    what = rng.choice(_CHANGES)
    count = None
    record = rng.choice(records)
    if what == "plane" and not any(entry.planes for entry in records):
        what = "record field"
    if what == "plane":
        record = rng.choice([entry for entry in records if entry.planes])
        number = rng.randrange(len(record.planes))
        record.planes[number] = _mutate_plane(*record.planes[number], rng)
    elif what == "planes":
        _mutate_list(record.planes, rng)
    elif what == "params":
        change = rng.choice((mutate_number, mutate_number, mutate_number, mutate_bytes))
        record.params = change(record.params, rng)
    elif what == "record field":
        _mutate_field(record, rng)
    elif what == "records":
        _mutate_list(records, rng)
    elif what == "record of another payload" and others:
        records[rng.randrange(len(records))] = rng.choice(others)
    else:
        what = "stream count"
        count = rng.choice((0, 1, 2, 64, 65, len(records) + 1, len(records) - 1))
    return what, file_builder.payload(records, count=count)


_CHANGES: Final = ("plane",) * 8 + ("params",) * 6 + ("record field",) * 4 + (
    "planes", "planes", "records", "records", "record of another payload", "stream count",
)  # fmt: skip


def _mutate_field(record: Record, rng: random.Random) -> None:
    """Change one random field of a record."""
    number = rng.choice((0, 1, 1, 2, 3, 3, 4, 4))
    if number == 4:
        rows = record.fields[4]
        record.fields[4] = rng.choice((rows + 1, max(rows - 1, 0), 0, 1, *NUMBERS))
    elif number == 3:
        record.fields[3] = rng.choice((0, 1, 2, 3, 4, 128))
    else:
        record.fields[number] = rng.choice((*range(13), 15, 21, 45, 255))


def _mutate_list(entries: list[_T], rng: random.Random) -> None:
    """Swap, drop or duplicate random entries of a list, or reverse it, in place."""
    if not entries:
        return
    a, b = rng.randrange(len(entries)), rng.randrange(len(entries))
    match rng.randrange(4):
        case 0:
            entries[a], entries[b] = entries[b], entries[a]
        case 1:
            del entries[a]
        case 2:
            entries.insert(b, entries[a])
        case _:
            entries.reverse()


def _mutate_plane(word: int, stored: bytes, rng: random.Random) -> tuple[int, bytes]:
    """Return word and bytes of a plane after a mutation of its symbols or its stored form."""
    if rng.random() < 0.25:
        return _mutate_frame(word, stored, rng)
    raw = _decompress(word, stored)
    if raw is None:
        return _mutate_frame(word, stored, rng)
    changed = rng.choice((mutate_bytes, mutate_number))(raw, rng)
    return _store(word, stored[:1], changed, rng)


def _decompress(word: int, stored: bytes) -> bytes | None:
    """Return the bytes in a plane's zstd frame, or None if the frame is broken."""
    body = stored[1:] if word & _PACKED else stored
    if not word & _COMPRESSED:
        return body
    try:
        raw: bytes = zstandard.ZstdDecompressor().decompress(body, _LARGEST_PLANE)
    except zstandard.ZstdError:
        return None
    return raw


def _store(word: int, radix: bytes, raw: bytes, rng: random.Random) -> tuple[int, bytes]:
    """Return word and bytes of a mutated plane, usually compressed and packed as before."""
    front = radix if word & _PACKED else b""
    if rng.random() < 0.1:
        word ^= _COMPRESSED
    if rng.random() < 0.05 and not word & _PACKED:
        # Symbols become digits of the least radix that holds them all.
        least = max(raw, default=0) + 1
        if 2 <= least <= 16:
            word, front, raw = word | _PACKED, bytes([least]), pack_symbols(raw, least)
    body = zstandard.ZstdCompressor(level=3).compress(raw) if word & _COMPRESSED else raw
    stored = front + body
    return word & ~_STORED_MASK | len(stored), stored


def _mutate_frame(word: int, stored: bytes, rng: random.Random) -> tuple[int, bytes]:
    """Mutate the stored bytes of a plane, or its word."""
    match rng.randrange(5):
        case 0:
            return word ^ (1 << rng.choice((30, 31))), stored
        case 1:
            return word ^ (1 << rng.randrange(8)), stored
        case 2 if stored:
            # Only the first bytes: frame header, radix or first block.
            changed = mutate_bytes(stored[:24], rng) + stored[24:]
        case _:
            changed = mutate_bytes(stored, rng)
    return word & ~_STORED_MASK | len(changed), changed
