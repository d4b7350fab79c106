"""zstd frames of planes: headers checked here, blocks decoded by libzstd (SPEC 6.3)."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final, cast

import numpy as np
import zstandard
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import huffman_streams
from .payload_limits import MAX_WINDOW_BYTES

U64 = NDArray[np.uint64]

_MAGIC: Final = bytes.fromhex("28b52ffd")  # RFC 8878, 3.1.1

# RFC 8878, 3.1.1.1.1: fields of the frame header's descriptor.
_DICTIONARY_BITS: Final = 0x03
_CHECKSUM_BIT: Final = 0x04
_RESERVED_BIT: Final = 0x08
_SINGLE_SEGMENT_BIT: Final = 0x20
_DICTIONARY_BYTES: Final = (0, 1, 2, 4)
_SIZE_BYTES: Final = (0, 2, 4, 8)

# Only zstandard's C backend decompresses several frames in one call, without the interpreter's
# lock. The call creates a decompressor of its own, which takes as long as four frames.
_HAS_BATCH_CALL: Final = "multi_decompress_to_buffer" in zstandard.backend_features
_MIN_BATCH_FRAMES: Final = 8

_local = threading.local()
# Hashes of the frames whose streams were checked; None where they are not to be checked.
_exact: ContextVar[set[int] | None] = ContextVar("cogsplat_exact_frames", default=None)


@contextmanager
def exact_streams(known: set[int] | None = None) -> Iterator[None]:
    """Within the block, refuse Huffman streams that do not end with their last code (SPEC 6.3).

    Verifiers must check this. Readers may skip the check, which takes longer than decoding itself.
    The check applies to frames that the same thread decompresses.

    Parameters
    ----------
    known : set of int, optional
        Hashes of frames that earlier blocks have checked; this block adds its own.
    """
    token = _exact.set(set() if known is None else known)
    try:
        yield
    finally:
        _exact.reset(token)


def decompress(stored: memoryview, length: int, where: str) -> bytes:
    """Decompress one zstd frame of exactly `length` bytes.

    Parameters
    ----------
    stored : memoryview
        The frame, without further bytes.
    length : int
        Decoded length in bytes, already checked against the limits.
    where : str
        Name of the frame in messages.

    Raises
    ------
    FormatError
        ``zstd-frame``, ``zstd-size``, ``zstd-window``, ``zstd-dictionary``, ``zstd-checksum``: the
        first that applies, in this order. The header is checked before anything is decoded.
    """
    _check_header(stored, length, where)
    try:
        raw = _decompress_frame(stored, length)
    except zstandard.ZstdError as error:
        raise FormatError("zstd-frame", f"{where}: {error}", clause="6.3") from error
    if len(raw) != length:
        raise FormatError(
            "zstd-frame", f"{where}: a frame of {len(raw)} bytes, expected {length}", clause="6.3"
        )
    if not _has_exact_streams(stored):
        raise FormatError(
            "zstd-frame",
            f"{where}: a Huffman stream that does not end with its last code, expected its first "
            "bit there",
            clause="6.3",
        )
    return raw


def decompress_located(stored: memoryview, frames: U64, sizes: U64) -> bytes | None:
    """Decompress several zstd frames into consecutive bytes; None if a frame is damaged.

    Parameters
    ----------
    stored : memoryview
        Bytes that contain the frames.
    frames : (n, 2) uint64
        Position and length of each frame, bytes. The caller has checked that each frame has a
        valid header and ends with its last block.
    sizes : (n,) uint64
        Decompressed size of each frame, bytes; above 0.
    """
    try:
        if len(frames) < _MIN_BATCH_FRAMES or not _HAS_BATCH_CALL:
            raw = b"".join(map(_decompressor().decompress, _parts(stored, frames)))
        else:
            raw = _decompress_batch(stored, frames, sizes)
    except zstandard.ZstdError:
        # The caller decompresses frame by frame instead, which raises the error of the damaged one.
        return None
    if _exact.get() is None or all(map(_has_exact_streams, _parts(stored, frames))):
        return raw
    return None


def _parts(stored: memoryview, frames: U64) -> list[memoryview]:
    """Return the stored bytes of each frame; parameters as in `decompress_located`."""
    return [stored[first : first + length] for first, length in frames.tolist()]


def _decompress_batch(stored: memoryview, frames: U64, sizes: U64) -> bytes:
    """Decompress several frames in one call; see `decompress_located`."""
    source = zstandard.BufferWithSegments(stored, frames.astype("<u8").tobytes())
    found = _decompressor().multi_decompress_to_buffer(
        source, decompressed_sizes=sizes.astype("<u8").tobytes()
    )
    # Segments are buffers; their declared type lacks that.
    return b"".join(cast(list[bytes], [found[number] for number in range(len(found))]))


def _has_exact_streams(stored: memoryview) -> bool:
    """Tell whether the Huffman streams of a frame that libzstd accepts end with their last code.

    Always true outside of `exact_streams`.
    """
    known = _exact.get()
    if known is None:
        return True
    # The key of Python's hash is random: a file cannot contain another frame of a known hash.
    key = hash(bytes(stored))
    if key not in known:
        if not huffman_streams.end_exactly(stored, _header_bytes(stored[4])):
            return False
        known.add(key)
    return True


def _header_bytes(descriptor: int) -> int:
    """Return the length of a frame header, bytes (RFC 8878, 3.1.1.1)."""
    window_bytes = int(not descriptor & _SINGLE_SEGMENT_BIT)
    dictionary_bytes = _DICTIONARY_BYTES[descriptor & _DICTIONARY_BITS]
    return 5 + window_bytes + dictionary_bytes + _size_bytes(descriptor)


def _size_bytes(descriptor: int) -> int:
    """Return the length of the content size in a frame header, bytes."""
    return _SIZE_BYTES[descriptor >> 6] or int(bool(descriptor & _SINGLE_SEGMENT_BIT))


def _check_header(stored: memoryview, length: int, where: str) -> None:
    """Raise the error of the first rule of SPEC 6.3 that a frame header breaks.

    libzstd's own check is not used: it accepts skippable frames and dictionary fields that hold 0,
    and reports the largest windows as damage.
    """
    if stored[:4] != _MAGIC:
        raise FormatError(
            "zstd-frame",
            f"{where}: starts with {bytes(stored[:4]).hex()}, expected {_MAGIC.hex()}",
            clause="6.3",
        )
    descriptor = stored[4] if len(stored) > 4 else 0
    single_segment = bool(descriptor & _SINGLE_SEGMENT_BIT)
    header_bytes = _header_bytes(descriptor)
    if len(stored) < header_bytes:
        raise FormatError(
            "zstd-frame",
            f"{where}: {len(stored)} bytes, expected a frame header of {header_bytes}",
            clause="6.3",
        )
    if descriptor & _RESERVED_BIT:
        raise FormatError(
            "zstd-frame",
            f"{where}: the reserved bit of the frame header is set, expected 0",
            clause="6.3",
        )
    # A size in two bytes is stored less 256 (RFC 8878, 3.1.1.1.4).
    size_bytes = _size_bytes(descriptor)
    stated = int.from_bytes(stored[header_bytes - size_bytes : header_bytes], "little")
    stated += 256 if size_bytes == 2 else 0
    if not size_bytes or stated != length:
        found = stated if size_bytes else "no content size"
        raise FormatError(
            "zstd-size", f"{where}: the frame states {found}, expected {length}", clause="6.3"
        )
    window = length if single_segment else _window_bytes(stored[5])
    if window > MAX_WINDOW_BYTES:
        raise FormatError(
            "zstd-window",
            f"{where}: window of {window} bytes, expected at most {MAX_WINDOW_BYTES}",
            clause="6.3",
        )
    if descriptor & _DICTIONARY_BITS:
        raise FormatError(
            "zstd-dictionary",
            f"{where}: the frame header has a dictionary field, expected none",
            clause="6.3",
        )
    # Decoders in browsers do not verify checksums: a wrong one would fail in some readers only.
    if descriptor & _CHECKSUM_BIT:
        raise FormatError(
            "zstd-checksum",
            f"{where}: the frame has a checksum, expected none beside the segment's CRC",
            clause="6.3",
        )


def _window_bytes(descriptor: int) -> int:
    """Return the window size of a window descriptor, bytes (RFC 8878, 3.1.1.1.2)."""
    base: int = 1 << 10 + (descriptor >> 3)
    return base + base // 8 * (descriptor & 7)


def _decompress_frame(stored: memoryview, length: int) -> bytes:
    """Decompress one whole frame; the caller has checked its header."""
    if length:
        raw: bytes = _decompressor().decompress(stored, allow_extra_data=False)
        return raw
    # `decompress` ignores the blocks of a frame of 0 bytes, and bytes after it.
    piecewise = _decompressor().decompressobj()
    raw = piecewise.decompress(stored)
    if not piecewise.eof or piecewise.unused_data:
        raise zstandard.ZstdError("not one whole frame")
    return raw


def _decompressor() -> zstandard.ZstdDecompressor:
    """Return this thread's decompressor, reused because creating one takes longer than a frame."""
    try:
        found: zstandard.ZstdDecompressor = _local.decompressor
    except AttributeError:
        found = _local.decompressor = zstandard.ZstdDecompressor()
    return found
