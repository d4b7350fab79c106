"""Stream decoding of the reference decoder, value by value, written from SPEC 6.

It shares no code with the codec, and rounds to float32 after every operation as a decoder in a
browser does. It is slow, and for valid files only.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Final

import zstandard

Row = list[float]

# SPEC 6.2, by number.
MEANS, OPACITIES, SH0, SCALES, QUATS, SCALE_FACTOR, SHAPE, SHN = range(1, 9)
BANDS: Final = (9, 10, 11)
SCALAR, FLOAT, QUAT, VQ, SORTED, DIFFERENCES, SWING_TWIST, BASIS, DIGITS, BITS = range(1, 11)
ESCAPE, INFINITIES = 1, 2


def f32(value: float) -> float:
    """Round to float32, as ``Math.fround``."""
    rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return rounded


def plane(word: int, stored: bytes, length: int) -> bytes:
    """Decode a plane of `length` symbols (SPEC 6.3, 6.9)."""
    packed = word >> 30 & 1
    octets: bytes = stored[packed:]
    if word >> 31:
        octets = zstandard.ZstdDecompressor().decompress(octets)
    if not packed:
        return octets
    radix = stored[0]
    count = max(d for d in range(1, 9) if radix**d <= 256)
    return bytes(octets[j // count] // radix ** (j % count) % radix for j in range(length))


class Record:
    """Record of one stream: header fields, parameters and stored planes (SPEC 6.2, 6.3)."""

    def __init__(self, fields: Sequence[int], params: bytes) -> None:
        self.attribute, self.kind, _, self.flags, self.rows, self.num_planes, _ = fields
        self.params = params
        self.stored: list[tuple[int, bytes]] = []

    def plane(self, index: int, length: int) -> bytes:
        """Decode plane number `index`, which has `length` symbols."""
        return plane(*self.stored[index], length)


Payload = dict[tuple[int, int], Record]


def parse(payload: bytes) -> Payload:
    """Return the records of a payload by attribute and escape flag (SPEC 6.1)."""
    records: list[Record] = []
    words: list[tuple[int, ...]] = []
    (count,) = struct.unpack_from("<H", payload)
    position = 2
    for _ in range(count):
        fields = struct.unpack_from("<BBBBIHH", payload, position)
        params_end = position + 12 + fields[6]
        records.append(Record(fields, payload[position + 12 : params_end]))
        words.append(struct.unpack_from(f"<{fields[5]}I", payload, params_end))
        position = params_end + 4 * fields[5]
    for record, sizes in zip(records, words, strict=True):
        for word in sizes:
            end = position + (word & 0x3FFFFFFF)
            record.stored.append((word, payload[position:end]))
            position = end
    return {(r.attribute, r.flags & ESCAPE): r for r in records}


def _entries(params: bytes) -> list[tuple[float, float, int]]:
    """Return minimum, step and levels of each component (SPEC 6.4)."""
    out = []
    for minimum, maximum, levels in struct.iter_unpack("<ffI", params):
        step = f32(f32(maximum - minimum) / (levels - 1)) if levels > 1 else 0.0
        out.append((minimum, step, levels))
    return out


def _bytes_per_code(codes: int) -> int:
    """Return the number of bytes per code, 0 to 3, for `codes` different codes (SPEC 6.4)."""
    return next(count for count in range(4) if codes <= 256**count)


def _codes(record: Record, first: int, count: int, rows: int) -> list[int]:
    """Return the codes of `rows` rows, whose bytes are `count` planes from plane `first` on."""
    planes = [record.plane(first + i, rows) for i in range(count)]
    return [sum(plane[row] << 8 * i for i, plane in enumerate(planes)) for row in range(rows)]


def _grid_value(code: int, minimum: float, step: float) -> float:
    """Return the value of a code on a component's grid (SPEC 6.4)."""
    return f32(f32(f32(code) * step) + minimum)


def _scalar(
    record: Record, params: bytes, plane: int = 0, digits: Record | None = None
) -> list[Row]:
    """Return the rows of a scalar stream (SPEC 6.4), refined if `digits` are given (SPEC 6.16)."""
    if digits is not None:
        return _refined(record, params, digits)
    columns: list[Row] = []
    for minimum, step, levels in _entries(params):
        extra = 2 if record.flags & INFINITIES else 0
        count = _bytes_per_code(levels + extra)
        column = []
        for code in _codes(record, plane, count, record.rows):
            if code < levels:
                column.append(_grid_value(code, minimum, step))
            else:
                column.append(math.inf if code == levels else -math.inf)
        columns.append(column)
        plane += count
    return [list(row) for row in zip(*columns, strict=True)]


