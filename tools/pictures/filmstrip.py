"""Film-strips: images in a row with captions, e.g. renders of prefixes of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont, ImageFont

# A neutral dark grey, so that bright and dark images look untinted.
BACKGROUND = (24, 25, 27)
_TITLE_COLOUR = (236, 237, 238)
_FIRST_LINE_COLOUR = (236, 237, 238)
_LINE_COLOUR = (160, 164, 168)

# Sizes relative to an image's width, so that strips of any size look alike.
_MARGIN, _GAP = 0.06, 0.03
_TITLE_SIZE, _FIRST_LINE_SIZE, _LINE_SIZE = 0.065, 0.060, 0.050
_SMALLEST_FONT_PX = 9
_LEADING = 1.35


def filmstrip(
    images: Sequence[NDArray[np.floating]],
    captions: Sequence[Sequence[str]],
    title: str = "",
) -> Image:
    """Arrange images in a row, with a caption below each.

    Parameters
    ----------
    images : sequence of (H, W, 3) float
        Display colours, clipped to [0, 1]; at least one image, all of one size.
    captions : sequence of sequence of str
        Lines below each image; the first line is brighter and larger. A long line is set in a
        smaller font.
    title : str
        Line above the row; empty for none.

    Returns
    -------
    PIL.Image.Image
        The strip, mode RGB.

    Raises
    ------
    ValueError
        There are no images, their sizes differ, or the number of captions differs.

    Notes
    -----
    Pillow's built-in font has Latin-1 only; e.g. an en dash shows as a box.
    """
    from PIL import Image, ImageDraw

    if not images or len(images) != len(captions):
        raise ValueError(f"{len(images)} images and {len(captions)} captions, expected one each")
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


def _px(fraction: float, width: int) -> int:
    """Return a fraction of an image's width, px, at least 1."""
    return max(1, round(fraction * width))


def _font_px(size: float, width: int) -> int:
    """Return a font size, px, from a fraction of an image's width."""
    return max(_SMALLEST_FONT_PX, round(size * width))


def _line_height(size: float, width: int) -> int:
    """Return the height of a line of text, px; `size` is a fraction of the image's `width`."""
    return round(_LEADING * _font_px(size, width))


def _fitting_font(text: str, size: float, width: int, max_width: int) -> FreeTypeFont | ImageFont:
    """Return a font of `size`, or a smaller one with which the text fits `max_width` px."""
    from PIL import ImageFont

    pixels = _font_px(size, width)
    font = ImageFont.load_default(size=pixels)
    while font.getlength(text) > max_width and pixels > _SMALLEST_FONT_PX:
        pixels -= 1
        font = ImageFont.load_default(size=pixels)
    return font
