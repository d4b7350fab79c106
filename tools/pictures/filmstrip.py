"""Film-strips: pictures side by side with captions below, such as prefixes of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont, ImageFont

# A neutral dark grey: next to it neither bright nor dark pictures look tinted.
BACKGROUND = (24, 25, 27)
_TITLE_COLOUR = (236, 237, 238)
_FIRST_LINE_COLOUR = (236, 237, 238)
_LINE_COLOUR = (160, 164, 168)

# Shares of a picture's width, so that strips of any size look alike.
_MARGIN, _GAP = 0.06, 0.03
_TITLE_SIZE, _FIRST_LINE_SIZE, _LINE_SIZE = 0.065, 0.060, 0.050
_SMALLEST_FONT_PX = 9
_LEADING = 1.35


def filmstrip(
    images: Sequence[NDArray[np.floating]],
    captions: Sequence[Sequence[str]],
    title: str = "",
) -> Image:
    """Lay pictures out in a row, each with its caption.

    Parameters
    ----------
    images : sequence of (H, W, 3) float
        Display colours in [0, 1], clipped to it; all of one size, at least one.
    captions : sequence of sequence of str
        Lines under each picture, the first one brighter and larger. A line too long for its
        picture is set smaller.
    title : str
        One line above the row; none if empty.

    Returns
    -------
    PIL.Image.Image
        Mode RGB.

    Raises
    ------
    ValueError
        If there are no pictures, or their sizes or the number of captions do not fit.

    Notes
    -----
    Pillow's own font draws Latin-1; a dash wider than a hyphen shows as a box.
    """
    from PIL import Image, ImageDraw

    if not images or len(images) != len(captions):
        raise ValueError(f"{len(images)} images and {len(captions)} captions, expected as many")
    shape = images[0].shape
    if len(shape) != 3 or shape[2] != 3 or any(image.shape != shape for image in images):
        raise ValueError(f"images of {[image.shape for image in images]}, expected one (H, W, 3)")
    height, width = shape[:2]
    margin, gap = _px(_MARGIN, width), _px(_GAP, width)
    heading = _line_height(_TITLE_SIZE, width) + gap if title else 0
    lines = max(len(caption) for caption in captions)
    sizes = [_FIRST_LINE_SIZE] + [_LINE_SIZE] * (lines - 1) if lines else []
    text_height = sum(_line_height(size, width) for size in sizes) + (gap if lines else 0)
    strip = Image.new(
        "RGB",
        (
            2 * margin + len(images) * width + (len(images) - 1) * gap,
            2 * margin + heading + height + text_height,
        ),
        BACKGROUND,
    )
    draw = ImageDraw.Draw(strip)
    if title:
        font = _fitting_font(title, _TITLE_SIZE, width, strip.width - 2 * margin)
        draw.text((margin, margin), title, font=font, fill=_TITLE_COLOUR)
    for i, (image, caption) in enumerate(zip(images, captions, strict=True)):
        left, top = margin + i * (width + gap), margin + heading
        pixels = np.nan_to_num(np.clip(image, 0.0, 1.0)) * 255.0 + 0.5
        strip.paste(Image.fromarray(pixels.astype(np.uint8)), (left, top))
        top += height + gap
        for row, line in enumerate(caption):
            font = _fitting_font(line, sizes[row], width, width)
            fill = _LINE_COLOUR if row else _FIRST_LINE_COLOUR
            draw.text((left, top), line, font=font, fill=fill)
            top += _line_height(sizes[row], width)
    return strip


def _px(share: float, width: int) -> int:
    return max(1, round(share * width))


def _font_px(size: float, width: int) -> int:
    return max(_SMALLEST_FONT_PX, round(size * width))


def _line_height(size: float, width: int) -> int:
    return round(_LEADING * _font_px(size, width))


def _fitting_font(text: str, size: float, width: int, room: int) -> FreeTypeFont | ImageFont:
    """Return the font for a line of text: of `size`, or smaller where it would exceed `room`."""
    from PIL import ImageFont

    pixels = _font_px(size, width)
    font = ImageFont.load_default(size=pixels)
    while font.getlength(text) > room and pixels > _SMALLEST_FONT_PX:
        pixels -= 1
        font = ImageFont.load_default(size=pixels)
    return font
