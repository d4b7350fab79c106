"""Streams of a payload: records of one attribute each, and their byte planes (SPEC 6.1, 6.2)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, UnsupportedError

from .byte_planes import LENGTH_MASK, pack_plane, unpack_plane
from .payload_limits import MAX_CHUNK_SPLATS, MAX_STREAMS
from .stored_planes import StoredPlanes, locate

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


class Attribute(IntEnum):
    """Attributes that a stream can store (SPEC 6.2)."""

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
"""Attributes of the SH bands 1 to 3."""

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
"""Values per row of each attribute; SHN has 45, as for SH degree 3, at every SH degree."""


class Kind(IntEnum):
    """Kinds of streams: ways to store an attribute (SPEC 6.2)."""

    SCALAR = 1
    FLOAT = 2
    QUAT = 3
    VQ = 4
    SORTED = 5
    DIFFERENCES = 6
    SWING_TWIST = 7
    BASIS = 8
    DIGITS = 9
    BITS = 10


ESCAPE: Final = 1
"""Record flag: the rows are escape rows, vectors that the chunk stores outside the codebook."""

INFINITIES: Final = 2
"""Record flag: two codes above the grid's levels stand for +inf and -inf."""

RECORD: Final = struct.Struct("<BBBBIHH")
"""The fixed part of a record (SPEC 6.2)."""

_COUNT: Final = struct.Struct("<H")
_WORD: Final = struct.Struct("<I")
_NO_WORDS: Final = np.zeros(0, np.uint32)


@dataclass(frozen=True, eq=False)
class Stream:
    """A stream to write: one record, its parameters and its byte planes before compression.

    Parameters
    ----------
    attribute : Attribute
        Attribute of the rows.
    kind : Kind
        Way in which it is stored.
    rows : int
        Number of rows.
    params : bytes
        Parameters, in the layout of the kind's clause of SPEC 6.
    planes : sequence of (n,) uint8
        Byte planes, uncompressed.
    flags : int
        `ESCAPE`, `INFINITIES` or 0.
    """

    attribute: Attribute
    kind: Kind
    rows: int
    params: bytes
    planes: Sequence[U8]
    flags: int = 0


def pack(streams: Sequence[Stream], *, digits: bool = True) -> bytes:
    """Return the payload of a segment (SPEC 6.1).

    Parameters
    ----------
    streams : sequence of Stream
        Streams in the order of decoding.
    digits : bool
        Whether to pack several symbols per byte, as digits of a number, where this is smaller.
    """
    return _payload(streams, lambda plane: pack_plane(plane, digits=digits))


def pack_uncompressed(streams: Sequence[Stream]) -> bytes:
    """Return the payload of a segment with its planes stored uncompressed, which is fast.

    Parameters
    ----------
    streams : sequence of Stream
        Streams in the order of decoding.
    """
    return _payload(streams, lambda plane: (len(plane), plane.tobytes()))


def compress_payload(plain: bytes, *, digits: bool = True) -> bytes:
    """Compress the planes of an uncompressed payload; the result equals that of `pack`.

    Parameters
    ----------
    plain : bytes
        Payload made by `pack_uncompressed`.
    digits : bool
        Whether to pack several symbols per byte, as digits of a number, where this is smaller.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.streams import grid, records, scalar
    >>> values = np.zeros((500, 3), np.float32)
    >>> streams = [scalar.write(records.Attribute.SH0, values, grid.fit(values, 0.1))]
    >>> records.compress_payload(records.pack_uncompressed(streams)) == records.pack(streams)
    True
    """
    streams = [
        Stream(
            stored.attribute,
            stored.kind,
            stored.rows,
            bytes(stored.params),
            [
                np.frombuffer(stored.planes.body(stored.first + index), np.uint8)
                for index in range(len(stored.words))
            ],
            stored.flags,
        )
        for stored in unpack(memoryview(plain), "segment", MAX_CHUNK_SPLATS)
    ]
    return pack(streams, digits=digits)


