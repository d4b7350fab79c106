"""A second decoder, written from SPEC alone: what the conformance vectors' arrays come from.

It shares no code with the codec, takes every step of SPEC 6 and 7 value by value, and rounds to
float32 after every operation as a decoder in a browser does. Slow, and for valid files only.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgpack
import zstandard

Row = list[float]

# SPEC 5.2 and 6.2, by number.
_HEAD, _TAIL, _SHAPE_BOOK = 1, 2, 3
_MEANS, _OPACITIES, _SH0, _SCALES, _QUATS, _SCALE_FACTOR, _SHAPE, _SHN = range(1, 9)
_BANDS: Final = (9, 10, 11)
_BAND_VALUES: Final = (9, 15, 21)
_SCALAR, _MORTON, _QUAT, _VQ, _FLOAT = range(1, 6)
_KEPT, _INFINITIES = 1, 2


def f32(value: float) -> float:
    """Round to float32, as ``Math.fround``."""
    rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return rounded


@dataclass(frozen=True)
class Segment:
    """A row of the segment table with its place in the file."""

    kind: int
    owner: int
    start: int
    end: int
    needs: int


@dataclass(frozen=True)
class Prefix:
    """What the first `size` bytes of a file give, until the next entry's.

    Parameters
    ----------
    size : int
        Bytes.
    chunks : int
        Chunks from the first whose heads can be decoded.
    tails : tuple of int
        Those of them whose tails can be decoded too, all bands.
    """

    size: int
    chunks: int
    tails: tuple[int, ...]


@dataclass(frozen=True)
class Scene:
    """A decoded file: one list of values per splat and attribute.

    Parameters
    ----------
    sh_degree : int
    chunk_splats : list of int
    rows : dict of str to list of list of float
        By the names of `Splats`; ``shN`` in the order coefficient, channel.
    prefixes : list of Prefix
        From the end of the root on.
    """

    sh_degree: int
    chunk_splats: list[int]
    rows: dict[str, list[Row]]
    prefixes: list[Prefix]


class _Record:
    """One stream of a payload (SPEC 6.2, 6.3)."""

    def __init__(self, fields: Sequence[int], params: bytes) -> None:
        self.attribute, self.kind, _, self.flags, self.rows, self.num_planes, _ = fields
        self.params = params
        self.planes: list[tuple[int, bytes]] = []

    def plane(self, index: int) -> bytes:
        word, stored = self.planes[index]
        if not word >> 31:
            return stored
        raw: bytes = zstandard.ZstdDecompressor().decompress(stored)
        return raw


_Payload = dict[tuple[int, int], _Record]


def _parse(payload: bytes) -> _Payload:
    records: list[_Record] = []
    words: list[tuple[int, ...]] = []
    position = 4
    for _ in range(struct.unpack_from("<H", payload)[0]):
        fields = struct.unpack_from("<BBBBIHH", payload, position)
        params_end = position + 12 + fields[6]
        records.append(_Record(fields, payload[position + 12 : params_end]))
        words.append(struct.unpack_from(f"<{fields[5]}I", payload, params_end))
        position = params_end + 4 * fields[5]
    for record, sizes in zip(records, words, strict=True):
        for word in sizes:
            end = position + (word & 0x7FFFFFFF)
            record.planes.append((word, payload[position:end]))
            position = end
    return {(r.attribute, r.flags & _KEPT): r for r in records}


def _entries(params: bytes) -> list[tuple[float, float, int]]:
    """Return minimum, step and levels of each component (SPEC 6.4)."""
    out = []
    for minimum, maximum, levels in struct.iter_unpack("<ffI", params):
        step = f32(f32(maximum - minimum) / (levels - 1)) if levels > 1 else 0.0
        out.append((minimum, step, levels))
    return out


def _planes_for(codes: int) -> int:
    """Return how many bytes a code below `codes` takes (SPEC 6.4)."""
    return next(count for count in range(4) if codes <= 256**count)


def _codes(record: _Record, first: int, count: int) -> list[int]:
    planes = [record.plane(first + i) for i in range(count)]
    return [sum(p[row] << 8 * i for i, p in enumerate(planes)) for row in range(record.rows)]


def _on_grid(code: int, minimum: float, step: float) -> float:
    return f32(f32(code * step) + minimum)


def _scalar(record: _Record, params: bytes, plane: int = 0) -> list[Row]:
    """Return the rows of grid codes (SPEC 6.4)."""
    columns: list[Row] = []
    for minimum, step, levels in _entries(params):
        extra = 2 if record.flags & _INFINITIES else 0
        count = _planes_for(levels + extra)
        column = []
        for code in _codes(record, plane, count):
            if code < levels:
                column.append(_on_grid(code, minimum, step))
            else:
                column.append(math.inf if code == levels else -math.inf)
        columns.append(column)
        plane += count
    return [list(row) for row in zip(*columns, strict=True)]


def _floats(record: _Record) -> list[Row]:
    """Return the rows of stored floats (SPEC 6.8)."""
    planes = [record.plane(i) for i in range(record.num_planes)]
    rows = []
    for row in range(record.rows):
        octets = bytes(plane[row] for plane in planes)
        rows.append([value for (value,) in struct.iter_unpack("<f", octets)])
    return rows


def _morton(record: _Record) -> list[Row]:
    """Return means from Morton differences (SPEC 6.5)."""
    classes, bits = record.plane(0), int.from_bytes(record.plane(1), "little")
    grid = _entries(record.params)
    code, rows = 0, []
    for length in classes:
        if length:
            width = length - 1
            code += bits & (1 << width) - 1 | 1 << width
            bits >>= width
        axes = [sum((code >> 3 * bit + axis & 1) << bit for bit in range(21)) for axis in range(3)]
        rows.append([_on_grid(a, grid[i][0], grid[i][1]) for i, a in enumerate(axes)])
    return rows


def _numbers(record: _Record) -> list[Row]:
    if record.kind == _FLOAT:
        return _floats(record)
    if record.kind == _MORTON:
        return _morton(record)
    return _scalar(record, record.params)


def _quats(record: _Record) -> list[Row]:
    """Return unit quaternions, w at least 0 (SPEC 6.6)."""
    largest = record.params[0]
    others = _scalar(record, record.params[4:], 1 if largest == 255 else 0)
    which = record.plane(0) if largest == 255 else bytes([largest]) * record.rows
    rows = []
    for index, (a, b, c) in zip(which, others, strict=True):
        rest = f32(1 - f32(f32(f32(a * a) + f32(b * b)) + f32(c * c)))
        row = [a, b, c]
        row.insert(index, f32(math.sqrt(max(rest, 0.0))))
        w, x, y, z = row
        squares = f32(f32(f32(w * w) + f32(x * x)) + f32(y * y))
        norm = f32(math.sqrt(f32(squares + f32(z * z))))
        row = [f32(v / norm) for v in row]
        rows.append([-v for v in row] if row[0] < 0 else row)
    return rows


def _indices(record: _Record, size: int) -> list[int]:
    """Return the indices into a codebook of `size` rows and the kept rows behind (SPEC 6.7)."""
    kept = struct.unpack("<II", record.params)[1]
    return _codes(record, 0, _planes_for(size + kept))


class _File:
    """Root, segments and payloads of a valid file."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        root_length, self.length = struct.unpack_from("<IQ", data, 12)
        self.root_end = 64 + root_length
        self.root = msgpack.unpackb(data[64 : self.root_end])
        self.segments: list[Segment] = []
        self.chunk_splats: list[int] = []
        # Where the index that lists each segment ends.
        self.known_at: list[int] = []
        position = self._add(self.root, self.root_end)
        for page in self.root.get("pages", []):
            end = position + page["length"]
            position = self._add(msgpack.unpackb(data[position:end]), end)

    def _add(self, index: dict[str, dict[str, bytes]], start: int) -> int:
        table = index["segments"]
        columns = [
            table["kind"],
            *(
                struct.unpack(f"<{len(table[name]) // 4}I", table[name])
                for name in ("owner", "length", "needs")
            ),
        ]
        position = start
        for kind, owner, length, needs in zip(*columns, strict=True):
            self.segments.append(Segment(kind, owner, position, position + length, needs))
            self.known_at.append(start)
            position += length
        splats = index["chunks"]["splats"]
        self.chunk_splats += struct.unpack(f"<{len(splats) // 4}I", splats)
        return position

    def payload(self, segment: Segment) -> _Payload:
        return _parse(self.data[segment.start : segment.end])

    def of(self, kind: int, owner: int) -> list[Segment]:
        return [s for s in self.segments if (s.kind, s.owner) == (kind, owner)]

    def book_segments(self, book: int) -> list[Segment]:
        if self.root["codebooks"][book]["attribute"] == "shape":
            return self.of(_SHAPE_BOOK, book)
        return [s for k in range(self.root["sh_degree"]) for s in self.of(4 + k, book)]


