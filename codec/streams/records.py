"""Streams: one attribute of one chunk or codebook as a record and its byte planes (SPEC 6)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.geometry import morton

from . import compiled, sorted_means
from . import grid as grids
from .byte_planes import LENGTH_MASK, pack_plane, unpack_labelled, unpack_plane, unpack_planes
from .grid import ENTRY_BYTES, Grid
from .limits import MAX_STREAMS

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


class Attribute(IntEnum):
    """What a stream holds (SPEC 6.2, table of attributes)."""

    MEANS = 1
    OPACITIES = 2
    SH0 = 3
    SCALES = 4
    QUATS = 5
    SCALE_FACTOR = 6
    SHAPE = 7
    SHN = 8
    SH1 = 9
    SH2 = 10
    SH3 = 11


SH_BANDS: Final = (Attribute.SH1, Attribute.SH2, Attribute.SH3)

COMPONENTS: Final = {
    Attribute.MEANS: 3,
    Attribute.OPACITIES: 1,
    Attribute.SH0: 3,
    Attribute.SCALES: 3,
    Attribute.QUATS: 4,
    Attribute.SCALE_FACTOR: 1,
    Attribute.SHAPE: 7,
    Attribute.SHN: 45,
    Attribute.SH1: 9,
    Attribute.SH2: 15,
    Attribute.SH3: 21,
}
"""Values per row of each attribute; SHN's 45 are those of degree 3, whatever the scene's."""


class Kind(IntEnum):
    """How a stream holds it (SPEC 6.2, table of kinds)."""

    SCALAR = 1
    MORTON = 2
    QUAT = 3
    VQ = 4
    FLOAT = 5
    LADDER = 6
    TURN = 7
    FINE = 8
    BASIS = 9
    DIGITS = 10
    BITS = 11


KEPT: Final = 1
"""Record flag: the rows are the chunk's own vectors, which no codebook row replaces."""

INFINITIES: Final = 2
"""Record flag: two codes above the grid's levels stand for +inf and -inf."""

PER_ROW: Final = 255
"""A quat stream's `largest` where it differs from row to row and has a plane of its own."""

_RECORD: Final = struct.Struct("<BBBBIHH")
RECORD_BYTES: Final = _RECORD.size
_COUNT: Final = struct.Struct("<H")
_WORD: Final = struct.Struct("<I")
_VQ: Final = struct.Struct("<II")
_QUAT: Final = struct.Struct("<B3x")


@dataclass(frozen=True, eq=False)
class Stream:
    """One record with its parameters and its byte planes, not yet compressed.

    Parameters
    ----------
    attribute : Attribute
    kind : Kind
    rows : int
    params : bytes
        The kind's parameters, as SPEC 6.4 to 6.7 lay them out.
    planes : sequence of (n,) uint8
    flags : int
        `KEPT`, `INFINITIES` or 0.
    """

    attribute: Attribute
    kind: Kind
    rows: int
    params: bytes
    planes: Sequence[U8]
    flags: int = 0


def scalar(attribute: Attribute, values: F32, grid: Grid, *, kept: bool = False) -> Stream:
    """Return a scalar stream of (n, c) float32 values on a grid."""
    codes = grid.quantise(values)
    planes: list[U8] = []
    for component in range(grid.components):
        levels = int(grid.levels[component])
        planes += grids.split_planes(codes[:, component], levels)
    return Stream(attribute, Kind.SCALAR, len(values), grid.pack(), planes, KEPT if kept else 0)


def scalar_with_infinities(attribute: Attribute, values: F32, grid: Grid) -> Stream:
    """Return a scalar stream of (n, 1) float32 values of which some are ±inf."""
    finite = np.isfinite(values)
    codes = grid.quantise(np.where(finite, values, grid.minimum))[:, 0]
    levels = int(grid.levels[0])
    codes[np.isposinf(values[:, 0])] = levels
    codes[np.isneginf(values[:, 0])] = levels + 1
    planes = grids.split_planes(codes, levels + 2)
    return Stream(attribute, Kind.SCALAR, len(values), grid.pack(), planes, INFINITIES)


def floats(attribute: Attribute, values: F32) -> Stream:
    """Return a float stream: the four bytes of every (n, c) float32 value, by component."""
    octets = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    planes = [np.ascontiguousarray(octets[:, column]) for column in range(octets.shape[1])]
    return Stream(attribute, Kind.FLOAT, len(values), b"", planes)


