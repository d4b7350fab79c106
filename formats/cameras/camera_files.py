"""Read cameras from any known format: cameras.json, transforms.json, COLMAP, COGS."""

from __future__ import annotations

import os
from pathlib import Path

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.atomic import (
    StrPath,
    is_file,
    is_folder,
    open_for_read,
    storage_errors,
)
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import COGS_MAGIC, MANIFEST_MAGIC

from .colmap import find_model, read_colmap
from .inria import read_cameras_json, write_cameras_json
from .nerfstudio import read_transforms

__all__ = ["read_cameras", "write_cameras_json"]

_HEAD_BYTES = 64

# Files tried in a folder without a COLMAP model; the second name is Blender's.
_TRANSFORMS = ("transforms.json", "transforms_train.json")


def read_cameras(path: StrPath, *, limits: Limits | None = None) -> list[Camera]:
    """Read the cameras of a scene from a file or folder of any known format.

    Parameters
    ----------
    path : path
        A ``cameras.json`` of 3DGS training, a nerfstudio ``transforms.json``, a COGS file with
        cameras, or a folder. A folder has a COLMAP model, itself or in ``sparse/0`` or ``sparse``,
        or else a ``transforms.json``.
    limits : Limits, optional
        Limits; `Limits.cameras` limits the number of cameras in every format.

    Returns
    -------
    list of Camera
        Cameras, at least one: of COLMAP sorted by image name, of other formats in file order.

    Raises
    ------
    FormatError
        ``unknown-cameras``: the format is unknown; ``no-cameras``: a COGS file without cameras.
        Other codes as in `read_cameras_json`, `read_transforms`, `read_colmap` and `open_cogs`.
    LimitError
        ``too-many-cameras``, ``json-too-long``.
    StorageError
        See `open_for_read`.
    """
    where = os.fspath(path)
    if is_file(Path(path) / MANIFEST_NAME):
        return _stored_cameras(path, limits or Limits())
    if is_folder(path):
        model = find_model(Path(path))
        if model is not None:
            return read_colmap(model, limits=limits)
        for name in _TRANSFORMS:
            if is_file(Path(path) / name):
                return read_transforms(Path(path) / name, limits=limits)
        raise FormatError(
            "unknown-cameras",
            f"{where}: expected cameras.bin and images.bin, or .txt, in this folder or in its "
            "sparse/0, or a transforms.json",
        )
    with storage_errors(path), open_for_read(path) as file:
        head = file.read(_HEAD_BYTES)
    # RFC 8259 allows readers to ignore a byte order mark.
    first = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if first == b"[":
        return read_cameras_json(path, limits=limits)
    if first == b"{":
        return read_transforms(path, limits=limits)
    if head.startswith((COGS_MAGIC, MANIFEST_MAGIC)):
        return _stored_cameras(path, limits or Limits())
    raise FormatError(
        "unknown-cameras",
        f"{where}: starts with {head[:8]!r}, expected a cameras.json, a transforms.json, a "
        "COGS file, or a COLMAP folder",
    )


def _stored_cameras(path: StrPath, limits: Limits) -> list[Camera]:
    """Return the cameras stored in a COGS file or folder."""
    source = open_source(path)
    try:
        with open_cogs(source, limits=limits) as file:
            cameras = file.cameras()
    finally:
        source.close()
    if not cameras:
        raise FormatError(
            "no-cameras",
            f"{os.fspath(path)}: has no cameras, expected a COGS file with stored cameras",
        )
    limits.require_cameras(len(cameras), os.fspath(path))
    return cameras
