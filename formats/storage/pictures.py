"""Photos and masks of a scene: checks of format, size and mode before decoding."""

from __future__ import annotations

import io
import warnings
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError

from .atomic import open_for_read, storage_errors
from .parser_errors import parser_errors


def read_picture(
    path: Path,
    size: tuple[int, int],
    *,
    code: str,
    formats: tuple[str, ...],
    modes: Collection[str] = (),
    convert: str = "",
) -> NDArray[np.generic]:
    """Read a picture of a known size.

    Parameters
    ----------
    path : Path
        Image file.
    size : (int, int)
        Required width and height, px, checked before the pixels are decoded.
    code : str
        Reason code of every refusal.
    formats : tuple of str
        Pillow's names of the formats to try. Pillow's default is some forty parsers, old ones
        included.
    modes : collection of str
        Pillow's names of the accepted modes; empty accepts any.
    convert : str
        Mode to convert the picture to; empty keeps its own.

    Returns
    -------
    (height, width) or (height, width, channels) array
        Pixels, with the dtype of the mode in numpy.

    Raises
    ------
    DataError
        `code`: another format, size or mode, or a damaged file.
    StorageError
        The errors of `open_for_read`.
    """
    from PIL import Image

    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    expected = f"expected a picture ({' or '.join(formats)})"
    with (
        parser_errors(lambda text: DataError(code, f"{path}: {text}, {expected}")),
        warnings.catch_warnings(),
    ):
        # More pixels than any camera has are an error instead of a warning.
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(io.BytesIO(data), formats=formats) as image:
            found, mode = image.size, image.mode
            if found == size and (not modes or mode in modes):
                return np.asarray(image.convert(convert) if convert else image)
    raise DataError(
        code,
        f"{path}: {found[0]}x{found[1]} px of mode {mode}, expected its camera's "
        f"{size[0]}x{size[1]}" + (" and one number per pixel" if modes else ""),
    )