def _payload(streams: Sequence[Stream], encode: Callable[[U8], tuple[int, bytes]]) -> bytes:
    """Return the payload of streams.

    Parameters
    ----------
    streams : sequence of Stream
        Streams in the order of decoding.
    encode : callable
        Encodes a plane: returns its word (stored length and flags) and its stored bytes.
    """
    records: list[bytes] = []
    bodies: list[bytes] = []
    for stream in streams:
        packed = [encode(plane) for plane in stream.planes]
        records.append(
            RECORD.pack(
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
        bodies += [body for _, body in packed]
    return b"".join([_COUNT.pack(len(streams)), *records, *bodies])


@dataclass(frozen=True, eq=False)
class StoredStream:
    """A stream of a payload: one record, its planes still compressed.

    Parameters
    ----------
    attribute, kind, flags, rows
        See `Stream`.
    params : memoryview
        Parameters, in the layout of the kind's clause of SPEC 6.
    words : (p,) uint32
        Word of each plane of the stream: its stored length and flags (SPEC 6.3).
    planes : StoredPlanes
        All planes of the payload.
    first : int
        Number of the stream's first plane in the payload.
    where : str
        Name of the stream in messages.
    """

    attribute: Attribute
    kind: Kind
    flags: int
    rows: int
    params: memoryview
    words: U32
    planes: StoredPlanes
    first: int
    where: str

    @property
    def stored_bytes(self) -> int:
        """Size of record, parameters, words and planes in the file, bytes."""
        planes = int((self.words & np.uint32(LENGTH_MASK)).sum(dtype=np.int64))
        return RECORD.size + len(self.params) + self.words.nbytes + planes

    @property
    def label(self) -> str:
        """Attribute, kind and flag as text, such as ``scales scalar escape``."""
        escape = " escape" if self.flags & ESCAPE else ""
        return f"{self.attribute.name.lower()} {self.kind.name.lower()}{escape}"

    def require_params(self, size: int) -> memoryview:
        """Return the parameters; raise ``stream-params`` if they are not `size` bytes."""
        if len(self.params) != size:
            raise FormatError(
                "stream-params",
                f"{self.where}: {len(self.params)} bytes of parameters, expected {size}",
                clause="6.2",
            )
        return self.params

    def read_planes(self, lengths: Sequence[int]) -> list[U8]:
        """Return the decompressed planes, given the size of each plane, bytes."""
        self.require_planes(len(lengths))
        return [self.plane(index, length) for index, length in enumerate(lengths)]

    def require_planes(self, count: int) -> None:
        """Raise ``stream-planes`` if the stream does not have `count` planes."""
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
        return unpack_plane(self.planes.body(self.first + index), word, length, where)


def unpack(payload: memoryview, where: str, max_rows: int) -> list[StoredStream]:
    """Parse the records of a payload and check that planes fill the rest of it (SPEC 6.1).

    Parameters
    ----------
    payload : memoryview
        Bytes of a segment, its CRC already checked.
    where : str
        Name of the segment in messages.
    max_rows : int
        Maximum number of rows of a record; checked before anything is allocated.

    Raises
    ------
    FormatError
        ``stream-record``: a record exceeds the payload, its components or flags are not those of
        its attribute, or bytes follow the last plane;
        ``stream-count``; ``stream-duplicate``; ``stream-rows``.
    UnsupportedError
        ``stream-attribute-unknown``, ``stream-kind-unknown``: numbers of a later version.
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
    heads: list[tuple[Attribute, Kind, int, int, memoryview, int, str]] = []
    words: list[U32] = []
    seen: set[tuple[int, int]] = set()
    for index in range(count):
        label = f"{where}, stream {index}"
        if position + RECORD.size > len(payload):
            raise _overflow_error(label, len(payload))
        record = RECORD.unpack_from(payload, position)
        number, kind_number, components, flags, rows, planes, param_bytes = record
        position += RECORD.size
        end = position + param_bytes + planes * _WORD.size
        if end > len(payload):
            raise _overflow_error(label, len(payload))
        attribute, kind = _attribute_and_kind(number, kind_number, label)
        label = f"{where}, {attribute.name.lower()}"
        if components != COMPONENTS[attribute] or flags & ~(ESCAPE | INFINITIES):
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
        key = (number, flags & ESCAPE)
        if key in seen:
            raise FormatError("stream-duplicate", f"{label}: a second time", clause="6.2")
        seen.add(key)
        params = payload[position : position + param_bytes]
        words.append(np.frombuffer(payload, "<u4", planes, position + param_bytes))
        heads.append((attribute, kind, flags, rows, params, planes, label))
        position = end
    every = np.concatenate([_NO_WORDS, *words]).astype(np.uint32, copy=False)
    located = locate(payload, every, position)
    last = int(located.ends[-1]) if len(every) else position
    stored: list[StoredStream] = []
    first = 0
    for attribute, kind, flags, rows, params, planes, label in heads:
        stop = first + planes
        if last > len(payload) and planes and int(located.ends[stop - 1]) > len(payload):
            raise _overflow_error(label, len(payload))
        own = every[first:stop]
        stored.append(
            StoredStream(attribute, kind, flags, rows, params, own, located, first, label)
        )
        first = stop
    if last != len(payload):
        raise FormatError(
            "stream-record",
            f"{where}: {len(payload) - last} bytes after the last plane, expected none",
            clause="6.1",
        )
    return stored


def _overflow_error(label: str, length: int) -> FormatError:
    """Return the error of a record that exceeds its segment of `length` bytes."""
    return FormatError(
        "stream-record", f"{label}: leaves the segment's {length} bytes", clause="6.1"
    )


def _attribute_and_kind(number: int, kind_number: int, label: str) -> tuple[Attribute, Kind]:
    """Return the attribute and the kind of a record by their numbers."""
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