def morton_means(axis_codes: U32, grid: Grid) -> Stream:
    """Return a morton stream of (n, 3) axis codes whose Morton codes ascend."""
    classes, bits = sorted_means.pack_deltas(morton.interleave(axis_codes))
    planes = [classes, bits]
    return Stream(Attribute.MEANS, Kind.MORTON, len(axis_codes), grid.pack(), planes)


def quats(rows: F32, step: float, *, kept: bool = False) -> Stream:
    """Return a quat stream of (n, 4) unit wxyz float32 rows, w ≥ 0 (SPEC 6.6)."""
    largest = np.abs(rows).argmax(axis=1)
    sign = np.where(rows[np.arange(len(rows)), largest] < 0, np.float32(-1), np.float32(1))
    others = rows[largest[:, None] != np.arange(4)].reshape(-1, 3) * sign[:, None]
    grid = grids.fit(others, step)
    body = scalar(Attribute.QUATS, others, grid)
    constant = bool((largest == largest[0]).all())
    params = _QUAT.pack(int(largest[0]) if constant else PER_ROW) + grid.pack()
    planes = [] if constant else [largest.astype(np.uint8)]
    planes += body.planes
    return Stream(Attribute.QUATS, Kind.QUAT, len(rows), params, planes, KEPT if kept else 0)


def vq(attribute: Attribute, indices: U32, codebook: int, size: int, kept: int) -> Stream:
    """Return a vq stream of (n,) indices: below `size` a codebook row, above it a kept row."""
    planes = grids.split_planes(indices, size + kept)
    return Stream(attribute, Kind.VQ, len(indices), _VQ.pack(codebook, kept), planes)


def pack(streams: Sequence[Stream], *, digits: bool = True) -> bytes:
    """Return the payload of a segment (SPEC 6.1).

    Parameters
    ----------
    streams : sequence of Stream
        In the order a decoder reads them.
    digits : bool
        Whether several symbols may share a byte of a plane.
    """
    records: list[bytes] = []
    bodies: list[bytes] = []
    for stream in streams:
        packed = [pack_plane(plane, digits=digits) for plane in stream.planes]
        records.append(
            _RECORD.pack(
                stream.attribute,
                stream.kind,
                COMPONENTS[stream.attribute],
                stream.flags,
                stream.rows,
                len(packed),
                len(stream.params),
            )
        )
        records.append(stream.params)
        records += [_WORD.pack(word) for word, _ in packed]
        bodies += [stored for _, stored in packed]
    return b"".join([_COUNT.pack(len(streams)), *records, *bodies])


