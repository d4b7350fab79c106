"""Streams of scales as a ladder and of rotations as turns (SPEC 6.11, 6.12)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import compiled, turn
from . import grid as grids
from . import resolution as resolutions
from .errors import FormatError
from .grid import ENTRY_BYTES, Grid
from .resolution import RESOLUTION_BYTES, Resolution
from .streams import Attribute, Kind, StoredStream, Stream, read_grid_planes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

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


def read_ladder(stream: StoredStream, out: F32) -> None:
    """Write the scales of a ladder stream into (rows, 3) float32 `out`."""
    stream.require_kind(Kind.LADDER)
    grid = grids.unpack(stream.require_params(3 * ENTRY_BYTES), 3, stream.where)
    steps = np.empty((stream.rows, 3), np.float32)
    read_grid_planes(stream, grid, 0, 0, steps)
    if compiled.ready():
        from . import decode_kernels

        decode_kernels.climb(steps, out)
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


def read_turns(stream: StoredStream, scales: F32, out: F32) -> None:
    """Write the quaternions of a turn stream into (rows, 4) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    scales : (rows, 3) float32
        The same rows' decoded scales.
    out : (rows, 4) float32
    """
    stream.require_kind(Kind.TURN)
    params = stream.require_params(2 * RESOLUTION_BYTES)
    tilt = resolutions.unpack(params[:RESOLUTION_BYTES], stream.where)
    spin = resolutions.unpack(params[RESOLUTION_BYTES:], stream.where)
    values = np.empty((stream.rows, 3), np.float32)
    plane = 0
    if compiled.ready() and _compiled_turns(stream, scales, (tilt, spin), out):
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
    for column, halvings in enumerate(columns):
        symbols: list[U8] = []
        for rows in counts[column]:
            symbols.append(stream.plane(plane, rows))
            plane += 1
        rest = stream.plane(plane, turn.rest_bytes(halvings))
        plane += 1
        codes = turn.join(symbols, rest, halvings, stream.where)
        if bool((codes > np.left_shift(np.uint32(1), halvings.astype(np.uint32))).any()):
            raise FormatError(
                "code-range",
                f"{stream.where}: a code beyond the levels of its row in component {column}",
                clause="6.11",
            )
        values[:, column] = turn.dequantise(codes, halvings)
    out[:] = turn.quats_of(values)


def _compiled_turns(
    stream: StoredStream, scales: F32, resolved: tuple[Resolution, Resolution], out: F32
) -> bool:
    from . import decode_kernels

    coefficients = np.array([resolution.coefficients for resolution in resolved], np.float32)
    halved = np.empty((2, stream.rows), np.uint8)
    counts = np.empty((2, decode_kernels.SYMBOL_GROUPS + 1), np.int64)
    decode_kernels.turn_plan(
        scales, coefficients, resolutions.KNEES, resolutions.MAX_HALVINGS, halved, counts
    )
    tilt, spin = (
        [*(n for n in groups[1:-1] if n), groups[-1] + 7 >> 3] for groups in counts.tolist()
    )
    lengths = tilt * _TILTS + spin
    if len(stream.words) != len(lengths):
        return False
    planes = stream.joined(0, lengths)
    return decode_kernels.turns(planes, halved, counts, turn.STEPS, out)


def _halvings(scales: F32, tilt: Resolution, spin: Resolution) -> list[U8]:
    tilts = tilt.halvings(scales)
    return [tilts] * _TILTS + [spin.halvings(scales)]