def _bands(payload: _Payload, degree: int, rows: int, flag: int = 0) -> list[Row]:
    """Return the SH rows above DC, zeros where a band has no stream (SPEC 7.3)."""
    out: list[Row] = [[] for _ in range(rows)]
    for attribute, values in list(zip(_BANDS, _BAND_VALUES, strict=True))[:degree]:
        record = payload.get((attribute, flag))
        band = _numbers(record) if record else [[0.0] * values] * rows
        for row, part in zip(out, band, strict=True):
            row += part
    return out


def _codebook(file: _File, book: int) -> list[Row]:
    """Return a codebook's rows: scales then quats, or SH coefficients (SPEC 7.1)."""
    entry = file.root["codebooks"][book]
    if entry["attribute"] == "shape":
        payload = file.payload(file.book_segments(book)[0])
        pairs = zip(
            _numbers(payload[_SCALES, 0]),
            _quats(payload[_QUATS, 0]),
            strict=True,
        )
        return [scales + quats for scales, quats in pairs]
    merged: _Payload = {}
    for segment in file.book_segments(book):
        merged |= file.payload(segment)
    return _bands(merged, file.root["sh_degree"], entry["rows"])


def _head(payload: _Payload, books: dict[int, list[Row]]) -> dict[str, list[Row]]:
    """Return the rows of a chunk head (SPEC 7.2)."""
    rows = {
        "means": _numbers(payload[_MEANS, 0]),
        "opacities": _numbers(payload[_OPACITIES, 0]),
        "sh0": _numbers(payload[_SH0, 0]),
    }
    shape = payload.get((_SHAPE, 0))
    if shape is None:
        rows["scales"] = _numbers(payload[_SCALES, 0])
        rows["quats"] = _quats(payload[_QUATS, 0])
        return rows
    number, kept = struct.unpack("<II", shape.params)
    book = list(books[number])
    if kept:
        own = zip(_numbers(payload[_SCALES, _KEPT]), _quats(payload[_QUATS, _KEPT]), strict=True)
        book += [scales + quats for scales, quats in own]
    chosen = [book[i] for i in _indices(shape, len(books[number]))]
    factors = _numbers(payload[_SCALE_FACTOR, 0])
    rows["scales"] = [
        [f32(value + factor) for value in row[:3]]
        for row, (factor,) in zip(chosen, factors, strict=True)
    ]
    rows["quats"] = [row[3:] for row in chosen]
    return rows


