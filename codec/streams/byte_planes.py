"""Byte planes: bytes, several symbols to the byte, or a zstd frame of either (SPEC 6.3, 6.9)."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import zstd_frames
from .payload_limits import MAX_PLANE_BYTES

U8 = NDArray[np.uint8]

ZSTD_FLAG: Final = 0x8000_0000
"""Bit 31 of a plane's word: the stored bytes are a zstd frame (SPEC 6.3)."""

PACKED_FLAG: Final = 0x4000_0000
"""Bit 30 of a plane's word: several symbols to the byte, the radix in front (SPEC 6.9)."""

LENGTH_MASK: Final = 0x3FFF_FFFF

DIGITS: Final = {radix: int(np.log(256.0 + 1e-9) / np.log(radix)) for radix in range(2, 17)}
"""Symbols of each radix that fit a byte (SPEC 6.9)."""

# Of 160 planes of a captured scene, 1,062,383 bytes: 417,679 bytes at level 13, 412,756 at 15,
# 410,928 at 16, 410,927 at 17, 411,586 at 19, which takes 1.7 times as long as 17.
_LEVEL: Final = 17


def pack_plane(plane: U8, *, digits: bool = True) -> tuple[int, bytes]:
    """Code one plane in whatever way takes the fewest bytes.

    Parameters
    ----------
    plane : (n,) uint8
    digits : bool
        Whether several symbols may share a byte.

    Returns
    -------
    word : int
        Stored length and flags.
    stored : bytes

    Notes
    -----
    zstd's Huffman stage spends whole bits on a symbol. Where there are few symbols, several to a
    byte share that loss: on sparse planes this takes nearly as little as a range coder would.
    """
    best, word = _smaller(plane.tobytes())
    radix = int(plane.max(initial=0)) + 1
    if digits and len(plane) and radix in DIGITS:
        packed, flag = _smaller(_pack_digits(plane, radix).tobytes())
        if len(packed) + 1 < len(best):
            best = bytes([radix]) + packed
            word = len(best) | PACKED_FLAG | (flag & ZSTD_FLAG)
    return word, best


def _smaller(raw: bytes) -> tuple[bytes, int]:
    # One thread, no checksum (the segment has its CRC), content size always stated.
    compressor = zstandard.ZstdCompressor(
        level=_LEVEL, write_checksum=False, write_content_size=True, threads=0
    )
    frame = compressor.compress(raw)
    if len(frame) < len(raw):
        return frame, len(frame) | ZSTD_FLAG
    return raw, len(raw)


def _pack_digits(plane: U8, radix: int) -> U8:
    count = DIGITS[radix]
    padded = np.zeros(-(-len(plane) // count) * count, np.uint8)
    padded[: len(plane)] = plane
    weights = (radix ** np.arange(count)).astype(np.int64)
    packed = (padded.reshape(-1, count) * weights).sum(axis=1)
    out: U8 = packed.astype(np.uint8)
    return out


@cache
def _digit_table(radix: int) -> U8:
    """Return the (radix^count, count) digits of every byte value, the lowest first."""
    count = DIGITS[radix]
    values = np.arange(radix**count)
    return ((values[:, None] // radix ** np.arange(count)) % radix).astype(np.uint8)


@cache
def digit_tables() -> U8:
    """Return the (17, 256, 8) symbols of every byte value by radix, zeros where there are none."""
    tables = np.zeros((max(DIGITS) + 1, 256, max(DIGITS.values())), np.uint8)
    for radix, count in DIGITS.items():
        tables[radix, : radix**count, :count] = _digit_table(radix)
    return tables


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
        ``plane-length``, ``plane-radix``, ``plane-digits``, ``zstd-frame``, ``zstd-size``,
        ``zstd-window``, ``zstd-dictionary``, ``zstd-checksum``.
    """
    radix, size = packing_of(stored, word, length, where)
    packed = np.frombuffer(expand(stored[1:] if radix else stored, word, size, where), np.uint8)
    if not radix:
        return packed
    table = _digit_table(radix)
    if size and int(packed.max()) >= len(table):
        raise FormatError(
            "plane-digits",
            f"{where}: byte {int(packed.max())}, expected below {len(table)} at radix {radix}",
            clause="6.9",
        )
    digits = table.take(packed, axis=0).reshape(-1)
    if digits[length:].any():
        raise FormatError(
            "plane-digits", f"{where}: digits behind the last symbol, expected zeros", clause="6.9"
        )
    digits = digits[:length]
    digits.flags.writeable = False
    return digits


def packing_of(stored: memoryview, word: int, length: int, where: str) -> tuple[int, int]:
    """Return how a plane is packed, before any of it is decompressed.

    Parameters
    ----------
    stored, word, length, where
        As `unpack_plane` takes them.

    Returns
    -------
    radix : int
        0 where every byte is one symbol.
    size : int
        Bytes before symbols are taken apart.

    Raises
    ------
    FormatError
        ``plane-length``, ``plane-radix``.
    """
    if length > MAX_PLANE_BYTES:
        raise FormatError(
            "plane-length",
            f"{where}: {length} bytes, expected at most {MAX_PLANE_BYTES}",
            clause="9.1",
        )
    if not word & PACKED_FLAG:
        return 0, length
    radix = stored[0] if len(stored) else 0
    if radix not in DIGITS:
        raise FormatError(
            "plane-radix", f"{where}: radix {radix}, expected 2 to {max(DIGITS)}", clause="6.9"
        )
    return radix, -(-length // DIGITS[radix])


def expand(stored: memoryview, word: int, length: int, where: str) -> bytes | memoryview:
    """Return the `length` bytes that stored bytes are, or that their zstd frame holds.

    Raises
    ------
    FormatError
        As `unpack_plane`, but for what concerns packed symbols.
    """
    if not word & ZSTD_FLAG:
        if len(stored) != length:
            raise FormatError(
                "plane-length",
                f"{where}: {len(stored)} stored bytes, expected {length}",
                clause="6.3",
            )
        return stored
    return zstd_frames.decompress(stored, length, where)
