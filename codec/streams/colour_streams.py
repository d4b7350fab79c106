"""Streams of colour on a basis: sh0 on three axes, shN on rows of a codebook (SPEC 6.13, 6.14)."""

from __future__ import annotations

import struct
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import compiled, refinement
from . import grid as grids
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream, read_grid_planes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

_AXES_BYTES: Final = 36
_SHN: Final = struct.Struct("<IffHH")

MAX_BASIS_ROWS: Final = 255
"""Most rows of a basis: the number of a row fits a byte (SPEC 6.14)."""

MAX_FACTOR: Final = 2.0**32
"""Largest step of shN and magnitude in its basis: sums of products stay finite (SPEC 6.14)."""

# First columns of the groups that share planes: the strongest alone, then the sparse together.
_GROUP_STARTS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 18, 26)

# Rows of sums and products that stay in the second-level cache.
_BLOCK: Final = 1024


def sh0_on_axes(values: F32, axes: F32, grid: Grid) -> tuple[Stream, F32]:
    """Return a basis stream of sh0 and what it decodes to.

    Parameters
    ----------
    values : (n, 3) float32
        Coordinates on the axes.
    axes : (3, 3) float32
        Row j is the sh0 of one unit on axis j.
    grid : Grid
        Of the coordinates.
    """
    codes = grid.quantise(values)
    planes: list[U8] = []
    for component in range(3):
        planes += grids.split_planes(codes[:, component], int(grid.levels[component]))
    params = grid.pack() + axes.astype("<f4").tobytes()
    stream = Stream(Attribute.SH0, Kind.BASIS, len(values), params, planes)
    return stream, _on_axes(grid.dequantise(codes), axes)


def _on_axes(values: F32, axes: F32) -> F32:
    y = values
    out = np.empty_like(values)
    for channel in range(3):
        a, b, c = axes[:, channel]
        out[:, channel] = (y[:, 0] * a + y[:, 1] * b) + y[:, 2] * c
    return out


def read_sh0(stream: StoredStream, out: F32, finer: StoredStream | None = None) -> None:
    """Write the sh0 of a basis stream into (rows, 3) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    out : (rows, 3) float32
    finer : StoredStream, optional
        Digits that refine its coordinates (SPEC 6.16).
    """
    stream.require_kind(Kind.BASIS)
    params = stream.require_params(3 * ENTRY_BYTES + _AXES_BYTES)
    grid = grids.unpack(params[: 3 * ENTRY_BYTES], 3, stream.where)
    axes = np.frombuffer(params[3 * ENTRY_BYTES :], "<f4").reshape(3, 3).astype(np.float32)
    if not bool((np.abs(axes) <= 1).all()):
        raise FormatError(
            "basis-value",
            f"{stream.where}: axes {axes.tolist()}, expected values within ±1",
            clause="6.13",
        )
    values = np.empty((stream.rows, 3), np.float32)
    if finer is None:
        read_grid_planes(stream, grid, 0, 0, values)
    else:
        refinement.read_digits(stream, grid, finer, values, values[:0])
    if compiled.ready():
        from . import kernels

        kernels.on_axes(values, axes, out)
        return
    out[:] = _on_axes(values, axes)


def shn_on_basis(codes: I64, codebook: int, step: float, shrink: float) -> Stream:
    """Return a basis stream of shN.

    Parameters
    ----------
    codes : (n, k) int64
        Coordinates on the basis in steps, signed.
    codebook : int
        The basis.
    step : float
        What one step is worth.
    shrink : float
        What is taken off every non-zero coordinate, in steps: 0 to 0.5.
    """
    used = np.flatnonzero(codes.any(axis=0))
    width = int(used[-1]) + 1 if len(used) else 0
    codes = codes[:, :width]
    ends = ((codes != 0) * np.arange(1, width + 1)).max(axis=1, initial=0).astype(np.uint8)
    # Rows of most coordinates first: each coordinate's rows are a run, and so are its last ones.
    order, bounds = _runs(ends, width)
    ranked = codes[order]
    zigzag = np.where(ranked > 0, 2 * ranked - 1, -2 * ranked).astype(np.uint32)
    planes: list[U8] = [ends]
    sizes = bytearray()
    for columns in _groups(width):
        inner = [zigzag[: bounds[c + 1], c] for c in columns]
        last = [zigzag[bounds[c + 1] : bounds[c], c] - np.uint32(1) for c in columns]
        for symbols in (np.concatenate(inner), np.concatenate(last)):
            size = grids.code_bytes(int(symbols.max(initial=0)) + 1)
            sizes.append(size)
            planes += grids.split_planes(symbols, 1 << (8 * size)) if size else []
    params = _SHN.pack(codebook, step, shrink, width, 0) + bytes(sizes)
    return Stream(Attribute.SHN, Kind.BASIS, len(codes), params, planes)


