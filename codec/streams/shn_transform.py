"""Basis streams of shN: sparse coordinates on the rows of a codebook (SPEC 6.14)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import grid_planes
from .codebook_index import CodebookUse
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

PARAMS: Final = struct.Struct("<IffHH")
"""Fixed parameters: codebook, step, shrink, width, reserved; code sizes follow (SPEC 6.14)."""

MAX_BASIS_ROWS: Final = 255
"""Maximum number of basis rows in use: the number of a row fits a byte (SPEC 6.14)."""

MAX_FACTOR: Final = 2.0**32
"""Largest step, and largest magnitude in a basis: sums of products stay finite (SPEC 6.14)."""

GROUP_STARTS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 18, 26)
"""First coordinate of each group of coordinates that share planes.

The first coordinates are large and have groups of their own; the last are mostly 0."""

# Rows per block: sums and products of a block fit the second-level cache.
_BLOCK: Final = 2048


@dataclass(frozen=True)
class Parameters:
    """Parameters of a basis stream of shN.

    The shN of a splat is a sum of codebook rows, the basis; its coordinates are their weights. The
    codes of a splat end with its last non-zero coordinate: that code is its last code, all codes
    before it are inner codes.

    Parameters
    ----------
    step : float
        Quantiser step of the coordinates.
    shrink : float
        Reduction of the magnitude of each non-zero coordinate, in steps.
    width : int
        Number of coordinates in use.
    sizes : bytes
        For each group of coordinates that share planes: bytes per inner code, then bytes per last
        code.
    """

    step: float
    shrink: float
    width: int
    sizes: bytes


def write(codes: I64, codebook: int, step: float, shrink: float) -> Stream:
    """Return a basis stream of shN, given quantised coordinates.

    Parameters
    ----------
    codes : (n, k) int64
        Quantised coordinates: signed multiples of `step`.
    codebook : int
        Number of the codebook whose rows are the basis.
    step : float
        Quantiser step of the coordinates.
    shrink : float
        Part of a step by which decoders reduce the magnitude of non-zero coordinates, 0 to 0.5.
    """
    used = np.flatnonzero(codes.any(axis=0))
    width = int(used[-1]) + 1 if len(used) else 0
    codes = codes[:, :width]
    ends = ((codes != 0) * np.arange(1, width + 1)).max(axis=1, initial=0).astype(np.uint8)
    order, above = _by_falling_end(ends, width)
    ranked = codes[order]
    zigzag = np.where(ranked > 0, 2 * ranked - 1, -2 * ranked).astype(np.uint32)
    planes: list[U8] = [ends]
    sizes = bytearray()
    for group in coordinate_groups(width):
        inner = [zigzag[: above[j + 1], j] for j in group]
        last = [zigzag[above[j + 1] : above[j], j] - np.uint32(1) for j in group]
        for symbols in (np.concatenate(inner), np.concatenate(last)):
            size = grid_planes.code_bytes(int(symbols.max(initial=0)) + 1)
            sizes.append(size)
            planes += grid_planes.split_planes(symbols, 1 << (8 * size)) if size else []
    params = PARAMS.pack(codebook, step, shrink, width, 0) + bytes(sizes)
    return Stream(Attribute.SHN, Kind.BASIS, len(codes), params, planes)


@cache
def coordinate_groups(width: int) -> tuple[range, ...]:
    """Return the coordinates of each group that shares planes (SPEC 6.14)."""
    stops = [min(start, width) for start in (*GROUP_STARTS[1:], width)]
    found = [range(a, b) for a, b in zip(GROUP_STARTS, stops, strict=True)]
    return tuple(group for group in found if len(group))


def _by_falling_end(ends: U8, width: int) -> tuple[I64, list[int]]:
    """Return the order of rows by descending number of coordinates, and counts of rows.

    Parameters
    ----------
    ends : (n,) uint8
        Number of coordinates of each row up to its last non-zero one.
    width : int
        Number of coordinates in use, at least the maximum of `ends`.

    Returns
    -------
    order : (n,) int64
        Rows, those with the most coordinates first.
    above : list of int
        Number of rows with more than 0, 1, … `width` coordinates.
    """
    order = np.argsort(np.uint8(255) - ends, kind="stable").astype(np.int64)
    counts = np.bincount(ends, minlength=width + 1)
    above: list[int] = (len(ends) - np.cumsum(counts)).tolist()
    return order, above


def codebook_use(stream: StoredStream) -> CodebookUse:
    """Return the number of the codebook whose rows are the basis; such streams have no escape rows.

    Raises
    ------
    FormatError
        ``stream-params``.
    """
    return CodebookUse(int(PARAMS.unpack_from(_params(stream))[0]))


def _params(stream: StoredStream) -> memoryview:
    """Return the parameters of a basis stream of shN, their length checked."""
    if len(stream.params) < PARAMS.size:
        raise FormatError(
            "stream-params",
            f"{stream.where}: {len(stream.params)} bytes of parameters, expected at least "
            f"{PARAMS.size}",
            clause="6.14",
        )
    width = int(PARAMS.unpack_from(stream.params)[3])
    return stream.require_params(PARAMS.size + 2 * len(coordinate_groups(width)))


def parse(stream: StoredStream, basis: F32) -> Parameters:
    """Return the parameters of a basis stream of shN, checked against its basis.

    Parameters
    ----------
    stream : StoredStream
        Basis stream of shN.
    basis : (C, d) float32
        Rows of the codebook.

    Raises
    ------
    FormatError
        ``stream-params``, ``basis-width``, ``basis-value``, ``stream-planes``.
    """
    params = _params(stream)
    _, step, shrink, width, reserved = PARAMS.unpack_from(params)
    if width > min(len(basis), MAX_BASIS_ROWS) or reserved:
        raise FormatError(
            "basis-width",
            f"{stream.where}: {width} coordinates on a basis of {len(basis)} rows and reserved "
            f"bytes {reserved}, expected no more than rows, and 0",
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
    sizes = bytes(params[PARAMS.size :])
    expected = 1 + sum(sizes)
    if max(sizes, default=0) > 3 or len(stream.words) != expected:
        raise FormatError(
            "stream-planes",
            f"{stream.where}: {len(stream.words)} planes, codes of {list(sizes)} bytes, "
            f"expected {expected} planes and at most 3 bytes",
            clause="6.14",
        )
    return Parameters(step, shrink, width, sizes)


def read_ends(stream: StoredStream, width: int) -> U8:
    """Return the number of coordinates of each row up to its last non-zero one, (rows,).

    Raises
    ------
    FormatError
        ``code-range``: a number above `width`.
    """
    ends = stream.plane(0, stream.rows)
    grid_planes.require_codes(ends, width + 1, f"{stream.where}, ends", "6.14")
    return ends


def require_basis(inputs: Inputs) -> F32:
    """Return the basis of a stream's inputs, (C, d) float32.

    Raises
    ------
    ValueError
        The inputs have no codebook.
    """
    if inputs.codebook is None:
        raise ValueError("no codebook for a basis stream")
    return inputs.codebook


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode SH coefficients into (rows, d) float32 `out`, coefficient by coefficient, as R G B.

    Needs `inputs.codebook`, (C, d) float32: the basis, limited to the d requested coefficients.

    Raises
    ------
    FormatError
        Codes of `parse` and `read_ends`.
    ValueError
        No codebook is given.
    """
    basis = require_basis(inputs)
    found = parse(stream, basis)
    ends = read_ends(stream, found.width)
    order, above = _by_falling_end(ends, found.width)
    parts = _parts(stream, found, above, basis)
    count = above[0] if found.width else 0
    sums = np.empty((min(_BLOCK, count), basis.shape[1]), np.float32)
    products = np.empty_like(sums)
    for start in range(0, count, _BLOCK):
        stop = min(start + _BLOCK, count)
        block = sums[: stop - start]
        block[:] = 0
        for part in parts:
            first, last = max(part.first, start), min(part.last, stop)
            if first < last:
                product = products[: last - first]
                part.compute_products(first, product)
                block[first - start : last - start] += product
        out[order[start:stop]] = block
    out[order[count:]] = 0