@dataclass(frozen=True, eq=False)
class StoredStream:
    """One record of a payload that was read, its planes still compressed.

    Parameters
    ----------
    attribute, kind, flags, rows
        As in `Stream`.
    params : memoryview
    words : (p,) uint32
    bodies : tuple of memoryview
        Stored planes.
    where : str
        Names the stream in messages.
    """

    attribute: Attribute
    kind: Kind
    flags: int
    rows: int
    params: memoryview
    words: U32
    bodies: tuple[memoryview, ...]
    where: str

    @property
    def stored_bytes(self) -> int:
        """Bytes in the file: record, parameters, words and planes."""
        planes = sum(len(body) for body in self.bodies)
        return RECORD_BYTES + len(self.params) + self.words.nbytes + planes

    @property
    def codebook(self) -> int:
        """Codebook that a vq stream names."""
        self.require_kind(Kind.VQ)
        return int(_VQ.unpack(self.require_params(_VQ.size))[0])

    @property
    def kept(self) -> int:
        """Rows of its own that a vq stream refers to."""
        self.require_kind(Kind.VQ)
        kept = int(_VQ.unpack(self.require_params(_VQ.size))[1])
        if kept > self.rows:
            raise FormatError(
                "stream-rows",
                f"{self.where}: {kept} rows of its own, expected at most {self.rows}",
                clause="6.7",
            )
        return kept

    @property
    def label(self) -> str:
        """Attribute, kind and flag as a reader of tables wants them."""
        kept = " kept" if self.flags & KEPT else ""
        return f"{self.attribute.name.lower()} {self.kind.name.lower()}{kept}"

    def require_params(self, size: int) -> memoryview:
        """Return the parameters, which must be `size` bytes."""
        if len(self.params) != size:
            raise FormatError(
                "stream-params",
                f"{self.where}: {len(self.params)} bytes of parameters, expected {size}",
                clause="6.2",
            )
        return self.params

    def read_planes(self, lengths: Sequence[int]) -> list[U8]:
        """Return all planes, decompressed to these lengths in bytes."""
        self.require_planes(len(lengths))
        return [self.plane(index, length) for index, length in enumerate(lengths)]

    def require_planes(self, count: int) -> None:
        """Refuse another number of planes, before any is read."""
        if len(self.words) != count:
            raise FormatError(
                "stream-planes",
                f"{self.where}: {len(self.words)} planes, expected {count}",
                clause="6.2",
            )

    def plane(self, index: int, length: int) -> U8:
        """Return one plane, decompressed to `length` bytes."""
        where = f"{self.where}, plane {index}"
        word = int(self.words[index])
        return unpack_plane(self.bodies[index], word, length, where)

    def joined(self, first: int, lengths: Sequence[int]) -> U8:
        """Return consecutive planes end to end, and two zeros, where kernels are `compiled`.

        Parameters
        ----------
        first : int
            Number of the first plane.
        lengths : sequence of int
            What they decompress to, bytes.
        """
        last = first + len(lengths)
        words = self.words[first:last].tolist()
        return unpack_planes(self.bodies[first:last], words, lengths, self.where, first)

    def joined_with(self, other: StoredStream, lengths: Sequence[int]) -> U8:
        """Return all planes of two streams end to end, as `joined` does those of one."""
        labels = [f"{s.where}, plane {i}" for s in (self, other) for i in range(len(s.words))]
        words = [*self.words.tolist(), *other.words.tolist()]
        return unpack_labelled((*self.bodies, *other.bodies), words, lengths, labels)

    def require_kind(self, kind: Kind) -> None:
        """Refuse a stream of another kind."""
        if self.kind != kind:
            raise FormatError(
                "stream-kind",
                f"{self.where}: kind {self.kind.name}, expected {kind.name}",
                clause="6.2",
            )

    def read_numbers(self, out: F32) -> None:
        """Write the values of a scalar or float stream into (rows, c) float32 `out`."""
        if self.kind == Kind.FLOAT:
            self._read_floats(out)
            return
        self.require_kind(Kind.SCALAR)
        components = out.shape[1]
        grid = grids.unpack(self.require_params(components * ENTRY_BYTES), components, self.where)
        extra = 2 if self.flags & INFINITIES else 0
        read_grid_planes(self, grid, 0, extra, out)

    def _read_floats(self, out: F32) -> None:
        self.require_params(0)
        planes = self.read_planes([self.rows] * (4 * out.shape[1]))
        values = np.stack(planes, axis=1).view("<f4").astype(np.float32)
        largest = np.abs(values)
        legal = largest <= grids.MAX_VALUE
        if self.attribute == Attribute.OPACITIES:
            legal |= np.isinf(values)
        if not legal.all():
            raise FormatError(
                "float-value",
                f"{self.where}: NaN, or a magnitude above {grids.MAX_VALUE:g}",
                clause="6.8",
            )
        out[:] = values

    def read_means(self, out: F32) -> None:
        """Write the values of a means stream, numbers or morton, into (rows, 3) float32 `out`."""
        if self.kind != Kind.MORTON:
            self.read_numbers(out)
            return
        params = self.require_params(3 * ENTRY_BYTES)
        grid = grids.unpack(params, 3, self.where, morton.MAX_LEVELS)
        self.require_planes(2)
        classes = self.plane(0, self.rows)
        bits = self.plane(1, sorted_means.bits_length(classes, self.where))
        if compiled.ready():
            none = np.zeros(self.rows, np.uint8)
            cells = sorted_means.Cells(grid.levels, grid.step[None, :], grid.minimum)
            used = sorted_means.bits_count(classes), 0
            if sorted_means.read_compiled(classes, bits, none, none[:0], used, cells, out):
                return
        codes = morton.deinterleave(sorted_means.unpack_deltas(classes, bits, self.where))
        top = codes.max(axis=0, initial=0)
        if bool((top >= grid.levels).any()):
            raise FormatError(
                "code-range",
                f"{self.where}: codes up to {top.tolist()}, expected below {grid.levels.tolist()}",
                clause="6.5",
            )
        step = grid.step
        for axis in range(3):
            np.multiply(codes[:, axis].astype(np.float32), step[axis], out=out[:, axis])
        out += grid.minimum

    def read_quats(self, out: F32) -> None:
        """Write the unit quaternions of a quat stream into (rows, 4) float32 `out` (SPEC 6.6)."""
        self.require_kind(Kind.QUAT)
        params = self.require_params(_QUAT.size + 3 * ENTRY_BYTES)
        (largest,) = _QUAT.unpack(params[: _QUAT.size])
        if (largest > 3 and largest != PER_ROW) or any(params[1 : _QUAT.size]):
            raise FormatError(
                "quat-largest",
                f"{self.where}: largest component {largest}, expected 0 to 3 or {PER_ROW}, "
                "and three zero bytes",
                clause="6.6",
            )
        grid = grids.unpack(params[_QUAT.size :], 3, self.where)
        if float(np.abs([grid.minimum, grid.maximum]).max()) > 1:
            raise FormatError(
                "grid-value",
                f"{self.where}: range {grid.minimum.tolist()} to {grid.maximum.tolist()}, "
                "expected -1 to 1",
                clause="6.6",
            )
        others = np.empty((self.rows, 3), np.float32)
        first = 1 if largest == PER_ROW else 0
        self.require_planes(first + sum(_plane_counts(grid, 0)))
        which = self.plane(0, self.rows) if first else np.empty(0, np.uint8)
        read_grid_planes(self, grid, first, 0, others)
        a, b, c = others.T
        rest = np.float32(1) - ((a * a + b * b) + c * c)
        root = np.sqrt(np.maximum(rest, np.float32(0)))
        if first:
            if len(which) and int(which.max()) > 3:
                raise FormatError(
                    "quat-largest",
                    f"{self.where}: largest component {int(which.max())}, expected 0 to 3",
                    clause="6.6",
                )
            mask = which[:, None] == np.arange(4, dtype=np.uint8)
            out[mask] = root
            out[~mask] = others.reshape(-1)
        else:
            out[:, largest] = root
            out[:, [i for i in range(4) if i != largest]] = others
        _unit(out)

    def read_indices(self, size: int) -> U32:
        """Return the (rows,) indices of a vq stream into a codebook of `size` rows and its own."""
        kept = self.kept
        total = size + kept
        planes = self.read_planes([self.rows] * grids.code_bytes(total))
        indices = grids.join_planes(planes, self.rows)
        if len(indices) and int(indices.max()) >= total:
            raise FormatError(
                "index-range",
                f"{self.where}: index {int(indices.max())}, expected below {size} codebook rows "
                f"and {kept} of its own",
                clause="6.7",
            )
        return indices


