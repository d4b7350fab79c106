"""Byte planes: the entropy stage, zstd frame or stored bytes per plane (SPEC 6.3)."""

from __future__ import annotations

from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from .errors import FormatError

U8 = NDArray[np.uint8]

ZSTD_FLAG: Final = 0x8000_0000
"""Bit 31 of a plane's word: the plane is a zstd frame; the other bits are its stored length."""

MAX_PLANE_BYTES: Final = 8 * 1024 * 1024
"""Largest decoded plane, bytes (SPEC 9.1)."""

MAX_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""Largest zstd window a reader must provide: what browsers accept (RFC 9659)."""

_FRAME_MAGIC: Final = bytes.fromhex("28b52ffd")  # RFC 8878, 3.1.1

# Level 19 is where the ratio stops growing on planes this small.
_LEVEL: Final = 19


def pack_plane(plane: U8) -> tuple[int, bytes]:
    """Compress one plane, or store it where zstd does not make it smaller.

    Parameters
    ----------
    plane : (n,) uint8

    Returns
    -------
    word : int
        Stored length, with `ZSTD_FLAG` where the bytes are a zstd frame.
    stored : bytes
    """
    raw = plane.tobytes()
    # One thread, no checksum (the segment has its CRC), content size always stated.
    compressor = zstandard.ZstdCompressor(
        level=_LEVEL, write_checksum=False, write_content_size=True, threads=0
    )
    frame = compressor.compress(raw)
    if len(frame) < len(raw):
        return len(frame) | ZSTD_FLAG, frame
    return len(raw), raw


def unpack_plane(stored: memoryview, word: int, length: int, where: str) -> U8:
    """Return the bytes of one plane.

    Parameters
    ----------
    stored : memoryview
        Exactly the plane's stored bytes.
    word : int
        The plane's word.
    length : int
        Decoded length in bytes that the stream's record implies.
    where : str
        Names the plane in messages.

    Returns
    -------
    (length,) uint8, read-only; a view of `stored` where the plane is not compressed.

    Raises
    ------
    FormatError
        ``plane-length``, ``zstd-frame``, ``zstd-size``, ``zstd-window``, ``zstd-dictionary``,
        ``zstd-checksum``.
    """
    if length > MAX_PLANE_BYTES:
        raise FormatError(
            "plane-length",
            f"{where}: {length} bytes, expected at most {MAX_PLANE_BYTES}",
            clause="9.1",
        )
    if not word & ZSTD_FLAG:
        if len(stored) != length:
            raise FormatError(
                "plane-length",
                f"{where}: {len(stored)} stored bytes, expected {length}",
                clause="6.3",
            )
        return np.frombuffer(stored, np.uint8)
    # Skippable and legacy frames have other magic numbers, and zstd would accept the first.
    if bytes(stored[:4]) != _FRAME_MAGIC:
        raise FormatError(
            "zstd-frame",
            f"{where}: starts with {bytes(stored[:4]).hex()}, expected {_FRAME_MAGIC.hex()}",
            clause="6.3",
        )
    try:
        parameters = zstandard.get_frame_parameters(stored)
    except zstandard.ZstdError as error:
        raise FormatError("zstd-frame", f"{where}: {error}", clause="6.3") from error
    # Before anything is allocated: the frame's own claim must be the length the record implies.
    if parameters.content_size != length:
        raise FormatError(
            "zstd-size",
            f"{where}: the frame states {parameters.content_size} bytes, expected {length}",
            clause="6.3",
        )
    if parameters.window_size > MAX_WINDOW_BYTES:
        raise FormatError(
            "zstd-window",
            f"{where}: window of {parameters.window_size} bytes, "
            f"expected at most {MAX_WINDOW_BYTES}",
            clause="6.3",
        )
    if parameters.dict_id:
        raise FormatError(
            "zstd-dictionary",
            f"{where}: dictionary {parameters.dict_id}, expected none",
            clause="6.3",
        )
    # Decoders for browsers do not verify it: a wrong one would be an error in some readers only.
    if parameters.has_checksum:
        raise FormatError(
            "zstd-checksum",
            f"{where}: the frame has a checksum, expected none beside the segment's CRC",
            clause="6.3",
        )
    try:
        raw = zstandard.ZstdDecompressor().decompress(stored, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise FormatError("zstd-frame", f"{where}: {error}", clause="6.3") from error
    if len(raw) != length:
        raise FormatError(
            "zstd-size", f"{where}: {len(raw)} bytes, expected {length}", clause="6.3"
        )
    return np.frombuffer(raw, np.uint8)
