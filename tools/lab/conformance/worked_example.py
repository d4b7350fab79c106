"""A chunk of the transform kinds, decoded step by step for SPEC's appendix A.2.

The file is built byte by byte from codes. The decoded values shown come from the reference decoder;
the intermediate values are computed here by the formulas of SPEC.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from . import reference_decoder
from . import reference_streams as streams
from .file_builder import ChunkRow, Draft, Group, Record, build, payload, root_keys
from .valid import Valid

NAME: Final = "worked"

_ROWS: Final = 3
_GRID = tuple[float, float, int]

# Grids: minimum, maximum and levels of each component.
_SCALE_GRIDS: Final = ((-5.0, -3.0, 5), (0.0, 1.5, 4), (0.0, 3.0, 4))
_FINE_SCALE_GRIDS: Final = ((-5.125, -2.875, 10), (0.0, 1.5, 4), (0.0, 3.0, 4))
_MEAN_GRIDS: Final = ((-1.0, 1.0, 3), (-2.0, 2.0, 5), (0.0, 3.0, 4))
_COLOUR_GRIDS: Final = ((-1.0, 1.0, 5), (-0.5, 0.5, 3), (0.25, 0.25, 1))
_OPACITY_GRID: Final = (-2.0, 6.0, 9)

# Codes of each component, row by row.
_SCALE_CODES: Final = ((4, 2, 0), (1, 3, 0), (0, 2, 1))
_SCALE_DIGITS: Final = (1, 0, 1)
_COLOUR_CODES: Final = ((0, 4, 3), (2, 0, 1))
_OPACITY_CODES: Final = (8, 3, 0)

# Means: cells in Morton order, low bits of each axis, and one bit that the refinement adds.
_CELLS: Final = ((0, 1, 0), (1, 1, 1), (2, 3, 1))
_LOW: Final = ((5, 2, 7), (100, 3, 64), (33, 0, 63))
_ADDED_BITS: Final = 1
_ADDED: Final = ((1, 0, 1), (1, 1, 1), (0, 1, 0))

_MEAN_MODEL: Final = (0.5, -1.0, 0.5, 0.25, 1.0, 0.5)
_SWING_MODEL: Final = (2.0, 0.0, 0.0, 0.0, 0.0, 2.0)
_TWIST_MODEL: Final = (7.5, 0.0, 0.0, -1.0, 0.0, 0.0)
_SWING_TWIST_CODES: Final = ((3, 20, 16), (1, 40, 8), (91, 32, 128))

_AXES: Final = (0.5, 0.5, 0.5, 0.5, 0.0, -0.5, 0.25, -0.5, 0.25)

# ShN on a basis: step, shrink, width; codes row by row up to the last that is not 0.
_STEP, _SHRINK, _WIDTH = 0.125, 0.25, 2
_SHN_CODES: Final = ((1, 2), (), (5,))
_BOOK: Final = (
    (0.5, 0.5, 0.5, 0.0, 0.0, 0.0, -0.25, -0.25, -0.25),
    (0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.5, 0.0, 0.0),
)


def _grids(rows: Sequence[_GRID]) -> bytes:
    return b"".join(struct.pack("<ffI", *row) for row in rows)


def _fields(pairs: Sequence[tuple[int, int]]) -> bytes:
    """Return bit fields of (number, width) pairs without gaps, lowest bit first (SPEC 6.15)."""
    total, at = 0, 0
    for number, width in pairs:
        total |= number << at
        at += width
    return total.to_bytes((at + 7) // 8, "little")


def _record(
    attribute: int, kind: int, components: int, params: bytes, planes: Sequence[bytes]
) -> Record:
    stored = [(len(plane), plane) for plane in planes]
    return Record([attribute, kind, components, 0, _ROWS], params, stored)


def _morton(cell: Sequence[int]) -> int:
    return sum((axis >> bit & 1) << 3 * bit + i for i, axis in enumerate(cell) for bit in range(17))


def _scales_of_head() -> list[list[float]]:
    """Return the log scales of each row, decoded from the head alone."""
    out = []
    for codes in zip(*_SCALE_CODES, strict=True):
        long, first, second = (
            low + code * (high - low) / (levels - 1)
            for code, (low, high, levels) in zip(codes, _SCALE_GRIDS, strict=True)
        )
        out.append([long - first, long - first - second, long])
    return out


def _extra(model: Sequence[float]) -> list[int]:
    params = struct.pack("<6f", *model)
    return [streams.extra_bits(params, row) for row in _scales_of_head()]


def _sorted_record() -> Record:
    codes = [_morton(cell) for cell in _CELLS]
    steps = [code - before for code, before in zip(codes, [0, *codes], strict=False)]
    classes = bytes(step.bit_length() for step in steps)
    differences = _fields([(s - (1 << s.bit_length() - 1), s.bit_length() - 1) for s in steps])
    extra = _extra(_MEAN_MODEL)
    low = _fields([(axis, h) for row, h in zip(_LOW, extra, strict=True) for axis in row])
    params = _grids(_MEAN_GRIDS) + struct.pack("<6f", *_MEAN_MODEL)
    return _record(streams.MEANS, streams.SORTED, 3, params, [classes, differences, low])


def swing_twist_record() -> Record:
    """Return the record of the quaternions; most of its 21 planes have 0 bytes."""
    planes: list[bytes] = []
    swing, twist = _extra(_SWING_MODEL), _extra(_TWIST_MODEL)
    for codes, extra in zip(_SWING_TWIST_CODES, (swing, swing, twist), strict=True):
        rows = list(zip(codes, extra, strict=True))
        planes += [
            bytes(code >> max(h - 6, 0) for code, h in rows if min(h, 6) == m) for m in range(1, 7)
        ]
        low = [(code & (1 << max(h - 6, 0)) - 1, max(h - 6, 0)) for code, h in rows]
        planes.append(_fields(low))
    params = struct.pack("<12f", *_SWING_MODEL, *_TWIST_MODEL)
    return _record(streams.QUATS, streams.SWING_TWIST, 4, params, planes)


def _shn_record() -> Record:
    ends = [len(codes) for codes in _SHN_CODES]
    ranked = sorted(range(_ROWS), key=lambda row: -ends[row])
    planes, sizes = [bytes(ends)], b""
    for column in range(_WIDTH):
        inner = bytes(_SHN_CODES[row][column] for row in ranked if ends[row] > column + 1)
        last = bytes(_SHN_CODES[row][column] - 1 for row in ranked if ends[row] == column + 1)
        planes += [plane for plane in (inner, last) if plane]
        sizes += bytes([bool(inner), bool(last)])
    params = struct.pack("<IffHH", 0, _STEP, _SHRINK, _WIDTH, 0) + sizes
    return _record(streams.SHN, streams.BASIS, 45, params, planes)


def _payloads(quats: Record | None) -> dict[SegmentKind, bytes]:
    """Return the payload of each segment; `quats` replaces the quaternions unless it is None."""
    scales = _record(
        streams.SCALES,
        streams.DIFFERENCES,
        3,
        _grids(_SCALE_GRIDS),
        [bytes(codes) for codes in _SCALE_CODES],
    )
    opacities = _record(
        streams.OPACITIES, streams.SCALAR, 1, _grids([_OPACITY_GRID]), [bytes(_OPACITY_CODES)]
    )
    colours = _record(
        streams.SH0,
        streams.BASIS,
        3,
        _grids(_COLOUR_GRIDS) + struct.pack("<9f", *_AXES),
        [bytes(codes) for codes in _COLOUR_CODES],
    )
    digits = _record(
        streams.SCALES,
        streams.DIGITS,
        3,
        _grids(_FINE_SCALE_GRIDS) + bytes([2, 1, 1]),
        [bytes(_SCALE_DIGITS)],
    )
    added = _fields([(bit, _ADDED_BITS) for row in _ADDED for bit in row])
    bits = _record(streams.MEANS, streams.BITS, 3, bytes([_ADDED_BITS, 0, 0, 0]), [added])
    octets = [struct.pack("<9f", *row) for row in _BOOK]
    columns = [bytes(row[byte] for row in octets) for byte in range(36)]
    band = Record(
        [streams.BANDS[0], streams.FLOAT, 9, 0, len(_BOOK)], b"", [(len(c), c) for c in columns]
    )
    return {
        SegmentKind.COLOUR_BAND1: payload([band]),
        SegmentKind.HEAD: payload(
            [scales, quats or swing_twist_record(), _sorted_record(), opacities, colours]
        ),
        SegmentKind.REFINEMENT: payload([digits, bits]),
        SegmentKind.TAIL: payload([_shn_record()]),
    }


def with_quats(quats: Record | None) -> bytes:
    """Return the example file; `quats`, if not None, replaces the record of its quaternions."""
    segments = [
        Segment(kind, 0, data, (0,) if kind == SegmentKind.TAIL else ())
        for kind, data in _payloads(quats).items()
    ]
    root = root_keys(_ROWS, 1, codebooks=[{"attribute": "colour", "rows": len(_BOOK)}])
    return build(Draft(root, [Group(segments, [ChunkRow(_ROWS)])]))


def valid() -> Valid:
    """Return the example file as a valid vector."""
    data = with_quats(None)
    clauses = ("6.5", "6.10", "6.11", "6.12", "6.13", "6.14", "6.16", "6.17")
    return Valid(NAME, data, clauses, "three splats of the transform kinds, decoded in appendix A")


def _text(value: float) -> str:
    """Return the shortest decimal text that rounds to the same float32."""
    if value == int(value):
        return str(int(value))
    return next(
        text
        for digits in range(1, 10)
        if streams.f32(float(text := f"{value:.{digits}g}")) == streams.f32(value)
    )


def _row(values: Sequence[float]) -> str:
    return ", ".join(_text(value) for value in values)


def lines() -> list[str]:
    """Return the lines of the worked example."""
    data = valid().data
    coarse = reference_decoder.decode(data, refine=False).rows
    fine = reference_decoder.decode(data).rows
    return [
        *_scale_lines(coarse["scales"], fine["scales"]),
        "",
        *_model_lines(coarse["scales"]),
        "",
        *_mean_lines(coarse["means"], fine["means"]),
        "",
        *_rotation_lines(coarse["quats"]),
        "",
        *_colour_lines(coarse),
        "",
        *_shn_lines(coarse["shN"]),
    ]


def _scale_lines(coarse: Sequence[streams.Row], fine: Sequence[streams.Row]) -> Iterator[str]:
    yield "scales: differences (6.12) of l, u, v; steps 0.5, 0.5, 1; then scales (m, t, l)"
    for row, codes in enumerate(zip(*_SCALE_CODES, strict=True)):
        yield f"  row {row}: codes {_row(codes)}: {_row(coarse[row])}"
    yield "  refined by digits (6.16) of radix 2, 1, 1; the fine grid of l has the step 0.25"
    for row, digit in enumerate(_SCALE_DIGITS):
        code = 2 * _SCALE_CODES[0][row] + digit
        yield f"  row {row}: digit {digit}, fine code of l {code}: {_row(fine[row])}"


def _model_lines(scales: Sequence[streams.Row]) -> Iterator[str]:
    yield "extra bits (6.10), from the scales of the head alone"
    models = {"means": _MEAN_MODEL, "swing": _SWING_MODEL, "twist": _TWIST_MODEL}
    for name, model in models.items():
        yield f"  {name}: c0 to c5 = {_row(model)}"
    for row, (middle, thin, long) in enumerate(scales):
        p, q = streams.f32(long - middle), streams.f32(middle - thin)
        features = [long, min(p, 1.5), min(p, 5.0), min(q, 0.5), min(q, 3.0)]
        sums = []
        for name, model in models.items():
            total = model[0]
            for factor, feature in zip(model[1:], features, strict=True):
                total = streams.f32(total + streams.f32(factor * feature))
            bits = streams.extra_bits(struct.pack("<6f", *model), scales[row])
            sums.append(f"{name} {_text(total)}, h = {bits}")
        yield f"  row {row}: p = {_text(p)}, q = {_text(q)}: {'; '.join(sums)}"


def _mean_lines(coarse: Sequence[streams.Row], fine: Sequence[streams.Row]) -> Iterator[str]:
    """Yield the lines on the means: decoded without refinement, then with it."""
    planes = _sorted_record().planes
    yield "means: sorted (6.5), steps of the cells 1, 1, 1"
    yield f"  plane 0, classes: {_row(list(planes[0][1]))}"
    yield f"  plane 1, differences: bytes {planes[1][1].hex(' ')}"
    yield f"  plane 2, low bits: bytes {planes[2][1].hex(' ')}"
    added = _fields([(bit, _ADDED_BITS) for row in _ADDED for bit in row])
    yield f"  plane 0 of the refinement's bits: bytes {added.hex(' ')}"
    before = 0
    for row, h in enumerate(_extra(_MEAN_MODEL)):
        code = _morton(_CELLS[row])
        codes = [cell << h | low for cell, low in zip(_CELLS[row], _LOW[row], strict=True)]
        yield (
            f"  row {row}: d = {code - before}, Morton code {code}, cell {_row(_CELLS[row])}; "
            f"low bits {_row(_LOW[row])}"
        )
        yield f"    codes {_row(codes)}, step 2^-{h}: {_row(coarse[row])}"
        finer = [2 * c + d - 1 for c, d in zip(codes, _ADDED[row], strict=True)]
        yield (
            f"    refined (6.17), E = {_ADDED_BITS}, d = {_row(_ADDED[row])}: "
            f"codes {_row(finer)}, step 2^-{h + _ADDED_BITS}: {_row(fine[row])}"
        )
        before = code


def _rotation_lines(rows: Sequence[streams.Row]) -> Iterator[str]:
    yield "quats: swing-twist (6.11)"
    labels = [*(f"m = {m}" for m in range(1, 7)), "low bits"]
    names = [f"{component}, {label}" for component in "abc" for label in labels]
    filled = [
        f"{name}: {plane.hex(' ')}"
        for name, (_, plane) in zip(names, swing_twist_record().planes, strict=True)
        if plane
    ]
    yield "  of the 21 planes these have bytes:"
    yield f"    {'; '.join(filled)}"
    swing, twist = _extra(_SWING_MODEL), _extra(_TWIST_MODEL)
    for row, quat in enumerate(rows):
        codes = [column[row] for column in _SWING_TWIST_CODES]
        a, b, c = (
            streams.f32(streams.f32(code * 2.0 ** (1 - h)) - 1)
            for code, h in zip(codes, (swing[row], swing[row], twist[row]), strict=True)
        )
        x = streams.f32(a + streams.f32(b * c))
        y = streams.f32(b - streams.f32(a * c))
        yield f"  row {row}: codes {_row(codes)}: a, b, c = {_row([a, b, c])}"
        yield f"    1, {_row([x, y, c])}, divided by the norm: {_row(quat)}"


def _colour_lines(coarse: Mapping[str, Sequence[Sequence[float]]]) -> Iterator[str]:
    yield "opacities: scalar (6.4), step 1"
    logits = [row[0] for row in coarse["opacities"]]
    yield f"  codes {_row(_OPACITY_CODES)}: {_row(logits)}"
    yield "sh0: basis (6.13), coordinates on the axes " + "; ".join(
        f"({_row(_AXES[start : start + 3])})" for start in (0, 3, 6)
    )
    for row, codes in enumerate(zip(*_COLOUR_CODES, strict=True)):
        coordinates = [
            low + code * (high - low) / (levels - 1)
            for code, (low, high, levels) in zip(codes, _COLOUR_GRIDS[:2], strict=True)
        ]
        coordinates.append(_COLOUR_GRIDS[2][0])
        yield (
            f"  row {row}: codes {_row(codes)}: x, y, z = {_row(coordinates)}: "
            f"{_row(coarse['sh0'][row])}"
        )


def _shn_lines(rows: Sequence[streams.Row]) -> Iterator[str]:
    record = _shn_record()
    yield f"shN: basis (6.14), step {_text(_STEP)}, shrink {_text(_SHRINK)}, two coordinates"
    for number, basis in enumerate(_BOOK):
        yield f"  row {number} of the codebook: {_row(basis)}"
    yield f"  sizes of inner and last codes: {_row(list(record.params[16:]))}"
    ends = _row(list(record.planes[0][1]))
    yield f"  plane 0, ends: {ends}; the order of falling ends is 0, 2, 1"
    lists = ("coordinate 0, inner codes", "coordinate 0, last codes", "coordinate 1, last codes")
    for number, what in enumerate(lists, start=1):
        yield f"  plane {number}, {what}: {_row(list(record.planes[number][1]))}"
    for row, codes in enumerate(_SHN_CODES):
        values: list[float] = []
        for code in codes:
            value: float = streams.f32(streams.f32((code + 1) // 2 - _SHRINK) * _STEP)
            values.append(value if code % 2 else -value)
        shown = f"codes {_row(codes)}, coordinates {_row(values)}" if codes else "no coordinates"
        yield f"  row {row}: {shown}:"
        yield f"    {_row(rows[row])}"