def _refined(record: Record, params: bytes, digits: Record) -> list[Row]:
    """Return the rows of a scalar stream refined by digits (SPEC 6.16)."""
    columns: list[Row] = []
    coarse = _entries(params)
    fine, radices = digits.params[: 12 * len(coarse)], digits.params[12 * len(coarse) :]
    plane, below = 0, 0
    entries = zip(coarse, _entries(fine), radices, strict=True)
    for (_, _, levels), (minimum, step, _), radix in entries:
        count = _bytes_per_code(levels)
        codes = _codes(record, plane, count, record.rows)
        plane += count
        if radix > 1:
            digit = digits.plane(below, record.rows)
            below += 1
            codes = [code * radix + low for code, low in zip(codes, digit, strict=True)]
        columns.append([_grid_value(code, minimum, step) for code in codes])
    return [list(row) for row in zip(*columns, strict=True)]


def _floats(record: Record) -> list[Row]:
    """Return the rows of stored floats (SPEC 6.8)."""
    planes = [record.plane(i, record.rows) for i in range(record.num_planes)]
    rows = []
    for row in range(record.rows):
        octets = bytes(plane[row] for plane in planes)
        rows.append([value for (value,) in struct.iter_unpack("<f", octets)])
    return rows


class _Bits:
    """Reader of bit fields without gaps, lowest bit first (SPEC 6.5)."""

    def __init__(self, data: bytes) -> None:
        self._left = int.from_bytes(data, "little")

    def read(self, width: int) -> int:
        field = self._left & (1 << width) - 1
        self._left >>= width
        return field


def _byte_count(bits: int) -> int:
    """Return the number of bytes that hold a number of bits."""
    return (bits + 7) // 8


def _cells(record: Record) -> list[list[int]]:
    """Return the cells of a sorted stream from its planes 0 and 1 (SPEC 6.5)."""
    classes = record.plane(0, record.rows)
    bits = _Bits(record.plane(1, _byte_count(sum(max(c - 1, 0) for c in classes))))
    code, out = 0, []
    for length in classes:
        if length:
            code += bits.read(length - 1) | 1 << length - 1
        out.append([sum((code >> 3 * b + axis & 1) << b for b in range(17)) for axis in range(3)])
    return out


def extra_bits(params: bytes, scales: Row) -> int:
    """Return the extra bits of a row (SPEC 6.10)."""
    c = struct.unpack("<6f", params)
    middle, thin, long = scales
    p, q = f32(long - middle), f32(middle - thin)
    total: float = c[0]
    for factor, feature in zip(
        c[1:], (long, min(p, 1.5), min(p, 5), min(q, 0.5), min(q, 3)), strict=True
    ):
        total = f32(total + f32(factor * feature))
    return int(min(max(math.floor(total), 0), 15))


