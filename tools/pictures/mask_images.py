"""Object masks: images with an object label for each pixel of a view."""

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

# Pillow's modes with one number per pixel: 1 bit, palette, grey of 8, 16 and 32 bits.
_MODES: Final = frozenset({"1", "P", "L", "I;16", "I;16B", "I;16L", "I"})


def read_masks(
    folder: Path, cameras: Sequence[Camera]
) -> tuple[list[Camera], list[NDArray[np.uint32]]]:
    """Read the object masks of a folder, matched to cameras by name.

    Parameters
    ----------
    folder : Path
        Folder with a mask ``NAME.png`` for a camera ``NAME`` or ``NAME.jpg``. Cameras may lack a
        mask.
    cameras : sequence of Camera
        Cameras of the views.

    Returns
    -------
    cameras : list of Camera
        Cameras with a mask.
    masks : list of (H, W) uint32
        Label of each pixel: 0 and 1 for 1-bit images, the index for palette images.

    Raises
    ------
    StorageError
        The folder or a mask cannot be read.
    DataError
        ``no-masks``: no camera has a mask. ``mask``: a mask is no image of labels, or differs in
        size from its camera.
    """
    with storage_errors(folder):
        pngs = {path.stem: path for path in folder.iterdir() if path.suffix.lower() == ".png"}
    views: list[Camera] = []
    masks: list[NDArray[np.uint32]] = []
    for camera in cameras:
        path = pngs.get(PurePath(camera.name).stem) or pngs.get(camera.name)
        if path is not None:
            views.append(camera)
            masks.append(_read(path, camera))
    if not views:
        raise DataError(
            "no-masks",
            f"{folder}: {len(pngs)} PNGs, none named like one of {len(cameras)} cameras "
            f"(the first is {cameras[0].name!r}), expected at least one",
        )
    return views, masks


def _read(path: Path, camera: Camera) -> NDArray[np.uint32]:
    """Read the mask of a camera."""
    size = camera.width, camera.height
    labels = read_picture(path, size, code="mask", formats=("PNG",), modes=_MODES)
    return labels.astype(np.uint32)