def read_grid_planes(stream: StoredStream, grid: Grid, first: int, extra: int, out: F32) -> None:
    """Write the values of a stream's planes from `first` on, `extra` codes above the levels."""
    counts = _plane_counts(grid, extra)
    stream.require_planes(first + sum(counts))
    if compiled.ready() and _compiled_planes(stream, grid, first, sum(counts), extra, out):
        return
    step = grid.step
    plane = first
    for component, count in enumerate(counts):
        column = out[:, component]
        levels = int(grid.levels[component])
        if count == 0:
            # As any other code, which makes +0 of a minimum of -0.
            column[:] = grid.minimum[component] + np.float32(0)
            continue
        planes = [stream.plane(plane + byte, stream.rows) for byte in range(count)]
        plane += count
        codes = planes[0] if count == 1 else grids.join_planes(planes, stream.rows)
        if levels + extra < 1 << (8 * count) and int(codes.max(initial=0)) >= levels + extra:
            raise FormatError(
                "code-range",
                f"{stream.where}: code {int(codes.max())} in component {component}, "
                f"expected below {levels + extra}",
                clause="6.4",
            )
        np.multiply(codes.astype(np.float32), step[component], out=column)
        column += grid.minimum[component]
        if extra:
            column[codes == levels] = np.inf
            column[codes == levels + 1] = -np.inf


def read_grid_codes(stream: StoredStream, grid: Grid) -> U32:
    """Return the (rows, c) codes of a stream whose planes are those of a grid alone."""
    counts = _plane_counts(grid, 0)
    stream.require_planes(sum(counts))
    out = np.zeros((stream.rows, grid.components), np.uint32)
    plane = 0
    for component, count in enumerate(counts):
        planes = [stream.plane(plane + byte, stream.rows) for byte in range(count)]
        plane += count
        out[:, component] = grids.join_planes(planes, stream.rows)
        levels = int(grid.levels[component])
        if int(out[:, component].max(initial=0)) >= levels:
            raise FormatError(
                "code-range",
                f"{stream.where}: code {int(out[:, component].max())} in component {component}, "
                f"expected below {levels}",
                clause="6.4",
            )
    return out


def _compiled_planes(
    stream: StoredStream, grid: Grid, first: int, count: int, extra: int, out: F32
) -> bool:
    from cogsplat.codec.streams import kernels

    planes = stream.joined(first, [stream.rows] * count)
    return kernels.grid_rows(planes, grid.minimum, grid.maximum, grid.levels, extra, out)


def _plane_counts(grid: Grid, extra: int) -> list[int]:
    return [grids.code_bytes(levels + extra) for levels in grid.levels.tolist()]