@dataclass(frozen=True, eq=False)
class _Part:
    """Inner or last codes of one coordinate, for a range of rows in `_by_falling_end` order.

    Parameters
    ----------
    first, last : int
        Half-open range of ranks; the rank of a row is its place in that order.
    symbols : (last - first,) uint8
        Inner or last codes of one byte.
    table : (m,) float32
        Coordinate of each symbol.
    coordinates : (last - first,) float32 or None
        Decoded coordinates, used instead of symbols and table if codes have several bytes.
    row : (d,) float32
        Row of the basis for this coordinate.
    """

    first: int
    last: int
    symbols: U8
    table: F32
    coordinates: F32 | None
    row: F32

    def compute_products(self, start: int, out: F32) -> None:
        """Multiply the coordinates from rank `start` on by the basis row, into (m, d) `out`."""
        own = slice(start - self.first, start - self.first + len(out))
        if self.coordinates is not None:
            np.multiply(self.coordinates[own, None], self.row, out=out)
        elif 2 * len(self.table) <= len(out):
            # Copying products from a table takes half the time of computing one per row.
            products = self.table[:, None] * self.row
            products.take(self.symbols[own], axis=0, out=out, mode="clip")
        else:
            np.multiply(self.table.take(self.symbols[own])[:, None], self.row, out=out)


