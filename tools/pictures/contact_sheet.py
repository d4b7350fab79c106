"""Contact sheets: thumbnails in a grid, each with a caption."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from .png import to_image

if TYPE_CHECKING:
    from PIL.Image import Image

THUMBNAIL: Final = (240, 180)
"""Largest width and height of a thumbnail, px."""

# A neutral dark grey, so that bright and dark images look untinted.
_BACKGROUND: Final = (24, 25, 27)
_CAPTION_COLOUR: Final = (190, 194, 198)
_FONT_PX: Final = 12
_CAPTION_PX: Final = 18
_GAP: Final = 8
# Ratio of a sheet's width to its height, near that of screens.
_ASPECT: Final = 1.5


def contact_sheet(images: Sequence[NDArray[np.floating]], captions: Sequence[str]) -> Image:
    """Arrange images in a grid, row by row, with a caption below each.

    Parameters
    ----------
    images : sequence of (H, W, 3) float
        Display colours, clipped to [0, 1]; at least one image, of any sizes. Images larger than
        `THUMBNAIL` are scaled down.
    captions : sequence of str
        One line per image, cut to the image's width. Characters are limited to Latin-1, the range
        of Pillow's built-in font.

    Returns
    -------
    PIL.Image.Image
        The sheet, mode RGB.

    Raises
    ------
    ValueError
        There are no images, or the number of captions differs.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not images or len(images) != len(captions):
        raise ValueError(f"{len(images)} images and {len(captions)} captions, expected one each")
    cell_width, cell_height = THUMBNAIL
    step_x, step_y = cell_width + _GAP, cell_height + _CAPTION_PX + _GAP
    columns = min(len(images), math.ceil(math.sqrt(_ASPECT * len(images) * step_y / step_x)))
    rows = math.ceil(len(images) / columns)
    sheet = Image.new("RGB", (columns * step_x + _GAP, rows * step_y + _GAP), _BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=_FONT_PX)
    for index, (image, caption) in enumerate(zip(images, captions, strict=True)):
        left, top = _GAP + index % columns * step_x, _GAP + index // columns * step_y
        small = to_image(image)
        small.thumbnail(THUMBNAIL)
        sheet.paste(
            small, (left + (cell_width - small.width) // 2, top + (cell_height - small.height) // 2)
        )
        while caption and font.getlength(caption) > cell_width:
            caption = caption[:-1]
        draw.text((left, top + cell_height + 2), caption, font=font, fill=_CAPTION_COLOUR)
    return sheet
