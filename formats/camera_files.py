"""Cameras from whatever holds them: an INRIA ``cameras.json`` or a COLMAP folder."""

from __future__ import annotations

import os
from pathlib import Path

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError

from .atomic import StrPath, open_for_read, storage_errors
from .colmap import find_model, read_colmap
from .inria import read_cameras_json, write_cameras_json

__all__ = ["read_cameras", "write_cameras_json"]

_HEAD_BYTES = 64


def read_cameras(path: StrPath) -> list[Camera]:
    """Read the cameras of a scene.

    Parameters
    ----------
    path : path
        A ``cameras.json`` as 3DGS training writes it, or a COLMAP folder: one that holds
        ``cameras`` and ``images`` as ``.bin`` or ``.txt``, or has them in ``sparse/0``.

    Returns
    -------
    list of Camera
        At least one. From JSON in file order, from COLMAP by name.

    Raises
    ------
    FormatError
        ``unknown-cameras``: neither of the two. Otherwise as `read_cameras_json` and
        `read_colmap`.
    StorageError
        As `open_for_read`.
    """
    where = os.fspath(path)
    if Path(path).is_dir():
        model = find_model(Path(path))
        if model is None:
            raise FormatError(
                "unknown-cameras",
                f"{where}: expected cameras.bin and images.bin, or .txt, in this folder or in its "
                "sparse/0",
            )
        return read_colmap(model)
    with storage_errors(path), open_for_read(path) as file:
        head = file.read(_HEAD_BYTES)
    # A byte order mark is legal to find before JSON, if not to write.
    first = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if first == b"[":
        return read_cameras_json(path)
    found = f"starts with {head[:8]!r}"
    if first == b"{":
        found = "is a JSON object (a nerfstudio transforms.json?)"
    raise FormatError(
        "unknown-cameras",
        f"{where}: {found}, expected the JSON array of a cameras.json, or a COLMAP folder",
    )
