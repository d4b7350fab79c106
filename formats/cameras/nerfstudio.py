"""Reader of ``transforms.json``, the cameras of nerfstudio, instant-ngp and NeRF's Blender scenes.

Source: nerfstudio's page "Data conventions" (docs.nerf.studio).
"""

from __future__ import annotations

import math
import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import (
    CogsplatWarning,
    DataError,
    FormatError,
    LimitError,
    StorageError,
    UnsupportedError,
)
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.images import picture_size
from cogsplat.formats.storage.json_stream import MAX_VALUE_BYTES, JsonStream
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.strict_json import JsonObject

F64 = NDArray[np.float64]

_CODE: Final = "bad-transforms-json"

# Camera models that are a pinhole with distortion; a warning says that distortion is ignored.
_MODELS: Final = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_DISTORTION: Final = ("k1", "k2", "k3", "k4", "p1", "p2")

# OpenGL's camera looks along -z with y up, OpenCV's along +z with y down.
_OPENGL_TO_OPENCV: Final = np.diag([1.0, -1.0, -1.0])

# The tolerance of `Camera`: files store rotations as rounded decimals.
_ROTATION_TOLERANCE: Final = 1e-3

_MAX_SIDE: Final = 65535
# Bytes read of an image to find its size, which may follow metadata and a thumbnail.
_PICTURE_BYTES: Final = 1 << 20
# Endings to try: Blender's scenes omit the ending, and state no size.
_ENDINGS: Final = ("", ".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class _Frames:
    """Values of a file that all its frames share.

    `undo` and `scale` revert the transform that was applied to the original poses. `sizes` caches
    the sizes of images by file path.
    """

    root: JsonObject
    folder: Path
    undo: F64
    scale: float
    # Frames often name the same image.
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)


