"""Streams of scales as a ladder and of rotations as turns (SPEC 6.11, 6.12)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import adaptive_step as resolutions
from . import bit_fields, compiled, refinement, turn
from . import grid as grids
from .adaptive_step import RESOLUTION_BYTES, Resolution
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream, read_grid_planes
from .refinement import Finer

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]

_TILTS: Final = 2


def ladder(values: F32, grid: Grid) -> Stream:
    """Return a ladder stream of scales.

    Parameters
    ----------
    values : (n, 3) float32
        The longest log scale, how much shorter the middle one is, and how much the thin one is
        again (`steps_of`).
    grid : Grid
        Of those three.
    """
    codes = grid.quantise(values)
    planes: list[U8] = []
    for component in range(3):
        planes += grids.split_planes(codes[:, component], int(grid.levels[component]))
    return Stream(Attribute.SCALES, Kind.LADDER, len(values), grid.pack(), planes)


def steps_of(scales: F32) -> F32:
    """Return the ladder of (n, 3) log scales in the order middle, thin, long."""
    middle, thin, long = scales.T
    return np.stack([long, long - middle, middle - thin], axis=1)


def climb(steps: F32) -> F32:
    """Return the (n, 3) log scales, middle, thin, long, of a decoded ladder (SPEC 6.12)."""
    out = np.empty_like(steps)
    out[:, 2] = steps[:, 0]
    out[:, 0] = steps[:, 0] - steps[:, 1]
    out[:, 1] = out[:, 0] - steps[:, 2]
    return out


def read_ladder(
    stream: StoredStream, out: F32, finer: StoredStream | None = None, coarse: F32 | None = None
) -> None:
    """Write the scales of a ladder stream into (rows, 3) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    out : (rows, 3) float32
    finer : StoredStream, optional
        Digits that refine them (SPEC 6.16).
    coarse : (rows, 3) float32, optional
        With digits: for the scales of the head alone.
    """
    stream.require_kind(Kind.LADDER)
    grid = grids.unpack(stream.require_params(3 * ENTRY_BYTES), 3, stream.where)
    steps = np.empty((stream.rows, 3), np.float32)
    if finer is None or coarse is None:
        read_grid_planes(stream, grid, 0, 0, steps)
    else:
        coarse_steps = np.empty_like(steps)
        refinement.read_digits(stream, grid, finer, steps, coarse_steps)
        _climb(coarse_steps, coarse)
    _climb(steps, out)


def _climb(steps: F32, out: F32) -> None:
    if compiled.ready():
        from . import kernels

        kernels.climb(steps, out)
        return
    out[:] = climb(steps)


def turns(values: F64, scales: F32, tilt: Resolution, spin: Resolution) -> tuple[Stream, F32]:
    """Return a turn stream and the turns it decodes to.

    Parameters
    ----------
    values : (n, 3) float64
        Tilt (a, b) and spin c of `turn.canonical`.
    scales : (n, 3) float32
        As decoded: middle, thin, long.
    tilt, spin : Resolution
        Halvings of the tilts' and the spin's step of 2.
    """
    planes: list[U8] = []
    decoded = np.empty(values.shape, np.float32)
    for column, halvings in enumerate(_halvings(scales, tilt, spin)):
        codes = turn.quantise(values[:, column], halvings)
        symbols, rest = turn.split(codes, halvings)
        planes += [*symbols, rest]
        decoded[:, column] = turn.dequantise(codes, halvings)
    params = tilt.pack() + spin.pack()
    return Stream(Attribute.QUATS, Kind.TURN, len(values), params, planes), decoded


def refined_turns(
    values: F64, scales: F32, tilt: Resolution, spin: Resolution, fine: F32, constants: list[float]
) -> tuple[Stream, Stream, F32]:
    """Return a coarse turn stream, what refines it, and the turns of the first alone.

    Parameters
    ----------
    values, scales, tilt, spin
        As `turns` takes them, of the head alone.
    fine : (n, 3) float32
        The scales, refined.
    constants : list of float
        First coefficients of the finer tilt and spin.
    """
    planes: list[U8] = []
    columns = _halvings(scales, tilt, spin)
    finer = [
        refinement.with_constant(one, constant)
        for one, constant in zip((tilt, spin), constants, strict=True)
    ]
    tilts, spins = (
        refinement.gained(one, fine, halvings)
        for one, halvings in zip(finer, (columns[0], columns[2]), strict=True)
    )
    fields = np.zeros(len(values), np.uint64)
    widths = np.zeros(len(values), np.uint8)
    below: list[U8] = []
    decoded = np.empty(values.shape, np.float32)
    for column, (halvings, extra) in enumerate(zip(columns, (tilts, tilts, spins), strict=True)):
        codes = turn.quantise(values[:, column], halvings + extra)
        alone, more = _apart(halvings, extra)
        symbols, rest = turn.split(np.where(halvings == 0, codes, 0), alone)
        below += [*symbols, rest]
        coarse, field = refinement.coarse_of(codes, more)
        coarse = np.where(halvings == 0, np.uint32(0), coarse)
        decoded[:, column] = turn.dequantise(coarse, halvings)
        symbols, rest = turn.split(coarse, halvings)
        planes += [*symbols, rest]
        fields |= np.where(halvings == 0, np.uint64(0), field) << widths.astype(np.uint64)
        widths += more
    below.append(bit_fields.pack(fields, widths))
    params = tilt.pack() + spin.pack()
    head = Stream(Attribute.QUATS, Kind.TURN, len(values), params, planes)
    refined = refinement.bits_stream(Attribute.QUATS, constants, below, len(values))
    return head, refined, decoded


def _apart(halvings: U8, extra: U8) -> tuple[U8, U8]:
    """Return what a refinement adds to rows without halvings, and to the others."""
    none = halvings == 0
    zero = np.uint8(0)
    return np.where(none, extra, zero), np.where(none, zero, extra)


def read_turns(stream: StoredStream, scales: F32, out: F32, finer: Finer | None = None) -> None:
    """Write the quaternions of a turn stream into (rows, 4) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    scales : (rows, 3) float32
        The same rows' scales, as the head alone has them.
    out : (rows, 4) float32
    finer : Finer, optional
        What refines them (SPEC 6.17).
    """
    stream.require_kind(Kind.TURN)
    params = stream.require_params(2 * RESOLUTION_BYTES)
    tilt = resolutions.unpack(params[:RESOLUTION_BYTES], stream.where)
    spin = resolutions.unpack(params[RESOLUTION_BYTES:], stream.where)
    values = np.empty((stream.rows, 3), np.float32)
    plane = 0
    if compiled.ready() and _compiled_turns(stream, scales, (tilt, spin), finer, out):
        return
    columns = _halvings(scales, tilt, spin)
    counts = [turn.group_rows(halvings) for halvings in columns]
    wanted = sum(len(rows) + 1 for rows in counts)
    if len(stream.words) != wanted:
        raise FormatError(
            "stream-planes",
            f"{stream.where}: {len(stream.words)} planes, expected {wanted}",
            clause="6.11",
        )
    codes: list[U32] = []
    for column, halvings in enumerate(columns):
        found, plane = _column(stream, plane, halvings, counts[column])
        if bool((found > np.left_shift(np.uint32(1), halvings.astype(np.uint32))).any()):
            raise FormatError(
                "code-range",
                f"{stream.where}: a code beyond the levels of its row in component {column}",
                clause="6.11",
            )
        codes.append(found)
    if finer is not None:
        codes, columns = _refined(codes, columns, (tilt, spin), finer)
    for column, halvings in enumerate(columns):
        values[:, column] = turn.dequantise(codes[column], halvings)
    out[:] = turn.quats_of(values)


def _column(stream: StoredStream, plane: int, halvings: U8, counts: list[int]) -> tuple[U32, int]:
    """Return the codes of a component and the number of the plane behind it."""
    symbols = [stream.plane(plane + index, rows) for index, rows in enumerate(counts)]
    plane += len(counts)
    rest = stream.plane(plane, turn.rest_bytes(halvings))
    return turn.join(symbols, rest, halvings, stream.where), plane + 1


def _refined(
    codes: list[U32], columns: list[U8], coarse: tuple[Resolution, Resolution], finer: Finer
) -> tuple[list[U32], list[U8]]:
    """Return codes and halvings with those of a refinement (SPEC 6.17)."""
    tilts, spins = finer.extra(coarse, (columns[0], columns[2]))
    extra = [tilts, tilts, spins]
    parts = [_apart(halvings, more) for halvings, more in zip(columns, extra, strict=True)]
    counts = [turn.group_rows(alone) for alone, _ in parts]
    finer.stream.require_planes(sum(len(rows) + 1 for rows in counts) + 1)
    out: list[U32] = []
    plane = 0
    for index, (alone, _) in enumerate(parts):
        found, plane = _column(finer.stream, plane, alone, counts[index])
        out.append(found)
    widths = parts[0][1] + parts[1][1] + parts[2][1]
    fields = finer.fields(plane, widths)
    for index, (halvings, (_, more)) in enumerate(zip(columns, parts, strict=True)):
        below = fields & ((np.uint64(1) << more.astype(np.uint64)) - np.uint64(1))
        fields >>= more.astype(np.uint64)
        wide = codes[index].astype(np.int64) << more.astype(np.int64)
        wide += below.astype(np.int64) - refinement.half_of(more)
        wide = np.where(halvings == 0, out[index].astype(np.int64), wide)
        top = np.int64(1) << (halvings + extra[index]).astype(np.int64)
        if bool(((wide < 0) | (wide > top)).any()):
            raise finer.refuse()
        out[index] = wide.astype(np.uint32)
    return out, [halvings + more for halvings, more in zip(columns, extra, strict=True)]


def _compiled_turns(
    stream: StoredStream,
    scales: F32,
    resolved: tuple[Resolution, Resolution],
    finer: Finer | None,
    out: F32,
) -> bool:
    from . import kernels

    coefficients = np.array([resolution.coefficients for resolution in resolved], np.float32)
    halved = np.empty((2, stream.rows), np.uint8)
    counts = np.empty((2, kernels.SYMBOL_GROUPS + 1), np.int64)
    kernels.turn_plan(
        scales, coefficients, resolutions.KNEES, resolutions.MAX_HALVINGS, halved, counts
    )
    tilt, spin = (
        [*(n for n in groups[1:-1] if n), groups[-1] + 7 >> 3] for groups in counts.tolist()
    )
    lengths = tilt * _TILTS + spin
    if len(stream.words) != len(lengths):
        return False
    planes = stream.joined(0, lengths)
    extra = np.empty((2, 0), np.uint8)
    more = np.zeros_like(counts)
    below = np.empty(2, np.uint8)
    if finer is not None:
        extra = np.stack(finer.extra(resolved, (halved[0], halved[1])))
        tilt, spin = _below_lengths(halved, extra, more)
        lengths = tilt * _TILTS + spin
        spare = int(more[:, 0] @ (_TILTS, 1))
        lengths.append(spare + 7 >> 3)
        if len(finer.stream.words) != len(lengths):
            return False
        below = finer.stream.joined(0, lengths)
        if spare & 7 and int(below[-3]) >> (spare & 7):
            return False
    fields = kernels.words(below[sum(lengths[:-1]) :])
    return kernels.turns(planes, halved, counts, turn.STEPS, extra, more, below, fields, out)


def _below_lengths(halved: U8, extra: U8, counts: I64) -> tuple[list[int], list[int]]:
    """Return the lengths of planes that a refinement adds to a tilt and to the spin.

    `counts` is filled as `kernels.turn_plan` does, for the rows without halvings in the
    head; in column 0 stand the bits of the others.
    """
    from . import kernels

    kernels.gained_plan(halved, extra, counts)
    tilt, spin = (
        [*(n for n in groups[1:-1] if n), groups[-1] + 7 >> 3] for groups in counts.tolist()
    )
    return tilt, spin


def _halvings(scales: F32, tilt: Resolution, spin: Resolution) -> list[U8]:
    tilts = tilt.halvings(scales)
    return [tilts] * _TILTS + [spin.halvings(scales)]