@cache
def _groups(width: int) -> tuple[range, ...]:
    """Return the columns that share planes: single ones first, then more and more (SPEC 6.14)."""
    stops = [min(start, width) for start in (*_GROUP_STARTS[1:], width)]
    groups = [range(a, b) for a, b in zip(_GROUP_STARTS, stops, strict=True)]
    return tuple(group for group in groups if len(group))


def _runs(ends: U8, width: int) -> tuple[I64, list[int]]:
    """Return rows by descending number of coordinates, and how many rows have more than each."""
    order = np.argsort(np.uint8(255) - ends, kind="stable").astype(np.int64)
    counts = np.bincount(ends, minlength=width + 1)
    above: list[int] = (len(ends) - np.cumsum(counts)).tolist()
    return order, above


def basis_codebook(stream: StoredStream) -> int:
    """Return the codebook that a basis stream of shN names."""
    stream.require_kind(Kind.BASIS)
    return int(_SHN.unpack_from(_shn_params(stream))[0])


def _shn_params(stream: StoredStream) -> memoryview:
    if len(stream.params) < _SHN.size:
        raise FormatError(
            "stream-params",
            f"{stream.where}: {len(stream.params)} bytes of parameters, expected at least "
            f"{_SHN.size}",
            clause="6.14",
        )
    width = int(_SHN.unpack_from(stream.params)[3])
    return stream.require_params(_SHN.size + 2 * len(_groups(width)))


def read_shn(stream: StoredStream, basis: F32, out: F32) -> None:
    """Write the shN of a basis stream into (rows, K-1, 3) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    basis : (B, K-1, 3) float32
        Rows of the codebook, cut to the bands that are wanted.
    out : (rows, K-1, 3) float32
    """
    params = _shn_params(stream)
    _, step, shrink, width, reserved = _SHN.unpack_from(params)
    if width > min(len(basis), MAX_BASIS_ROWS) or reserved:
        raise FormatError(
            "basis-width",
            f"{stream.where}: {width} rows of a basis of {len(basis)} and reserved {reserved}, "
            "expected no more, and 0",
            clause="6.14",
        )
    if not 0 < step <= MAX_FACTOR or not 0 <= shrink <= 0.5:
        raise FormatError(
            "basis-value",
            f"{stream.where}: step {step} and shrink {shrink}, expected up to {MAX_FACTOR:g} "
            "and 0 to 0.5",
            clause="6.14",
        )
    largest = float(np.abs(basis[:width]).max(initial=0))
    if largest > MAX_FACTOR:
        raise FormatError(
            "basis-value",
            f"{stream.where}: {largest:g} in the basis, expected up to {MAX_FACTOR:g}",
            clause="6.14",
        )
    sizes = params[_SHN.size :]
    expected = 1 + sum(sizes)
    if max(sizes, default=0) > 3 or len(stream.words) != expected:
        raise FormatError(
            "stream-planes",
            f"{stream.where}: {len(stream.words)} planes, codes of {list(sizes)} bytes, "
            f"expected {expected} planes and at most 3 bytes",
            clause="6.14",
        )
    ends = stream.plane(0, stream.rows)
    if int(ends.max(initial=0)) > width:
        raise FormatError(
            "code-range",
            f"{stream.where}: {int(ends.max())} coordinates, expected at most {width}",
            clause="6.14",
        )
    # Not -1: there may be no rows.
    columns_of_basis = 3 * basis.shape[1]
    rows_of_basis = basis.reshape(len(basis), columns_of_basis)
    if compiled.ready():
        _compiled_shn(stream, ends, bytes(sizes), width, rows_of_basis, (step, shrink), out)
        return
    order, bounds = _runs(ends, width)
    step32, shrink32 = np.float32(step), np.float32(shrink)
    octets = np.arange(256, dtype=np.uint32)
    tables = [_worth(octets + np.uint32(part), step32, shrink32) for part in range(2)]
    ranked = np.zeros((bounds[0] if width else 0, rows_of_basis.shape[1]), np.float32)
    plane = 1
    for group, columns in enumerate(_groups(width)):
        counts = [bounds[c + 1] for c in columns], [bounds[c] - bounds[c + 1] for c in columns]
        values: list[F32] = []
        for part in range(2):
            number = sizes[2 * group + part]
            length = sum(counts[part])
            parts = [stream.plane(plane + byte, length) for byte in range(number)]
            plane += number
            values.append(_coordinates(parts, length, tables[part], part, (step32, shrink32)))
        starts = [0, 0]
        for column in columns:
            inner, outer = bounds[column + 1], bounds[column]
            for part, rows in enumerate((ranked[:inner], ranked[inner:outer])):
                stop = starts[part] + len(rows)
                _add(rows, values[part][starts[part] : stop], rows_of_basis[column])
                starts[part] = stop
    flat = out.reshape(len(out), columns_of_basis)
    flat[order[: len(ranked)]] = ranked
    flat[order[len(ranked) :]] = 0


