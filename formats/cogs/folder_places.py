"""Table of places: position of each segment of an index in a folder's objects (SPEC 3.4).

A table also has the position of each page that the index lists.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from .index_tables import HASH_BYTES

SEGMENT_FOLDER: Final = "segments"

# Servers send files with this suffix as application/octet-stream without configuration.
_OBJECT_SUFFIX: Final = ".bin"

# Bytes of a row: hash and length of the object, and offset of the segment in it (SPEC 3.4).
_ROW_BYTES: Final = HASH_BYTES + 4 + 4
_CRC_BYTES: Final = 4


def key_of(data: bytes | memoryview) -> bytes:
    """Return the first 16 bytes of the SHA-256 of an object or segment (SPEC 5.3)."""
    return hashlib.sha256(data).digest()[:HASH_BYTES]


def object_name(key: bytes) -> str:
    """Return the name of an object from the first 16 bytes of its SHA-256.

    Examples
    --------
    >>> object_name(bytes(range(16)))
    'segments/000102030405060708090a0b0c0d0e0f.bin'
    """
    return f"{SEGMENT_FOLDER}/{key.hex()}{_OBJECT_SUFFIX}"


def check_object(name: str, data: bytes, where: str) -> None:
    """Refuse an object whose name is not its hash.

    Parameters
    ----------
    name : str
        Name of the object.
    data : bytes
        Bytes of the object.
    where : str
        Name of the folder in messages.

    Raises
    ------
    FormatError
        ``object-hash``.
    """
    if object_name(key_of(data)) != name:
        raise FormatError(
            "object-hash",
            f"{where}: {name}: the SHA-256 of its bytes is that of {object_name(key_of(data))}, "
            "expected that of its name",
            clause="3.4",
        )


def places_bytes(rows: int) -> int:
    """Return the length of a table of places of a number of rows, bytes."""
    return _ROW_BYTES * rows + _CRC_BYTES


@dataclass(frozen=True, eq=False)
class PlaceTable:
    """Table of places: object and offset of each segment of an index, in segment-table order.

    The root's table has a row for each page behind them.

    Parameters
    ----------
    objects : (s, 16) uint8
        First 16 bytes of the SHA-256 of the object; zeros for a segment in the manifest.
    sizes : (s,) uint32
        Length of the object, bytes; 0 for a segment in the manifest.
    offsets : (s,) uint32
        Offset of the segment or page within the object, bytes.
    """

    objects: NDArray[np.uint8]
    sizes: NDArray[np.uint32]
    offsets: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.sizes)

    def rows(self, part: slice | NDArray[np.int64]) -> PlaceTable:
        """Return some rows of the table; a slice is not copied."""
        return PlaceTable(self.objects[part], self.sizes[part], self.offsets[part])


def pack_places(places: PlaceTable) -> bytes:
    """Encode a table of places for a manifest; the inverse of `unpack_places`."""
    data = (
        places.objects.astype(np.uint8).tobytes()
        + places.sizes.astype("<u4").tobytes()
        + places.offsets.astype("<u4").tobytes()
    )
    return data + struct.pack("<I", zlib.crc32(data))


def unpack_places(
    data: bytes, lengths: NDArray[np.int64], where: str, in_manifest: int = 0
) -> PlaceTable:
    """Decode and check a table of places.

    Parameters
    ----------
    data : bytes
        Encoded table, of the length `places_bytes`.
    lengths : (s,) int64
        Lengths of the segments and pages, bytes.
    where : str
        Name of the index in messages.
    in_manifest : int
        Number of first rows whose segments may be in the manifest.

    Raises
    ------
    FormatError
        ``places-crc``; ``places-range``: a segment or page ends behind the end of its object.
    """
    body, crc = data[:-_CRC_BYTES], data[-_CRC_BYTES:]
    if zlib.crc32(body) != int.from_bytes(crc, "little"):
        raise FormatError(
            "places-crc",
            f"{where}: the CRC of its table of places does not match, expected "
            f"0x{int.from_bytes(crc, 'little'):08x}",
            clause="3.4",
        )
    count = len(lengths)
    columns = np.frombuffer(body, "<u4", 2 * count, HASH_BYTES * count)
    places = PlaceTable(
        np.frombuffer(body, np.uint8, HASH_BYTES * count).reshape(count, HASH_BYTES),
        columns[:count].astype(np.uint32),
        columns[count:].astype(np.uint32),
    )
    ends = places.offsets.astype(np.int64) + lengths
    is_zero = (places.sizes == 0) & (places.offsets == 0) & ~places.objects.any(axis=1)
    is_inside = is_zero & (np.arange(count) < in_manifest)
    wrong = np.flatnonzero((ends > places.sizes) & ~is_inside)
    if len(wrong):
        row = int(wrong[0])
        raise FormatError(
            "places-range",
            f"{where}: segment or page {row} ends at byte {int(ends[row])} of an object of "
            f"{int(places.sizes[row])} bytes, expected an end within the object",
            clause="3.4",
        )
    return places
