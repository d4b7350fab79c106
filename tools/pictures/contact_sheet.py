"""Contact sheets: many small pictures in a grid, each with its caption."""

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
"""Width and height of the room for a picture, px."""

# A neutral dark grey: next to it neither bright nor dark pictures look tinted.
_BACKGROUND: Final = (24, 25, 27)
_CAPTION_COLOUR: Final = (190, 194, 198)
_FONT_PX: Final = 12
_CAPTION_PX: Final = 18
_GAP: Final = 8
# Width to height of a sheet, about that of the screens it is looked at on.
_ASPECT: Final = 1.5


def contact_sheet(images: Sequence[NDArray[np.floating]], captions: Sequence[str]) -> Image:
    """Lay pictures out in a grid, row by row, each with its caption below.

    Parameters
    ----------
    images : sequence of (H, W, 3) float
        Display colours in [0, 1], clipped to it; at least one, of any sizes. Those larger than
        `THUMBNAIL` are scaled down into it.
    captions : sequence of str
        One line each, in Latin-1, which is what Pillow's own font draws; cut where it is too long.

    Returns
    -------
    PIL.Image.Image
        Mode RGB.

    Raises
    ------
    ValueError
        If there are no pictures, or not as many captions.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not images or len(images) != len(captions):
        raise ValueError(f"{len(images)} images and {len(captions)} captions, expected as many")
    room_width, room_height = THUMBNAIL
    step_x, step_y = room_width + _GAP, room_height + _CAPTION_PX + _GAP
    columns = min(len(images), math.ceil(math.sqrt(_ASPECT * len(images) * step_y / step_x)))
    rows = math.ceil(len(images) / columns)
    sheet = Image.new("RGB", (columns * step_x + _GAP, rows * step_y + _GAP), _BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=_FONT_PX)
    for place, (image, caption) in enumerate(zip(images, captions, strict=True)):
        left, top = _GAP + place % columns * step_x, _GAP + place // columns * step_y
        small = to_image(image)
        small.thumbnail(THUMBNAIL)
        sheet.paste(
            small, (left + (room_width - small.width) // 2, top + (room_height - small.height) // 2)
        )
        while caption and font.getlength(caption) > room_width:
            caption = caption[:-1]
        draw.text((left, top + room_height + 2), caption, font=font, fill=_CAPTION_COLOUR)
    return sheet