def _unit(quats_out: F32) -> None:
    w, x, y, z = quats_out.T
    norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
    quats_out /= norm[:, None]
    flip = w < 0
    quats_out[flip] = -quats_out[flip]


def unpack(payload: memoryview, where: str, max_rows: int) -> list[StoredStream]:
    """Read the records of a payload and check that they fit it exactly (SPEC 6.1).

    Parameters
    ----------
    payload : memoryview
        A segment's bytes, its CRC already checked.
    where : str
        Names the segment in messages.
    max_rows : int
        More rows than this in any record are refused before anything is allocated.

    Raises
    ------
    FormatError
        ``stream-record``: a record leaves the payload, does not fit its attribute, or bytes are
        left over; ``stream-count``; ``stream-duplicate``; ``stream-rows``.
    UnsupportedError
        ``stream-attribute-unknown``, ``stream-kind-unknown``: of a later version.
    """
    if len(payload) < _COUNT.size:
        raise FormatError(
            "stream-record", f"{where}: {len(payload)} bytes, expected a stream count", clause="6.1"
        )
    (count,) = _COUNT.unpack_from(payload)
    if count > MAX_STREAMS:
        raise FormatError(
            "stream-count",
            f"{where}: {count} streams, expected at most {MAX_STREAMS}",
            clause="9.1",
        )
    position = _COUNT.size
    heads: list[tuple[Attribute, Kind, int, int, memoryview, U32, str]] = []
    seen: set[tuple[int, int]] = set()
    for index in range(count):
        label = f"{where}, stream {index}"
        if position + _RECORD.size > len(payload):
            raise _leaves(label, len(payload))
        record = _RECORD.unpack_from(payload, position)
        number, kind_number, components, flags, rows, planes, param_bytes = record
        position += _RECORD.size
        end = position + param_bytes + planes * _WORD.size
        if end > len(payload):
            raise _leaves(label, len(payload))
        attribute, kind = _enums(number, kind_number, label)
        label = f"{where}, {attribute.name.lower()}"
        if components != COMPONENTS[attribute] or flags & ~(KEPT | INFINITIES):
            raise FormatError(
                "stream-record",
                f"{label}: {components} components and flags {flags:#x}, "
                f"expected {COMPONENTS[attribute]} and flags below 4",
                clause="6.2",
            )
        infinite = bool(flags & INFINITIES)
        if infinite and (attribute != Attribute.OPACITIES or kind != Kind.SCALAR):
            raise FormatError(
                "stream-record", f"{label}: infinities, expected in opacities only", clause="6.2"
            )
        if rows > max_rows:
            raise FormatError(
                "stream-rows", f"{label}: {rows} rows, expected at most {max_rows}", clause="6.2"
            )
        key = (number, flags & KEPT)
        if key in seen:
            raise FormatError("stream-duplicate", f"{label}: a second time", clause="6.2")
        seen.add(key)
        params = payload[position : position + param_bytes]
        words = np.frombuffer(payload, "<u4", planes, position + param_bytes)
        heads.append((attribute, kind, flags, rows, params, words.astype(np.uint32), label))
        position = end
    stored: list[StoredStream] = []
    for attribute, kind, flags, rows, params, words, label in heads:
        bodies: list[memoryview] = []
        for word in words.tolist():
            length = word & LENGTH_MASK
            if position + length > len(payload):
                raise _leaves(label, len(payload))
            body = payload[position : position + length]
            bodies.append(body)
            position += length
        stored.append(
            StoredStream(attribute, kind, flags, rows, params, words, tuple(bodies), label)
        )
    if position != len(payload):
        raise FormatError(
            "stream-record",
            f"{where}: {len(payload) - position} bytes behind the last plane, expected none",
            clause="6.1",
        )
    return stored


def _leaves(label: str, length: int) -> FormatError:
    return FormatError(
        "stream-record", f"{label}: leaves the segment's {length} bytes", clause="6.1"
    )


def _enums(number: int, kind_number: int, label: str) -> tuple[Attribute, Kind]:
    if number not in Attribute._value2member_map_:
        raise UnsupportedError(
            "stream-attribute-unknown",
            f"{label}: attribute {number}, expected 1 to {max(Attribute)} (SPEC 6.2)",
        )
    if kind_number not in Kind._value2member_map_:
        raise UnsupportedError(
            "stream-kind-unknown",
            f"{label}: kind {kind_number}, expected 1 to {max(Kind)} (SPEC 6.2)",
        )
    return Attribute(number), Kind(kind_number)
