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

from .parser_errors import parser_errors

U8 = NDArray[np.uint8]

MAX_PIXELS: Final = (1 << 30) // 12
"""Largest decoded image, pixels; above it, Pillow suspects a decompression bomb (its default)."""

MAX_SIDE: Final = 16383
"""Longest side of a written image, pixels: lossless WebP has 14 bits for it (RFC 9649, 3.4)."""

# Smallest files for values in Morton order; higher settings are slower and save nothing.
_QUALITY: Final = 75
_METHOD: Final = 1

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
# JPEG markers among those of frames: Huffman tables, extensions and arithmetic conditioning.
_NO_FRAMES: Final = (0xC4, 0xC8, 0xCC)
# WebP files have one or two chunks before their data; more are padding, or an attack.
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
        ``image-format``: a format other than lossless still WebP and PNG.
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
            "image-truncated", f"{where}: {len(data)} bytes, expected a complete image"
        ) from error
    if width * height > MAX_PIXELS:
        raise LimitError(
            "image-too-large", f"{where}: {width}x{height}, expected at most {MAX_PIXELS} pixels"
        )
    return width, height


def _webp_size(data: bytes, where: str) -> tuple[int, int]:
    """Return width and height of a lossless WebP file from its chunks (RFC 9649, 2.3 to 2.7)."""
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
    """Return the error for an image of another format."""
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
        RGBA as stored; alpha 255 for an image without alpha.

    Raises
    ------
    FormatError
        ``image-damaged``. Other errors as `image_size`.
    MissingExtraError
        ``needs-pillow``: Pillow is not installed.
    """
    width, height = image_size(data, where)
    pillow = _pillow(where)
    with (
        parser_errors(
            lambda found: FormatError(
                "image-damaged", f"{where}: {found}, expected a complete image"
            )
        ),
        pillow.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image,
    ):
        pixels = np.asarray(image.convert("RGBA"))
    if pixels.shape != (height, width, 4):
        raise FormatError(
            "image-damaged", f"{where}: decoded to {pixels.shape}, expected {height, width, 4}"
        )
    return pixels


def encode_image(pixels: U8, where: str) -> bytes:
    """Encode pixels as a lossless WebP.

    Parameters
    ----------
    pixels : (height, width, 3 or 4) uint8
        RGB or RGBA.
    where : str
        Name of the image for messages.

    Raises
    ------
    MissingExtraError
        ``needs-pillow``.
    """
    out = io.BytesIO()
    # exact: without it, colours with alpha 0, which store numbers here, become zero.
    _pillow(where).fromarray(pixels).save(
        out, "WEBP", lossless=True, exact=True, quality=_QUALITY, method=_METHOD
    )
    return out.getvalue()


def _pillow(where: str) -> ModuleType:
    """Return the module ``PIL.Image``, or raise ``needs-pillow``."""
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
            "needs-pillow",
            f"{where}: Pillow was built without WebP, expected it; install a wheel from PyPI",
        )
    return image


def picture_size(head: bytes) -> tuple[int, int] | None:
    """Return width and height of a PNG or JPEG from its first bytes; None if undetermined."""
    try:
        if head.startswith(_PNG):
            width, height = struct.unpack_from(">II", head, 16)
            return width, height
        if not head.startswith(_JPEG):
            return None
        offset = 2
        while True:
            # ITU T.81, B.1.1.4: marker segments with a length; frame headers hold the size.
            prefix, marker, length = struct.unpack_from(">BBH", head, offset)
            if prefix != 0xFF or length < 2:
                return None
            if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES:
                height, width = struct.unpack_from(">HH", head, offset + 5)
                return width, height
            offset += 2 + length
    except struct.error:
        return None
