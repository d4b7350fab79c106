"""Encode and decode the segment of cameras: a msgpack map of columns (SPEC 5.8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError, FormatError, LimitError

from . import canonical_msgpack
from .layout import MAX_CAMERA_VALUES, MAX_CAMERAS
from .msgpack_map import CheckedMap

_INTRINSICS = ("fx", "fy", "cx", "cy")
_MAX_NAME_BYTES = 255

# Memory of a `Camera` with its two arrays, bytes (measured in CPython 3.11 with numpy 2).
_CAMERA_BYTES = 1024


def check_cameras(cameras: Sequence[Camera]) -> None:
    """Refuse cameras that a file cannot store.

    Raises
    ------
    DataError
        ``too-many-cameras``: none, or more than `MAX_CAMERAS`; ``bad-camera``: a name of more than
        255 bytes, or one that is not valid Unicode.
    """
    if not 1 <= len(cameras) <= MAX_CAMERAS:
        raise DataError(
            "too-many-cameras", f"{len(cameras)} cameras to store, expected 1 to {MAX_CAMERAS}"
        )
    for camera in cameras:
        if len(camera.name.encode("utf-8", "surrogatepass")) > _MAX_NAME_BYTES or any(
            "\ud800" <= letter <= "\udfff" for letter in camera.name
        ):
            raise DataError(
                "bad-camera",
                f"camera {camera.name[:40]!r}: expected a name of at most {_MAX_NAME_BYTES} bytes "
                "of UTF-8",
            )


def pack_cameras(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as the payload of their segment; raises as `check_cameras`."""
    check_cameras(cameras)
    value: dict[str, canonical_msgpack.Value] = {
        "name": [camera.name for camera in cameras],
        "width": np.array([camera.width for camera in cameras], "<u2").tobytes(),
        "height": np.array([camera.height for camera in cameras], "<u2").tobytes(),
        "rotation": np.array([camera.rotation for camera in cameras], "<f8").tobytes(),
        "translation": np.array([camera.translation for camera in cameras], "<f8").tobytes(),
    }
    for key in _INTRINSICS:
        value[key] = np.array([getattr(camera, key) for camera in cameras], "<f8").tobytes()
    return canonical_msgpack.pack(value)


def unpack_cameras(payload: bytes, where: str, allowed_bytes: int) -> list[Camera]:
    """Decode the segment of cameras.

    Parameters
    ----------
    payload : bytes
        Bytes of the segment, whose CRC was checked.
    where : str
        Name of the segment in messages.
    allowed_bytes : int
        Memory limit of the cameras, bytes.

    Raises
    ------
    FormatError
        ``msgpack-``…, or ``root-missing``, ``root-type``, ``root-columns``, ``root-value``.
    UnsupportedError
        ``root-must-understand``.
    LimitError
        ``decoded-size``: the cameras exceed `allowed_bytes`.
    """
    values = canonical_msgpack.unpack(
        payload, where, max_values=MAX_CAMERA_VALUES, allowed_bytes=allowed_bytes
    )
    table = CheckedMap(values, where, "5.8")
    names = table.pop("name", list)
    width = table.column("width", "<u2", None).astype(np.int64)
    rows = len(width)
    height = table.column("height", "<u2", rows).astype(np.int64)
    intrinsics = np.stack([_floats(table, key, rows) for key in _INTRINSICS], axis=1)
    rotation = _floats(table, "rotation", rows, 9).reshape(rows, 3, 3)
    translation = _floats(table, "translation", rows, 3)
    texts = [name for name in names if isinstance(name, str)]
    if len(names) != rows or len(texts) != rows:
        raise table.error("name", f"{len(texts)} texts, expected {rows}", "root-columns")
    table.finish()
    if not 1 <= rows <= MAX_CAMERAS:
        raise table.error("width", f"{rows} cameras, expected 1 to {MAX_CAMERAS}")
    if rows * _CAMERA_BYTES > allowed_bytes:
        raise LimitError(
            "decoded-size",
            f"{where}: {rows} cameras take {rows * _CAMERA_BYTES} bytes, expected at most "
            f"{allowed_bytes} (SPEC 9.2)",
        )
    if any(len(text.encode()) > _MAX_NAME_BYTES for text in texts):
        raise table.error("name", f"a longer name, expected at most {_MAX_NAME_BYTES} bytes each")
    cameras = []
    for row, (fx, fy, cx, cy) in enumerate(intrinsics.tolist()):
        size = int(width[row]), int(height[row])
        pose = rotation[row], translation[row]
        try:
            camera = Camera(*size, fx, fy, cx, cy, *pose, name=texts[row])
        except DataError as error:
            raise FormatError("root-value", f"{where}: {error}", clause="5.8") from error
        cameras.append(camera)
    return cameras


def _floats(table: CheckedMap, key: str, rows: int, width: int = 1) -> NDArray[np.float64]:
    """Return a float64 column."""
    return table.column(key, "<f8", rows, width).astype(np.float64)
