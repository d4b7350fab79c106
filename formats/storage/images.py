"""Lossless 8-bit images (WebP, PNG) that store numbers; sizes are checked before decoding."""

from __future__ import annotations

import importlib
import io
import struct
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import (
    FormatError,
    LimitError,
    MissingExtraError,
    TruncatedError,
    UnsupportedError,
)

U8 = NDArray[np.uint8]

MAX_PIXELS: Final = (1 << 30) // 12
"""Largest image that is decoded: beyond it Pillow suspects a decompression bomb (its default)."""

MAX_SIDE: Final = 16383
"""Longest side that is written: lossless WebP has 14 bits for it (RFC 9649, 3.4)."""

# The effort at which numbers in Morton order come out smallest; more is slower and no smaller.
_QUALITY: Final = 75
_METHOD: Final = 1

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
# Huffman tables, extensions and arithmetic conditioning, among the markers of frames.
_NO_FRAMES: Final = (0xC4, 0xC8, 0xCC)
# Pictures have one or two chunks before their data: more are padding, or there to keep us busy.
_MAX_CHUNKS: Final = 16


def image_size(data: bytes, where: str) -> tuple[int, int]:
    """Return width and height of a lossless image from its header.

    Parameters
    ----------
    data : bytes
        The whole file.
    where : str
        Name of the image for messages.

    Raises
    ------
    UnsupportedError
        ``image-format``: no lossless still WebP and no PNG.
    FormatError
        ``image-damaged``: the header contradicts itself.
    TruncatedError
        ``image-truncated``: the file ends inside its header.
    LimitError
        ``image-too-large``: more than `MAX_PIXELS`.
    """
    try:
        if data.startswith(_PNG):
            width, height = struct.unpack_from(">II", data, 16)
        else:
            width, height = _webp_size(data, where)
    except struct.error as error:
        raise TruncatedError(
            "image-truncated", f"{where}: {len(data)} bytes, expected a whole image"
        ) from error
    if width * height > MAX_PIXELS:
        raise LimitError(
            "image-too-large", f"{where}: {width}x{height}, expected at most {MAX_PIXELS} pixels"
        )
    return width, height


def _webp_size(data: bytes, where: str) -> tuple[int, int]:
    """Walk the chunks of a WebP file (RFC 9649, 2.3 to 2.7) to its lossless picture."""
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise _unsupported(f"starts with {data[:12].hex(' ')}", where)
    offset = 12
    canvas: tuple[int, int] | None = None
    for _ in range(_MAX_CHUNKS):
        kind, length = struct.unpack_from("<4sI", data, offset)
        if kind == b"VP8L":
            (bits,) = struct.unpack_from("<I", data, offset + 9)
            size = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
            if canvas and canvas != size:
                raise FormatError(
                    "image-damaged", f"{where}: a picture of {size} on a canvas of {canvas}"
                )
            return size
        if kind == b"VP8X":
            low, middle, high = struct.unpack_from("<HHH", data, offset + 12)
            canvas = (low | (middle & 0xFF) << 16) + 1, (middle >> 8 | high << 8) + 1
        elif kind in (b"VP8 ", b"ANIM", b"ANMF"):
            raise _unsupported("is lossy" if kind == b"VP8 " else "is an animation", where)
        offset += 8 + length + (length & 1)
    raise _unsupported(f"has no picture in its first {_MAX_CHUNKS} chunks", where)


def _unsupported(found: str, where: str) -> UnsupportedError:
    return UnsupportedError("image-format", f"{where}: {found}, expected a lossless WebP or a PNG")


def decode_image(data: bytes, where: str) -> U8:
    """Return the pixels of a lossless image.

    Parameters
    ----------
    data : bytes
        The whole file.
    where : str
        Name of the image for messages.

    Returns
    -------
    (height, width, 4) uint8
        RGBA as stored, alpha 255 where there is none.

    Raises
    ------
    FormatError
        ``image-damaged``. Otherwise as `image_size`.
    MissingExtraError
        ``needs-pillow``: Pillow is not installed.
    """
    width, height = image_size(data, where)
    pillow = _pillow(where)
    try:
        with pillow.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
            pixels = np.asarray(image.convert("RGBA"))
    # Whatever a foreign decoder trips over here, it is the image's fault.
    except Exception as error:
        raise FormatError(
            "image-damaged",
            f"{where}: {str(error)[:200] or type(error).__name__}, expected a whole image",
        ) from error
    if pixels.shape != (height, width, 4):
        raise FormatError(
            "image-damaged", f"{where}: decoded to {pixels.shape}, expected {height, width, 4}"
        )
    return pixels


def encode_image(pixels: U8, where: str) -> bytes:
    """Return a lossless WebP of (height, width, 3 or 4) uint8 pixels.

    Raises
    ------
    MissingExtraError
        ``needs-pillow``.
    """
    out = io.BytesIO()
    # exact: colours behind alpha 0 are numbers here, and would be zeroed.
    _pillow(where).fromarray(pixels).save(
        out, "WEBP", lossless=True, exact=True, quality=_QUALITY, method=_METHOD
    )
    return out.getvalue()


def _pillow(where: str) -> ModuleType:
    try:
        features = importlib.import_module("PIL.features")
        image = importlib.import_module("PIL.Image")
    except ImportError as error:
        raise MissingExtraError(
            "needs-pillow",
            f"{where}: images need Pillow (pip install 'cogsplat[encode]'), expected it installed",
        ) from error
    if not features.check("webp"):
        raise MissingExtraError(
            "needs-pillow", f"{where}: this Pillow was built without WebP, expected it with"
        )
    return image


def picture_size(head: bytes) -> tuple[int, int] | None:
    """Return width and height of a PNG or JPEG from its first bytes, None where they do not say."""
    try:
        if head.startswith(_PNG):
            width, height = struct.unpack_from(">II", head, 16)
            return width, height
        if not head.startswith(_JPEG):
            return None
        offset = 2
        while True:
            # ITU T.81, B.1.1.4: markers of segments with a length; frame headers hold the size.
            prefix, marker, length = struct.unpack_from(">BBH", head, offset)
            if prefix != 0xFF or length < 2:
                return None
            if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES:
                height, width = struct.unpack_from(">HH", head, offset + 5)
                return width, height
            offset += 2 + length
    except struct.error:
        return None
