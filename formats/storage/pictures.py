"""Pictures of a scene, photos and masks: few formats, one size, and refusals for all else."""

from __future__ import annotations

import io
import warnings
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError

from .atomic import open_for_read, storage_errors


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
    size : (int, int)
        Width and height it must have, px, which is asked before its pixels are decoded.
    code : str
        Reason code of every refusal.
    formats : tuple of str
        Pillow's names of the formats to try. Without such a list it tries some forty, with parsers
        of every age among them, whatever the file is called.
    modes : collection of str
        Pillow's names of the modes it may have; any where there are none.
    convert : str
        Mode to convert it to; as stored where empty.

    Returns
    -------
    (height, width) or (height, width, channels) array
        Of the type that the mode has in numpy.

    Raises
    ------
    DataError
        `code`: it is none of `formats`, damaged, or of another size or mode.
    StorageError
        As `open_for_read`.
    """
    from PIL import Image

    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    try:
        with warnings.catch_warnings():
            # Of more pixels than any camera has: to be refused, not warned of.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=formats) as image:
                found, mode = image.size, image.mode
                if found == size and (not modes or mode in modes):
                    return np.asarray(image.convert(convert) if convert else image)
    except MemoryError:
        raise
    # Whatever a foreign decoder trips over here, it is the picture's fault.
    except Exception as error:
        raise DataError(
            code,
            f"{path}: {str(error)[:200] or type(error).__name__}, expected a picture "
            f"({' or '.join(formats)})",
        ) from error
    raise DataError(
        code,
        f"{path}: {found[0]}x{found[1]} px of mode {mode}, expected its camera's "
        f"{size[0]}x{size[1]}" + (" and one number per pixel" if modes else ""),
    )
