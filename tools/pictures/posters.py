"""Posters: pictures that viewers show until a scene is there."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

from cogsplat.formats.cogs.description import Picture
from cogsplat.formats.cogs.picture_header import WEBP

if TYPE_CHECKING:
    from PIL.Image import Image

# Quality of Pillow's WebP encoder: splats are soft, and a poster is seen for seconds.
_QUALITY: Final = 80


def write_poster(image: Image) -> Picture:
    """Encode an image as the poster of a description.

    Parameters
    ----------
    image : PIL.Image.Image
        Image of mode RGB, at most 8,192 px wide and high.
    """
    out = io.BytesIO()
    image.save(out, format="WEBP", quality=_QUALITY, method=6)
    return Picture(WEBP, image.width, image.height, data=out.getvalue())
