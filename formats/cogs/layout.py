"""Preamble, limits and segment kinds of a COGS file (SPEC 3, 5, 9)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from cogsplat.codec.errors import FormatError, TruncatedError, UnsupportedError
from cogsplat.formats.storage.magic import COGS_MAGIC, describe

MAGIC: Final = COGS_MAGIC
MAJOR: Final = 0
MINOR: Final = 3

_PREAMBLE: Final = struct.Struct("<8sHHIQII28xI")
PREAMBLE_BYTES: Final = _PREAMBLE.size

MAX_ROOT_END: Final = 16384
"""Maximum end of the root, byte offset: one request for 16 KiB opens a file (SPEC 3.3)."""

FIRST_READ: Final = 65536
"""Size of the first read of a file, bytes (SPEC 8.1)."""

MAX_FILE_BYTES: Final = (1 << 53) - 1
"""Maximum length of a file, bytes: exact in a float64, and so in a browser (SPEC 9.1)."""

MAX_PAGE_BYTES: Final = 1 << 20
MAX_PAGES: Final = 128
MAX_PAGE_DEPTH: Final = 3
MAX_SEGMENTS: Final = 1 << 21
MAX_CODEBOOKS: Final = 32
MAX_LEVELS: Final = 16
MAX_SPLATS: Final = (1 << 31) - 1
MAX_CAMERAS: Final = 1 << 16
MAX_CAMERA_VALUES: Final = 1 << 17
"""Maximum number of msgpack values of the cameras, and of the description (SPEC 9.1)."""

MAX_DESCRIPTION_BYTES: Final = 1 << 20
MAX_PICTURE_BYTES: Final = 1 << 24


class SegmentKind(IntEnum):
    """Segment kinds (SPEC 5.2); readers may skip kinds from 128 on."""

    HEAD = 1
    TAIL = 2
    SHAPE_CODEBOOK = 3
    COLOUR_BAND1 = 4
    COLOUR_BAND2 = 5
    COLOUR_BAND3 = 6
    REFINEMENT = 7
    OPACITIES = 8
    CAMERAS = 128
    ATTRIBUTES = 129
    COMPENSATION = 130
    VIEW_TABLE = 131
    DESCRIPTION = 132
    PICTURE = 133


COLOUR_BANDS: Final = (
    SegmentKind.COLOUR_BAND1,
    SegmentKind.COLOUR_BAND2,
    SegmentKind.COLOUR_BAND3,
)

CODEBOOK_KINDS: Final = (SegmentKind.SHAPE_CODEBOOK, *COLOUR_BANDS)

SKIPPABLE_KIND: Final = 128


@dataclass(frozen=True)
class Preamble:
    """First 64 bytes of a file (SPEC 3.1).

    Parameters
    ----------
    major, minor : int
        Format version.
    root_length : int
        Length of the root, bytes.
    file_length : int
        Length of the file, bytes.
    root_crc : int
        CRC-32 of the root.
    """

    major: int
    minor: int
    root_length: int
    file_length: int
    root_crc: int


def pack_preamble(preamble: Preamble) -> bytes:
    """Return the 64 bytes of a preamble."""
    head = _PREAMBLE.pack(
        MAGIC,
        preamble.major,
        preamble.minor,
        preamble.root_length,
        preamble.file_length,
        preamble.root_crc,
        0,
        0,
    )[:-4]
    return head + struct.pack("<I", zlib.crc32(head))


def unpack_preamble(data: bytes, where: str) -> Preamble:
    """Read and check a preamble.

    Parameters
    ----------
    data : bytes
        First 64 bytes of the file, or all bytes of a shorter one.
    where : str
        Name of the file in messages.

    Raises
    ------
    FormatError
        ``not-cogs``, ``preamble-crc``, ``preamble-reserved``, ``root-length``, ``file-length``.
    TruncatedError
        ``preamble-truncated``.
    UnsupportedError
        ``version-major``, ``version-minor``.
    """
    if data[: len(MAGIC)] != MAGIC[: len(data)]:
        raise FormatError(
            "not-cogs",
            f"{where}: is {describe(data)}, expected a COGS file",
            clause="3.1",
            offset=0,
        )
    if len(data) < PREAMBLE_BYTES:
        raise TruncatedError(
            "preamble-truncated",
            f"{where}: ends after {len(data)} bytes, expected a preamble of {PREAMBLE_BYTES}",
            clause="3.1",
            offset=0,
            needed=PREAMBLE_BYTES,
        )
    fields = _PREAMBLE.unpack_from(data)
    _, major, minor, root_length, file_length, root_crc, reserved, crc = fields
    if zlib.crc32(data[: PREAMBLE_BYTES - 4]) != crc:
        raise FormatError(
            "preamble-crc",
            f"{where}: the preamble's CRC does not match, expected {crc:#010x}",
            clause="3.1",
            offset=60,
        )
    if major != MAJOR:
        raise UnsupportedError(
            "version-major",
            f"{where}: version {major}.{minor}, expected {MAJOR}.{MINOR} (SPEC 3.2)",
        )
    # Before 1.0, minor versions are not compatible with each other.
    if minor != MINOR:
        raise UnsupportedError(
            "version-minor",
            f"{where}: version {major}.{minor}, expected {MAJOR}.{MINOR} (SPEC 3.2)",
        )
    if reserved or any(data[32:60]):
        raise FormatError(
            "preamble-reserved",
            f"{where}: reserved bytes are set, expected zeros",
            clause="3.1",
            offset=28,
        )
    if not 1 <= root_length <= MAX_ROOT_END - PREAMBLE_BYTES:
        raise FormatError(
            "root-length",
            f"{where}: a root of {root_length} bytes, expected 1 to "
            f"{MAX_ROOT_END - PREAMBLE_BYTES}",
            clause="3.3",
            offset=12,
        )
    if not PREAMBLE_BYTES + root_length <= file_length <= MAX_FILE_BYTES:
        raise FormatError(
            "file-length",
            f"{where}: a file length of {file_length} bytes, expected "
            f"{PREAMBLE_BYTES + root_length} to {MAX_FILE_BYTES}",
            clause="3.3",
            offset=16,
        )
    return Preamble(major, minor, root_length, file_length, root_crc)
