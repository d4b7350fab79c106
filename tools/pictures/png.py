"""Rendered pictures as PNG files, atomically."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cogsplat.formats.storage.atomic import atomic_write

if TYPE_CHECKING:
    from PIL.Image import Image


def to_image(pixels: NDArray[np.floating]) -> Image:
    """Return display colours as an 8-bit picture.

    Parameters
    ----------
    pixels : (H, W, 3) float
        Clipped to [0, 1]; NaN is black.

    Returns
    -------
    PIL.Image.Image
        Mode RGB.
    """
    from PIL import Image

    levels = np.nan_to_num(np.clip(pixels, 0.0, 1.0)) * 255.0 + 0.5
    return Image.fromarray(levels.astype(np.uint8))


def write_png(image: Image, path: Path, *, force: bool = False) -> int:
    """Write a picture and return its bytes.

    Raises
    ------
    StorageError
        See `atomic_write`, e.g. ``exists``.
    """
    # In memory first: Pillow's own writing to files loses the reason of a failure.
    page = io.BytesIO()
    image.save(page, format="PNG")
    with atomic_write(path, force=force) as file:
        file.write(page.getbuffer())
    return page.getbuffer().nbytes