def read_transforms(
    path: StrPath, *, original_frame: bool = False, limits: Limits | None = None
) -> list[Camera]:
    """Read cameras from a nerfstudio ``transforms.json``.

    Parameters
    ----------
    path : path
        A JSON object with an array ``frames``. Each frame has a ``transform_matrix`` (3 or 4 rows
        of 4 numbers; camera to world, OpenGL's camera axes). Intrinsics are keys of the frame or
        of the whole file: ``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h`` (px), or
        ``camera_angle_x``, ``camera_angle_y`` (radians). Without ``w`` and ``h``, the size comes
        from the PNG or JPEG named by ``file_path``.
    original_frame : bool
        Whether to revert ``applied_transform`` and ``applied_scale``, which gives the world frame
        of the source COLMAP model.
    limits : Limits, optional
        Limits; `Limits.cameras` limits the number of cameras.

    Returns
    -------
    list of Camera
        Cameras in file order, at least one, named by ``file_path``. Principal points need no
        conversion: in nerfstudio, too, the first pixel's centre is at 0.5.

    Raises
    ------
    FormatError
        ``bad-transforms-json``; the message names the frame and the key.
    DataError
        ``bad-camera``: `Camera` rejects the values, e.g. a pose that is not rigid; ``no-cameras``.
    UnsupportedError
        ``camera-model``: a camera is no pinhole.
    LimitError
        ``too-many-cameras``; ``json-too-long``: a frame, or the file without its frames, is longer
        than `MAX_VALUE_BYTES`.
    StorageError
        See `open_for_read`.

    Warns
    -----
    CogsplatWarning
        Cameras have distortion, which is ignored: nerfstudio undistorts images during training, so
        that its scenes match pinhole cameras.

    Notes
    -----
    Scenes trained by nerfstudio have another world frame: its data parser centres, rotates and
    scales the poses, and writes this transform to ``dataparser_transforms.json``.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    root, frames_at, count = _parse_without_frames(data, where, limits or Limits())
    if "frames" not in root:
        raise root.wrong("frames", "an array of cameras")
    # Raises if the value is no array.
    root.children("frames")
    if not count:
        raise DataError("no-cameras", f"{where}: 'frames' is empty, expected cameras")
    undo, scale = _applied_transform(root) if original_frame else (np.eye(4), 1.0)
    frames = _Frames(root, Path(path).parent, undo, scale)
    stream = JsonStream(data, where, _CODE)
    stream.at = frames_at
    cameras: list[Camera] = []
    distorted = 0
    # Very large values overflow here; `Camera` rejects the result.
    with np.errstate(over="ignore", invalid="ignore"):
        for index in stream.items():
            # Wrapped in an array, so that `children` reports an entry that is no object.
            entry = JsonObject({"frames": [stream.value()]}, where, _CODE).children("frames")[0]
            node = JsonObject(entry.values, f"{where}, frames {index}", _CODE)
            cameras.append(_camera(node, frames))
            distorted += any(_number(node, root, key, 0.0) for key in _DISTORTION)
    if distorted:
        warnings.warn(
            f"{where}: {distorted} of {count} cameras have lens distortion, which is ignored: "
            "expected splats trained on undistorted images",
            CogsplatWarning,
            stacklevel=2,
        )
    return cameras


def _parse_without_frames(data: bytes, where: str, limits: Limits) -> tuple[JsonObject, int, int]:
    """Parse a file except for its frames, which are only counted.

    Keys of the whole file may follow the frames, so the frames are parsed in a second pass.

    Returns
    -------
    root : JsonObject
        The file's keys, with an empty array for the frames.
    frames_at : int
        Offset of the frames, bytes.
    count : int
        Number of frames.
    """
    stream = JsonStream(data, where, _CODE)
    root: dict[str, object] = {}
    frames_at = count = other_bytes = 0
    for key in stream.members():
        is_frames = key == "frames" and stream.peek() == b"["
        start = stream.at
        if is_frames:
            frames_at, count = start, 0
            for index in stream.items():
                limits.require_cameras(index + 1, where)
                stream.value()
                count += 1
        root[key] = [] if is_frames else stream.value()
        if not is_frames:
            other_bytes += len(key) + stream.at - start
        if other_bytes > MAX_VALUE_BYTES:
            raise LimitError(
                "json-too-long",
                f"{where}: more than {MAX_VALUE_BYTES} bytes without its frames, expected fewer",
            )
    stream.finish()
    return JsonObject(root, where, _CODE), frames_at, count


def _applied_transform(root: JsonObject) -> tuple[F64, float]:
    """Return the (4, 4) inverse of ``applied_transform``, and ``applied_scale``."""
    applied = np.eye(4)
    if "applied_transform" in root:
        applied = _matrix(root, "applied_transform")
    linear = applied[:3, :3]
    error = float(np.abs(linear @ linear.T - np.eye(3)).max())
    if error > _ROTATION_TOLERANCE or np.linalg.det(linear) < 0:
        raise root.wrong("applied_transform", "a rotation and a translation")
    scale = root.number("applied_scale", 1.0)
    if not scale > 0:
        raise root.wrong("applied_scale", "a positive number")
    inverse: F64 = np.linalg.inv(applied).astype(np.float64)
    return inverse, scale


def _camera(node: JsonObject, frames: _Frames) -> Camera:
    """Return the camera of a frame."""
    _check_model(node, frames.root)
    pose = _matrix(node, "transform_matrix")
    pose[:3, 3] /= frames.scale
    pose = frames.undo @ pose
    rotation = (pose[:3, :3] @ _OPENGL_TO_OPENCV).T
    name = node.text("file_path", "")
    width, height = _size(node, name, frames)
    fx = _focal(node, frames.root, "x", width)
    if fx is None:
        raise node.wrong("fl_x", "a focal length, or camera_angle_x, here or for all frames")
    fy = _focal(node, frames.root, "y", height)
    try:
        return Camera(
            width=width,
            height=height,
            fx=fx,
            fy=fx if fy is None else fy,
            cx=_number(node, frames.root, "cx", width / 2),
            cy=_number(node, frames.root, "cy", height / 2),
            rotation=rotation,
            translation=-rotation @ pose[:3, 3],
            name=name,
        )
    except DataError as error:
        raise DataError(error.code, f"{node.where}: {error.message}") from error


def _check_model(node: JsonObject, root: JsonObject) -> None:
    """Raise ``camera-model`` if a frame has a fisheye or unknown model; allow distortion."""
    model = (node if "camera_model" in node else root).text("camera_model", _MODELS[0])
    fisheye = (node if "is_fisheye" in node else root).boolean("is_fisheye", False)
    if model not in _MODELS or fisheye:
        raise UnsupportedError(
            "camera-model",
            f"{node.where}: camera model {'fisheye' if fisheye else model!r}, expected one of "
            f"{', '.join(_MODELS)}",
        )


def _number(node: JsonObject, root: JsonObject, key: str, default: float) -> float:
    """Return the number of a key in the frame, or else in the file, or else `default`."""
    return (node if key in node else root).number(key, default)


def _focal(node: JsonObject, root: JsonObject, axis: str, size: int) -> float | None:
    """Return the focal length along an axis, px, from its key or from the angle of view."""
    for source in (node, root):
        if f"fl_{axis}" in source:
            return source.number(f"fl_{axis}")
        angle = f"camera_angle_{axis}"
        if angle in source:
            if not 0 < source.number(angle) < math.pi:
                raise source.wrong(angle, "an angle between 0 and pi")
            return size / 2 / math.tan(source.number(angle) / 2)
    return None


def _size(node: JsonObject, name: str, frames: _Frames) -> tuple[int, int]:
    """Return a frame's width and height, px, from its keys or from its image file."""
    sources = [node if key in node else frames.root for key in ("w", "h")]
    if "w" in sources[0] and "h" in sources[1]:
        return sources[0].integer("w", 1, _MAX_SIDE), sources[1].integer("h", 1, _MAX_SIDE)
    if not name:
        raise node.wrong("w", "a size, or a file_path to an image")
    if name not in frames.sizes:
        frames.sizes[name] = _picture_size(node, name, frames.folder)
    return frames.sizes[name]


def _picture_size(node: JsonObject, name: str, folder: Path) -> tuple[int, int]:
    """Return the width and height of an image file, px."""
    for ending in _ENDINGS:
        path = sibling(folder, name + ending, f"{node.where}, file_path", _CODE)
        try:
            with storage_errors(path), open_for_read(path) as file:
                size = picture_size(file.read(_PICTURE_BYTES))
        except StorageError as error:
            # Try the next ending if there is no such file.
            if error.code in ("not-found", "not-a-file"):
                continue
            raise
        if size is None:
            raise FormatError(_CODE, f"{node.where}: {path.name} has no size, expected PNG or JPEG")
        return size
    raise node.wrong("w", f"a size, or an image file {name!r}")


def _matrix(node: JsonObject, key: str) -> F64:
    """Return a key's 3 or 4 rows of 4 numbers as a (4, 4) matrix."""
    rows = node.values.get(key)
    if not isinstance(rows, list) or len(rows) not in (3, 4):
        raise node.wrong(key, "3 or 4 rows of 4 numbers")
    matrix = np.eye(4)
    for index, row in enumerate(rows):
        matrix[index] = JsonObject({key: row}, f"{node.where}, row {index}", _CODE).numbers(key, 4)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise node.wrong(key, "0 0 0 1 as its fourth row")
    return matrix
