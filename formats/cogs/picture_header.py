"""Headers of JPEG and WebP pictures, read before any decoder sees the picture (SPEC 5.14)."""

from __future__ import annotations

import struct
from typing import Final

from cogsplat.codec.errors import FormatError

JPEG: Final = "image/jpeg"
WEBP: Final = "image/webp"

# JPEG markers of C0 to CF that start no frame: Huffman tables, extensions, arithmetic conditioning.
_NO_FRAMES: Final = (0xC4, 0xC8, 0xCC)
# Frames that browsers decode: baseline, extended sequential, progressive.
_FRAMES: Final = (0xC0, 0xC1, 0xC2)
# Largest number of chunks before the picture data of a WebP; more are padding, or an attack.
_MAX_CHUNKS: Final = 16


def picture_header(data: bytes, where: str) -> tuple[str, int, int]:
    """Return media type, width and height of a picture from its header.

    Parameters
    ----------
    data : bytes
        File of the picture.
    where : str
        Name of the picture for messages.

    Raises
    ------
    FormatError
        ``picture-header``: another format than JPEG and still WebP, or a cut picture.
    """
    try:
        if data[:2] == b"\xff\xd8":
            return JPEG, *_jpeg_size(data, where)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return WEBP, *_webp_size(data, where)
    except struct.error:
        raise _refusal(where, f"ends after {len(data)} bytes inside its header") from None
    raise _refusal(where, f"starts with {data[:12].hex(' ')}")


def _refusal(where: str, found: str) -> FormatError:
    """Return the error for a picture that is not a whole JPEG or WebP."""
    return FormatError(
        "picture-header", f"{where}: {found}, expected a whole JPEG or still WebP", clause="5.14"
    )


def _jpeg_size(data: bytes, where: str) -> tuple[int, int]:
    """Return the size of a JPEG from its first frame header (ITU T.81, B.2.2)."""
    if data[-2:] != b"\xff\xd9":
        raise _refusal(where, "does not end with the marker of a JPEG's end")
    offset = 2
    while True:
        prefix, marker, length = struct.unpack_from(">BBH", data, offset)
        if prefix != 0xFF or length < 2:
            raise _refusal(where, f"has no marker segment at byte {offset}")
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES:
            bits, height, width, components = struct.unpack_from(">BHHB", data, offset + 4)
            if marker not in _FRAMES or bits != 8 or components not in (1, 3):
                raise _refusal(where, f"has a frame {marker:#x} of {components}x{bits} bits")
            return width, height
        offset += 2 + length


def _webp_size(data: bytes, where: str) -> tuple[int, int]:
    """Return the size of a still WebP from its chunks (RFC 9649, 2.3 to 2.7)."""
    (riff_bytes,) = struct.unpack_from("<I", data, 4)
    if riff_bytes + 8 != len(data):
        raise _refusal(where, f"has {len(data)} bytes, its header says {riff_bytes + 8}")
    offset = 12
    canvas: tuple[int, int] | None = None
    for _ in range(_MAX_CHUNKS):
        kind, length = struct.unpack_from("<4sI", data, offset)
        chunk = data[offset + 8 : offset + 8 + length]
        if len(chunk) < length:
            raise _refusal(where, f"ends inside the chunk at byte {offset}")
        if kind in (b"VP8 ", b"VP8L"):
            size = _frame_size(kind, chunk, where)
            if canvas not in (None, size):
                raise _refusal(where, f"has a picture of {size} on a canvas of {canvas}")
            return size
        if kind in (b"ANIM", b"ANMF"):
            break
        if kind == b"VP8X":
            flags, low, middle, high = struct.unpack_from("<IHHH", chunk)
            if flags & 2:
                break
            canvas = (low | (middle & 0xFF) << 16) + 1, (middle >> 8 | high << 8) + 1
        offset += 8 + length + (length & 1)
    raise _refusal(where, "has no still picture in its first chunks")


def _frame_size(kind: bytes, chunk: bytes, where: str) -> tuple[int, int]:
    """Return the size in the frame header of a lossy or lossless WebP (RFC 9649, 2.5 and 2.6)."""
    if kind == b"VP8 " and chunk[3:6] == b"\x9d\x01\x2a":
        width, height = struct.unpack_from("<HH", chunk, 6)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L" and chunk[:1] == b"\x2f":
        (bits,) = struct.unpack_from("<I", chunk, 1)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    raise _refusal(where, "has no frame header")