def _parts(stream: StoredStream, found: Parameters, above: list[int], basis: F32) -> list[_Part]:
    """Return the inner and the last codes of each coordinate, by ascending coordinate.

    Parameters
    ----------
    stream : StoredStream
        Basis stream of shN.
    found : Parameters
        Parameters of the stream.
    above : list of int
        Number of rows with more than 0, 1, … `found.width` coordinates.
    basis : (C, d) float32
        Rows of the codebook.
    """
    factors = np.float32(found.step), np.float32(found.shrink)
    octets = np.arange(256, dtype=np.uint32)
    tables = [_coordinate(octets + np.uint32(offset), *factors) for offset in range(2)]
    parts: list[_Part] = []
    plane = 1
    for number, group in enumerate(coordinate_groups(found.width)):
        own: list[list[_Part]] = [[], []]
        spans = [(0, above[j + 1]) for j in group], [(above[j + 1], above[j]) for j in group]
        for offset in range(2):
            size = found.sizes[2 * number + offset]
            length = sum(last - first for first, last in spans[offset])
            planes = [stream.plane(plane + byte, length) for byte in range(size)]
            plane += size
            symbols = planes[0] if planes else np.zeros(length, np.uint8)
            table = tables[offset][: int(symbols.max(initial=0)) + 1]
            coordinates = None
            if size > 1:
                codes = grid_planes.join_planes(planes, length) + np.uint32(offset)
                coordinates = _coordinate(codes, *factors)
            at = 0
            for j, (first, last) in zip(group, spans[offset], strict=True):
                rows = slice(at, at + last - first)
                at = rows.stop
                exact = None if coordinates is None else coordinates[rows]
                own[offset].append(_Part(first, last, symbols[rows], table, exact, basis[j]))
        parts += [part for both in zip(*own, strict=True) for part in both]
    return parts


def _coordinate(codes: U32, step: np.float32, shrink: np.float32) -> F32:
    """Return the coordinates of codes (SPEC 6.14)."""
    magnitude = ((codes + np.uint32(1)) >> np.uint32(1)).astype(np.float32)
    value = np.where(codes > 0, magnitude - shrink, np.float32(0)) * step
    out: F32 = np.where(codes & np.uint32(1), value, -value)
    return out
