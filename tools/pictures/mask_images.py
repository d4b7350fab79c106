"""Masks: pictures that say which object each pixel of a view shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.formats.storage.pictures import read_picture

# Pillow's modes whose pixels are one number: bits, palettes, greys of 8, 16 and 32 bits.
_MODES: Final = frozenset({"1", "P", "L", "I;16", "I;16B", "I;16L", "I"})


def read_masks(
    folder: Path, cameras: Sequence[Camera]
) -> tuple[list[Camera], list[NDArray[np.uint32]]]:
    """Read the masks of some views, by the cameras' names.

    Parameters
    ----------
    folder : Path
        Holds ``NAME.png`` for cameras named ``NAME`` or ``NAME.jpg``; not all need have one.
    cameras : sequence of Camera

    Returns
    -------
    cameras : list of Camera
        Those that have a mask.
    masks : list of (H, W) uint32
        Labels; of pictures of one bit 0 and 1, of palettes the indices.

    Raises
    ------
    StorageError
        The folder or a mask cannot be read.
    DataError
        ``no-masks``: no camera has one. ``mask``: one is no picture of labels, or of another size
        than its camera.
    """
    with storage_errors(folder):
        there = {path.stem: path for path in folder.iterdir() if path.suffix.lower() == ".png"}
    views: list[Camera] = []
    masks: list[NDArray[np.uint32]] = []
    for camera in cameras:
        path = there.get(PurePath(camera.name).stem) or there.get(camera.name)
        if path is not None:
            views.append(camera)
            masks.append(_read(path, camera))
    if not views:
        raise DataError(
            "no-masks",
            f"{folder}: {len(there)} PNGs, none named as one of {len(cameras)} cameras "
            f"(the first is {cameras[0].name!r}), expected some",
        )
    return views, masks


def _read(path: Path, camera: Camera) -> NDArray[np.uint32]:
    size = camera.width, camera.height
    labels = read_picture(path, size, code="mask", formats=("PNG",), modes=_MODES)
    return labels.astype(np.uint32)
