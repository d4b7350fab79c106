"""Rendered images as 8-bit images and PNG files."""

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
    """Convert display colours to an 8-bit image.

    Parameters
    ----------
    pixels : (H, W, 3) float
        Display colours, clipped to [0, 1]; NaN becomes black.

    Returns
    -------
    PIL.Image.Image
        Image of mode RGB.
    """
    from PIL import Image

    levels = np.nan_to_num(np.clip(pixels, 0.0, 1.0)) * 255.0 + 0.5
    return Image.fromarray(levels.astype(np.uint8))


def write_png(image: Image, path: Path, *, force: bool = False) -> int:
    """Write an image as a PNG file, atomically; return the file's size in bytes.

    Raises
    ------
    StorageError
        See `atomic_write`, e.g. ``exists``.
    """
    # Encode in memory first: Pillow hides the cause of a failed write.
    page = io.BytesIO()
    image.save(page, format="PNG")
    with atomic_write(path, force=force) as file:
        file.write(page.getbuffer())
    return page.getbuffer().nbytes
