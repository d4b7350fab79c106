"""Byte planes: plain bytes, packed symbols, or a zstd frame of either (SPEC 6.3, 6.9)."""

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
"""Bit 30 of a plane's word: each byte packs several symbols, after one byte of radix (SPEC 6.9)."""

LENGTH_MASK: Final = 0x3FFF_FFFF
"""Bits of a plane's word that hold its stored length, bytes."""

DIGITS: Final = {radix: int(np.log(256.0 + 1e-9) / np.log(radix)) for radix in range(2, 17)}
"""Symbols per byte for each radix (SPEC 6.9)."""

# zstd level. 160 planes of a captured scene (1,062,383 bytes) become 417,679 bytes at level 13,
# 412,756 at 15, 410,928 at 16, 410,927 at 17 and 411,586 at 19; 19 takes 1.7 times as long as 17.
_LEVEL: Final = 17


def pack_plane(plane: U8, *, digits: bool = True) -> tuple[int, bytes]:
    """Encode one plane as plain bytes, packed symbols or a zstd frame, whichever is smallest.

    Parameters
    ----------
    plane : (n,) uint8
        Symbols of the plane.
    digits : bool
        Whether to pack several symbols per byte, as digits of a number, where this is smaller.

    Returns
    -------
    word : int
        Stored length and flags.
    stored : bytes
        Encoded plane.

    Notes
    -----
    zstd's Huffman stage spends whole bits on a symbol. With several symbols per byte the rounding
    loss is shared: sparse planes become nearly as small as with a range coder.
    """
    best, word = _compress_if_smaller(plane.tobytes())
    radix = int(plane.max(initial=0)) + 1
    if digits and len(plane) and radix in DIGITS:
        packed, flag = _compress_if_smaller(_pack_digits(plane, radix).tobytes())
        if len(packed) + 1 < len(best):
            best = bytes([radix]) + packed
            word = len(best) | PACKED_FLAG | (flag & ZSTD_FLAG)
    return word, best


def _compress_if_smaller(raw: bytes) -> tuple[bytes, int]:
    """Return a zstd frame or the bytes themselves, whichever is shorter, and their plane word."""
    # One thread, no checksum (the segment has its CRC), content size always stated.
    compressor = zstandard.ZstdCompressor(
        level=_LEVEL, write_checksum=False, write_content_size=True, threads=0
    )
    frame = compressor.compress(raw)
    if len(frame) < len(raw):
        return frame, len(frame) | ZSTD_FLAG
    return raw, len(raw)


def _pack_digits(plane: U8, radix: int) -> U8:
    """Return a plane with several symbols of a radix per byte, padded with zeros."""
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
    """Return the lookup table of symbols by radix, byte value and place, (17, 256, 8).

    Places and byte values that a radix does not use are 0.
    """
    tables = np.zeros((max(DIGITS) + 1, 256, max(DIGITS.values())), np.uint8)
    for radix, count in DIGITS.items():
        tables[radix, : radix**count, :count] = _digit_table(radix)
    return tables


def unpack_plane(stored: memoryview, word: int, length: int, where: str) -> U8:
    """Return the bytes of one plane.

    Parameters
    ----------
    stored : memoryview
        Stored bytes of the plane.
    word : int
        Word of the plane: stored length and flags (SPEC 6.3).
    length : int
        Decoded length in bytes, implied by the stream's record.
    where : str
        Name of the plane in messages.

    Returns
    -------
    (length,) uint8, read-only; a view of `stored` if the plane is not compressed.

    Raises
    ------
    FormatError
        ``plane-length``, ``plane-radix``, ``plane-digits``, ``zstd-frame``, ``zstd-size``,
        ``zstd-window``, ``zstd-dictionary``, ``zstd-checksum``.
    """
    radix, size = parse_packing(stored, word, length, where)
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
            "plane-digits", f"{where}: digits after the last symbol, expected zeros", clause="6.9"
        )
    digits = digits[:length]
    digits.flags.writeable = False
    return digits


def parse_packing(stored: memoryview, word: int, length: int, where: str) -> tuple[int, int]:
    """Return the radix of a plane's packed symbols, and the size that the packed plane has.

    Nothing is decompressed yet: the size is the one that decompression must yield.

    Parameters
    ----------
    stored, word, length, where
        See `unpack_plane`.

    Returns
    -------
    radix : int
        Number of values that a packed symbol can take; 0 if every byte is one symbol.
    size : int
        Size after decompression and before symbols are unpacked, bytes.

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
    """Return the `length` bytes of a plane, decompressed if its word has `ZSTD_FLAG`.

    Parameters
    ----------
    stored : memoryview
        Stored bytes of the plane.
    word : int
        Word of the plane: stored length and flags (SPEC 6.3).
    length : int
        Size after decompression, bytes.
    where : str
        Name of the plane in messages.

    Raises
    ------
    FormatError
        ``plane-length``, or a code of `zstd_frames.decompress`.
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
