"""rANS bodies for the conformance vectors, written from SPEC 6.9 with integers alone."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cogsplat.codec.streams import Stream

from .vectors_file import Record, payload, record

_START = 1 << 16


def table_of(plane: bytes) -> bytes:
    """Return a table for a plane: weights are counts, halved until each has a code of its own."""
    counts = [plane.count(symbol) for symbol in range(max(plane) + 1)]
    while max(counts) > 31:
        counts = [(count + 1) // 2 for count in counts]
    # Codes up to 31 are their own weight (SPEC 6.9).
    return bytes([len(counts) - 1, *counts])


def _frequencies(table: bytes) -> list[tuple[int, int]]:
    """Return frequency and cumulated frequency of each symbol."""
    weights = [c if c < 16 else (16 + c % 16) << (c // 16 - 1) for c in table[1:]]
    spare = 4096 - sum(weight > 0 for weight in weights)
    out, running, before = [], 0, 0
    for weight in weights:
        share = (running + weight) * spare // sum(weights) - running * spare // sum(weights)
        running += weight
        out.append((share + (weight > 0), before))
        before += share + (weight > 0)
    return out


def encode(planes: Sequence[tuple[bytes, bytes]], lanes: int, start: int = _START) -> bytes:
    """Return the body of planes with their tables.

    Parameters
    ----------
    planes : sequence of (bytes, bytes)
        Table and symbols of each, in the order of decoding.
    lanes : int
    start : int
        The state that encoding starts from, and decoding must end at.
    """
    states = [start] * lanes
    words: list[int] = []
    for table, plane in reversed(planes):
        frequencies = _frequencies(table)
        for index in range(len(plane) - 1, -1, -1):
            count, before = frequencies[plane[index]]
            state = states[index % lanes]
            if state >= count << 20:
                words.append(state & 0xFFFF)
                state >>= 16
            states[index % lanes] = (state // count << 12) + state % count + before
    words.reverse()
    return struct.pack(f"<{lanes}I{len(words)}H", *states, *words)


@dataclass(frozen=True)
class Coded:
    """What a payload's rANS planes came to, before it is packed.

    Parameters
    ----------
    records : list of Record
        Tables for planes.
    lanes : int
    body : bytes
    """

    records: list[Record]
    lanes: int
    body: bytes


def coded(
    body: Sequence[Stream],
    lanes: int,
    *,
    plain: Callable[[Stream, int], bool] = lambda stream, plane: False,
    start: int = _START,
) -> Coded:
    """Return streams with their planes rANS-coded.

    Parameters
    ----------
    body : sequence of Stream
        In the order in which a decoder reads them.
    lanes : int
    plain : callable
        ``plain(stream, plane)`` tells which planes are stored as they would be without.
    start : int
        As in `encode`.
    """
    records = [record(stream) for stream in body]
    planes: list[tuple[bytes, bytes]] = []
    for entry, stream in zip(records, body, strict=True):
        for number, raw in enumerate(stream.planes):
            symbols = raw.tobytes()
            if symbols and not plain(stream, number):
                table = table_of(symbols)
                planes.append((table, symbols))
                entry.planes[number] = (len(table) | 1 << 30, table)
    return Coded(records, lanes, encode(planes, lanes, start))


def pack(found: Coded) -> bytes:
    """Return the payload."""
    return payload(found.records, lanes=found.lanes, body=found.body)