def _tail(payload: _Payload, books: dict[int, list[Row]], degree: int, rows: int) -> list[Row]:
    """Return the rows of a chunk tail (SPEC 7.3)."""
    colour = payload.get((_SHN, 0))
    if colour is None:
        return _bands(payload, degree, rows)
    number, kept = struct.unpack("<II", colour.params)
    book = books[number] + _bands(payload, degree, kept, _KEPT)
    return [book[i] for i in _indices(colour, len(books[number]))]


def _prefixes(file: _File) -> list[Prefix]:
    """Return what each length of the file gives (SPEC 8.2)."""

    def there(segment: Segment, size: int) -> bool:
        needed = [b for b in range(len(file.root["codebooks"])) if segment.needs >> b & 1]
        parts = [segment, *(s for b in needed for s in file.book_segments(b))]
        return all(s.end <= size and file.known_at[file.segments.index(s)] <= size for s in parts)

    out: list[Prefix] = []
    for size in sorted({file.root_end, *(s.end for s in file.segments), file.length}):
        chunks = 0
        for chunk in range(len(file.chunk_splats)):
            if not there(file.of(_HEAD, chunk)[0], size):
                break
            chunks += 1
        tails = tuple(c for c in range(chunks) for s in file.of(_TAIL, c) if there(s, size))
        if not out or (out[-1].chunks, out[-1].tails) != (chunks, tails):
            out.append(Prefix(size, chunks, tails))
    return out


def decode(data: bytes) -> Scene:
    """Decode a valid file whole."""
    file = _File(data)
    degree = file.root["sh_degree"]
    books = {book: _codebook(file, book) for book in range(len(file.root["codebooks"]))}
    names = ("means", "scales", "quats", "opacities", "sh0", "shN")
    rows: dict[str, list[Row]] = {name: [] for name in names}
    for chunk, splats in enumerate(file.chunk_splats):
        head = _head(file.payload(file.of(_HEAD, chunk)[0]), books)
        tails = file.of(_TAIL, chunk)
        blank = [[0.0] * (3 * ((degree + 1) ** 2 - 1))] * splats
        head["shN"] = _tail(file.payload(tails[0]), books, degree, splats) if tails else blank
        for name in names:
            rows[name] += head[name]
    return Scene(degree, file.chunk_splats, rows, _prefixes(file))