def _compiled_shn(
    stream: StoredStream,
    ends: U8,
    sizes: bytes,
    width: int,
    basis: F32,
    factors: tuple[float, float],
    out: F32,
) -> None:
    from . import kernels

    groups = _groups(width)
    more = kernels.above(ends, width)
    above = more.tolist()
    lengths: list[int] = []
    for group, columns in enumerate(groups):
        inner = sum(above[c + 1] for c in columns)
        last = above[columns.start] - above[columns.stop]
        lengths += [inner] * sizes[2 * group] + [last] * sizes[2 * group + 1]
    planes = stream.joined(1, lengths)
    wide = np.zeros((width, kernels.BASIS_COLUMNS), np.float32)
    wide[:, : basis.shape[1]] = basis[:width]
    step, shrink = factors
    kernels.shn(
        ends,
        more,
        np.array([*(columns.start for columns in groups), width], np.int64),
        np.frombuffer(sizes, np.uint8),
        planes,
        wide,
        np.float32(step),
        np.float32(shrink),
        out.reshape(len(out), basis.shape[1]),
    )


def _add(sums: F32, values: F32, row: F32) -> None:
    """Add a basis row times its coordinates, by blocks of rows that stay in cache."""
    product = np.empty((min(_BLOCK, len(sums)), sums.shape[1]), np.float32)
    for start in range(0, len(sums), _BLOCK):
        block = sums[start : start + _BLOCK]
        part = product[: len(block)]
        np.multiply(values[start : start + _BLOCK, None], row, out=part)
        block += part


def _coordinates(
    planes: list[U8], rows: int, table: F32, offset: int, factors: tuple[np.float32, np.float32]
) -> F32:
    """Return (rows,) float32 coordinates of the planes of a part (SPEC 6.14)."""
    if not planes:
        return np.full(rows, table[0])
    if len(planes) == 1:
        return table.take(planes[0])
    return _worth(grids.join_planes(planes, rows) + np.uint32(offset), *factors)


def _worth(zigzag: U32, step: np.float32, shrink: np.float32) -> F32:
    magnitude = ((zigzag + np.uint32(1)) >> np.uint32(1)).astype(np.float32)
    value = np.where(zigzag > 0, magnitude - shrink, np.float32(0)) * step
    out: F32 = np.where(zigzag & np.uint32(1), value, -value)
    return out
