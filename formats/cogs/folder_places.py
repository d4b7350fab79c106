"""Where the segments of one index lie in the objects of a folder: a table of places (SPEC 3.4)."""

from __future__ import annotations

import hashlib
import struct
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from .root import HASH_BYTES

SEGMENT_FOLDER: Final = "segments"

# What servers call application/octet-stream without being told.
_OBJECT_SUFFIX: Final = ".bin"

# Of one segment: the object's name, its bytes, and where the segment begins in it (SPEC 3.4).
_ROW_BYTES: Final = HASH_BYTES + 4 + 4
_CRC_BYTES: Final = 4


def key_of(data: bytes | memoryview) -> bytes:
    """Return what names these bytes: the first 16 bytes of their SHA-256 (SPEC 5.3)."""
    return hashlib.sha256(data).digest()[:HASH_BYTES]


def object_name(key: bytes) -> str:
    """Return the name of an object by the first 16 bytes of the SHA-256 of its bytes.

    Examples
    --------
    >>> object_name(bytes(range(16)))
    'segments/000102030405060708090a0b0c0d0e0f.bin'
    """
    return f"{SEGMENT_FOLDER}/{key.hex()}{_OBJECT_SUFFIX}"


def check_object(name: str, data: bytes, where: str) -> None:
    """Refuse an object of a folder whose name does not stand for its bytes.

    Raises
    ------
    FormatError
        ``object-hash``.
    """
    if object_name(key_of(data)) != name:
        raise FormatError(
            "object-hash",
            f"{where}: {name}: its bytes have another SHA-256, and belong to "
            f"{object_name(key_of(data))}",
            clause="3.4",
        )


def places_bytes(segments: int) -> int:
    """Return the bytes of a table of places of so many segments."""
    return _ROW_BYTES * segments + _CRC_BYTES


@dataclass(frozen=True, eq=False)
class Places:
    """A table of places: one row for each segment of an index, in the order of its table.

    Parameters
    ----------
    objects : (s, 16) uint8
        First bytes of the SHA-256 of the object that a segment lies in.
    sizes : (s,) uint32
        Bytes of that object.
    offsets : (s,) uint32
        First byte of the segment within it.
    """

    objects: NDArray[np.uint8]
    sizes: NDArray[np.uint32]
    offsets: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.sizes)

    def rows(self, part: slice) -> Places:
        """Return the rows of a slice, without copying them."""
        return Places(self.objects[part], self.sizes[part], self.offsets[part])


def pack_places(places: Places) -> bytes:
    """Return a table of places as it stands in a manifest; the inverse of `unpack_places`."""
    data = (
        places.objects.astype(np.uint8).tobytes()
        + places.sizes.astype("<u4").tobytes()
        + places.offsets.astype("<u4").tobytes()
    )
    return data + struct.pack("<I", zlib.crc32(data))


def unpack_places(data: bytes, lengths: NDArray[np.uint32], where: str) -> Places:
    """Read a table of places.

    Parameters
    ----------
    data : bytes
        As long as `places_bytes` says.
    lengths : (s,) uint32
        Bytes of the segments.
    where : str
        Names the index in messages.

    Raises
    ------
    FormatError
        ``places-crc``; ``places-range``: a segment ends behind the end of its object.
    """
    body, crc = data[:-_CRC_BYTES], data[-_CRC_BYTES:]
    if zlib.crc32(body) != int.from_bytes(crc, "little"):
        raise FormatError(
            "places-crc", f"{where}: the CRC of its places does not match", clause="3.4"
        )
    count = len(lengths)
    columns = np.frombuffer(body, "<u4", 2 * count, HASH_BYTES * count)
    places = Places(
        np.frombuffer(body, np.uint8, HASH_BYTES * count).reshape(count, HASH_BYTES),
        columns[:count].astype(np.uint32),
        columns[count:].astype(np.uint32),
    )
    ends = places.offsets.astype(np.int64) + lengths
    wrong = np.flatnonzero(ends > places.sizes)
    if len(wrong):
        row = int(wrong[0])
        raise FormatError(
            "places-range",
            f"{where}: segment {row} ends at byte {int(ends[row])} of an object of "
            f"{int(places.sizes[row])} bytes, expected it inside",
            clause="3.4",
        )
    return places
