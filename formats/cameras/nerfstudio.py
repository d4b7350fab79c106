"""Cameras from a ``transforms.json``, as nerfstudio, instant-ngp and Blender's NeRF scenes have it.

Follows nerfstudio's page "Data conventions" (docs.nerf.studio).
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

# Lenses that are a pinhole but for distortion, which is said and left out.
_MODELS: Final = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_DISTORTION: Final = ("k1", "k2", "k3", "k4", "p1", "p2")

# OpenGL's camera looks along -z with y up, OpenCV's along +z with y down.
_OPENGL_TO_OPENCV: Final = np.diag([1.0, -1.0, -1.0])

# As `Camera` allows: files carry rotations as rounded decimals.
_ROTATION_TOLERANCE: Final = 1e-3

_MAX_SIDE: Final = 65535
# Pictures have their size behind metadata and a thumbnail.
_PICTURE_BYTES: Final = 1 << 20
# Blender's scenes leave the ending out, and say no size.
_ENDINGS: Final = ("", ".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class _Frames:
    """Values that hold for every frame of a file."""

    root: JsonObject
    folder: Path
    undo: F64
    scale: float
    # By file path: scenes of one size often name one picture, and it is not read for every frame.
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)


def read_transforms(
    path: StrPath, *, original_frame: bool = False, limits: Limits | None = None
) -> list[Camera]:
    """Read cameras from a nerfstudio ``transforms.json``.

    Parameters
    ----------
    path : path
        An object with ``frames``, each with a ``transform_matrix`` (3 or 4 rows of 4; camera to
        world, OpenGL's camera axes), and intrinsics in the frame or for all: ``fl_x``, ``fl_y``,
        ``cx``, ``cy``, ``w``, ``h`` (px), or ``camera_angle_x``, ``camera_angle_y`` (radians).
        Without ``w`` and ``h`` the size is taken from the PNG or JPEG that ``file_path`` names.
    original_frame : bool
        Whether to undo ``applied_transform`` and ``applied_scale``, and so return to the world of
        the COLMAP model that the file was made from.
    limits : Limits, optional
        `Limits.cameras` counts.

    Returns
    -------
    list of Camera
        In file order, at least one, named by ``file_path``. Pixel centres count from 0.5 on both
        sides, so principal points are taken as they are.

    Raises
    ------
    FormatError
        ``bad-transforms-json``, with frame and key.
    DataError
        ``bad-camera``: as `Camera`, a pose that is not rigid among them; ``no-cameras``.
    UnsupportedError
        ``camera-model``: a lens that is no pinhole.
    LimitError
        ``too-many-cameras``: more than `limits` allow; ``json-too-long``: a frame, or all that is
        no frame, is longer than `MAX_VALUE_BYTES`.
    StorageError
        See `open_for_read`.

    Warns
    -----
    CogsplatWarning
        Distortion other than zero, which is left out: nerfstudio undistorts its images as it
        trains, and what it trains is a pinhole's view.

    Notes
    -----
    A scene that nerfstudio itself trained is in neither frame: its data parser centres, turns and
    scales the poses, and writes how to ``dataparser_transforms.json``.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    root, frames_at, count = _scan(data, where, limits or Limits())
    if "frames" not in root:
        raise root.wrong("frames", "an array of cameras")
    # Refused here where it is no array.
    root.children("frames")
    if not count:
        raise DataError("no-cameras", f"{where}: 'frames' is empty, expected cameras")
    undo, scale = _applied(root) if original_frame else (np.eye(4), 1.0)
    frames = _Frames(root, Path(path).parent, undo, scale)
    stream = JsonStream(data, where, _CODE)
    stream.at = frames_at
    cameras: list[Camera] = []
    bent = 0
    # Absurd magnitudes overflow on the way to `Camera`, which refuses what comes of them.
    with np.errstate(over="ignore", invalid="ignore"):
        for index in stream.items():
            # Through an array, which refuses what is no object in the words of the others.
            entry = JsonObject({"frames": [stream.value()]}, where, _CODE).children("frames")[0]
            node = JsonObject(entry.values, f"{where}, frames {index}", _CODE)
            cameras.append(_camera(node, frames))
            bent += any(_number(node, root, key, 0.0) for key in _DISTORTION)
    if bent:
        warnings.warn(
            f"{where}: {bent} of {count} cameras have lens distortion, which is left out: "
            "expected splats trained on undistorted images",
            CogsplatWarning,
            stacklevel=2,
        )
    return cameras


def _scan(data: bytes, where: str, limits: Limits) -> tuple[JsonObject, int, int]:
    """Return what a file says beside its frames, where these begin, and how many they are.

    What is said for all frames may stand behind them, so they are read a second time.
    """
    stream = JsonStream(data, where, _CODE)
    root: dict[str, object] = {}
    frames_at = count = others = 0
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
            others += len(key) + stream.at - start
        if others > MAX_VALUE_BYTES:
            raise LimitError(
                "json-too-long",
                f"{where}: more than {MAX_VALUE_BYTES} bytes beside its frames, expected fewer",
            )
    stream.finish()
    return JsonObject(root, where, _CODE), frames_at, count


def _applied(root: JsonObject) -> tuple[F64, float]:
    """Return the (4, 4) inverse of the transform applied to the original poses, and its scale."""
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
    model = (node if "camera_model" in node else root).text("camera_model", _MODELS[0])
    fisheye = (node if "is_fisheye" in node else root).boolean("is_fisheye", False)
    if model not in _MODELS or fisheye:
        raise UnsupportedError(
            "camera-model",
            f"{node.where}: camera model {'fisheye' if fisheye else model!r}, expected one of "
            f"{', '.join(_MODELS)}",
        )


def _number(node: JsonObject, root: JsonObject, key: str, default: float) -> float:
    """Return a frame's own number, or that of all frames, or `default`."""
    return (node if key in node else root).number(key, default)


def _focal(node: JsonObject, root: JsonObject, axis: str, size: int) -> float | None:
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
    sources = [node if key in node else frames.root for key in ("w", "h")]
    if "w" in sources[0] and "h" in sources[1]:
        return sources[0].integer("w", 1, _MAX_SIDE), sources[1].integer("h", 1, _MAX_SIDE)
    if not name:
        raise node.wrong("w", "a size, or a file_path to an image")
    if name not in frames.sizes:
        frames.sizes[name] = _picture_size(node, name, frames.folder)
    return frames.sizes[name]


def _picture_size(node: JsonObject, name: str, folder: Path) -> tuple[int, int]:
    for ending in _ENDINGS:
        path = sibling(folder, name + ending, f"{node.where}, file_path", _CODE)
        try:
            with storage_errors(path), open_for_read(path) as file:
                size = picture_size(file.read(_PICTURE_BYTES))
        except StorageError as error:
            # The next ending may name a file.
            if error.code in ("not-found", "not-a-file"):
                continue
            raise
        if size is None:
            raise FormatError(_CODE, f"{node.where}: {path.name} has no size, expected PNG or JPEG")
        return size
    raise node.wrong("w", f"a size, or an image {name!r} to take it from")


def _matrix(node: JsonObject, key: str) -> F64:
    """Return 3 or 4 rows of 4 numbers as (4, 4)."""
    rows = node.values.get(key)
    if not isinstance(rows, list) or len(rows) not in (3, 4):
        raise node.wrong(key, "3 or 4 rows of 4 numbers")
    matrix = np.eye(4)
    for index, row in enumerate(rows):
        matrix[index] = JsonObject({key: row}, f"{node.where}, row {index}", _CODE).numbers(key, 4)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise node.wrong(key, "0 0 0 1 as its fourth row")
    return matrix