def _sorted(record: Record, scales: list[Row], refinement: Record | None) -> list[Row]:
    """Return means from cells, extra bits and refinement bits (SPEC 6.5, 6.17)."""
    grid, model = _entries(record.params[:36]), record.params[36:]
    cells = _cells(record)
    extra = [extra_bits(model, row) for row in scales]
    low = _Bits(record.plane(2, _byte_count(sum(3 * h for h in extra))))
    more, digits = 0, _Bits(b"")
    if refinement is not None:
        more = refinement.params[0]
        digits = _Bits(refinement.plane(0, _byte_count(3 * more * record.rows)))
    rows = []
    for cell, h in zip(cells, extra, strict=True):
        codes = [axis << h | low.read(h) for axis in cell]
        codes = [(code << more) + digits.read(more) - (1 << more) // 2 for code in codes]
        steps = [f32(step * 2.0 ** -(h + more)) for _, step, _ in grid]
        rows.append([_grid_value(codes[i], grid[i][0], steps[i]) for i in range(3)])
    return rows


def _differences(record: Record, digits: Record | None) -> list[Row]:
    """Return log scales, stored as the longest and two differences (SPEC 6.12).

    `digits` is the record that refines the stream, None without refinement.
    """
    rows = []
    for long, first, second in _scalar(record, record.params, 0, digits):
        middle = f32(long - first)
        rows.append([middle, f32(middle - second), long])
    return rows


def _sh0_basis(record: Record, digits: Record | None) -> list[Row]:
    """Return sh0 from coordinates on three axes (SPEC 6.13)."""
    axes = struct.unpack("<9f", record.params[36:])
    rows = []
    for x, y, z in _scalar(record, record.params[:36], 0, digits):
        row = []
        for channel in range(3):
            a, b, c = axes[channel::3]
            row.append(f32(f32(f32(x * a) + f32(y * b)) + f32(z * c)))
        rows.append(row)
    return rows


def numbers(
    record: Record, scales: list[Row] | None = None, refinement: Record | None = None
) -> list[Row]:
    """Return the rows of a stream of any kind except quat, swing_twist and vq.

    Parameters
    ----------
    record : Record
    scales : list of list of float, optional
        Log scales of the same rows without refinement; needed for sorted means.
    refinement : Record, optional
        The digits or the bits that refine the stream.
    """
    if record.kind == FLOAT:
        return _floats(record)
    if record.kind == SORTED and scales is not None:
        return _sorted(record, scales, refinement)
    if record.kind == DIFFERENCES and record.attribute == SCALES:
        return _differences(record, refinement)
    if record.kind == BASIS:
        return _sh0_basis(record, refinement)
    return _scalar(record, record.params, 0, refinement)


def _unit(row: Row) -> Row:
    """Normalise a quaternion, with w at least 0."""
    w, x, y, z = row
    squares = f32(f32(f32(w * w) + f32(x * x)) + f32(y * y))
    norm = f32(math.sqrt(f32(squares + f32(z * z))))
    row = [f32(value / norm) for value in row]
    return [-value for value in row] if row[0] < 0 else row


def _component(record: Record, extra: list[int], first: int) -> Row:
    """Decode a component of a swing-twist stream from seven planes from `first` on (SPEC 6.11)."""
    symbols = {
        m: list(record.plane(first + m - 1, sum(min(h, 6) == m for h in extra)))
        for m in range(1, 7)
    }
    bits = _Bits(record.plane(first + 6, _byte_count(sum(max(h - 6, 0) for h in extra))))
    out = []
    for h in extra:
        low = max(h - 6, 0)
        code = symbols[min(h, 6)].pop(0) << low | bits.read(low) if h else 0
        out.append(f32(f32(code * 2.0 ** (1 - h)) - 1) if h else 0.0)
    return out


def _swing_twist(record: Record, scales: list[Row]) -> list[Row]:
    """Return quaternions from swing and twist (SPEC 6.11)."""
    swing = [extra_bits(record.params[:24], row) for row in scales]
    twist = [extra_bits(record.params[24:], row) for row in scales]
    columns = [_component(record, extra, 7 * i) for i, extra in enumerate((swing, swing, twist))]
    rows = []
    for a, b, c in zip(*columns, strict=True):
        rows.append(_unit([1.0, f32(a + f32(b * c)), f32(b - f32(a * c)), c]))
    return rows


def quats(record: Record, scales: list[Row] | None = None) -> list[Row]:
    """Return unit quaternions, w at least 0; swing-twist needs the unrefined log scales."""
    if record.kind == SWING_TWIST and scales is not None:
        return _swing_twist(record, scales)
    largest = record.params[0]
    each = largest == 255
    which = record.plane(0, record.rows) if each else bytes([largest]) * record.rows
    others = _scalar(record, record.params[4:], 1 if each else 0)
    rows = []
    for index, (a, b, c) in zip(which, others, strict=True):
        rest = f32(1 - f32(f32(f32(a * a) + f32(b * b)) + f32(c * c)))
        row = [a, b, c]
        row.insert(index, f32(math.sqrt(max(rest, 0.0))))
        rows.append(_unit(row))
    return rows


def indices(record: Record, size: int) -> list[int]:
    """Return the indices of a vq stream, with escape rows counted from `size` on (SPEC 6.7)."""
    escape = struct.unpack("<II", record.params)[1]
    codes = _codes(record, 0, _bytes_per_code(size + (escape > 0)), record.rows)
    own = iter(range(size, size + escape))
    return [next(own) if code == size else code for code in codes]


def shn_basis(record: Record, basis: list[Row]) -> list[Row]:
    """Return shN as sums of a codebook's rows (SPEC 6.14)."""
    _, step, shrink, width, _ = struct.unpack_from("<IffHH", record.params)
    sizes = record.params[16:]
    ends = record.plane(0, record.rows)
    ranked = sorted(range(record.rows), key=lambda row: -ends[row])
    edges = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 18, 26, 255)
    codes: dict[tuple[int, int], int] = {}
    plane = 1
    for group, start in enumerate(edge for edge in edges if edge < width):
        for part in (0, 1):
            places = [
                (row, column)
                for column in range(start, min(edges[group + 1], width))
                for row in ranked
                if (ends[row] > column + 1 if part == 0 else ends[row] == column + 1)
            ]
            count = sizes[2 * group + part]
            found = _codes(record, plane, count, len(places))
            plane += count
            codes |= {place: code + part for place, code in zip(places, found, strict=True)}
    rows = [[0.0] * len(basis[0]) for _ in range(record.rows)]
    for row, column in sorted(codes):
        code = codes[row, column]
        if code:
            value = f32(f32((code + 1) // 2 - shrink) * step)
            signed = value if code % 2 else -value
            pairs = zip(rows[row], basis[column], strict=True)
            rows[row] = [f32(old + f32(signed * entry)) for old, entry in pairs]
    return rows
