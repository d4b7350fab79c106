"""Reader of the cameras and images of a COLMAP sparse model, binary or text.

Source: COLMAP's documentation, "Output format". Binary files are little-endian without padding.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import (
    DataError,
    FormatError,
    UnsupportedError,
)
from cogsplat.codec.geometry.rotations import matrices
from cogsplat.formats.storage.atomic import is_file, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .colmap_records import COUNT, MAX_LINE_BYTES, MAX_NAME_BYTES, RecordReader, skip_line

F64 = NDArray[np.float64]

# Supported camera models: number in binary files, name, parameters.
_MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fx", "fy", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
}
# Unsupported camera models, named in the error message.
_UNSUPPORTED_MODELS = {
    5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV",
    7: "FOV",
    8: "SIMPLE_RADIAL_FISHEYE",
    9: "RADIAL_FISHEYE",
    10: "THIN_PRISM_FISHEYE",
    11: "RAD_TAN_THIN_PRISM_FISHEYE",
}
_PARAMETERS = dict(_MODELS.values())

_CAMERA = struct.Struct("<IiQQ")  # id, model, width, height; parameters follow
_POSE = struct.Struct("<I7dI")  # id, qw qx qy qz, tx ty tz, camera id; the name follows
_POINT_BYTES = 24  # x, y as doubles, then the point's 64-bit id


@dataclass(frozen=True)
class _Intrinsics:
    """A camera of COLMAP: size and pinhole parameters, px."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class _Image:
    """An image of COLMAP: its id, pose (wxyz quaternion, world to camera), camera id and name."""

    number: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int
    name: str


def find_model(folder: Path) -> Path | None:
    """Return the folder of a sparse model: `folder`, its ``sparse/0`` or its ``sparse``.

    Returns
    -------
    Path or None
        None if no folder has the files ``cameras`` and ``images``.
    """
    for candidate in (folder, folder / "sparse" / "0", folder / "sparse"):
        if _suffix(candidate):
            return candidate
    return None


def _suffix(folder: Path) -> str:
    """Return the suffix of a folder's model files, empty if there are none."""
    # Binary first, like COLMAP itself.
    for suffix in (".bin", ".txt"):
        if all(is_file(folder / f"{stem}{suffix}") for stem in ("cameras", "images")):
            return suffix
    return ""


def read_colmap(folder: Path, *, limits: Limits | None = None) -> list[Camera]:
    """Read one camera per image of a sparse model.

    Parameters
    ----------
    folder : Path
        Folder of the files ``cameras`` and ``images``, both ``.bin`` or both ``.txt``. Supported
        models are SIMPLE_PINHOLE and PINHOLE, and SIMPLE_RADIAL, RADIAL and OPENCV without
        distortion. Principal points need no conversion: in COLMAP, too, the first pixel's centre
        is at 0.5.
    limits : Limits, optional
        Limits; `Limits.cameras` limits the cameras and the images.

    Returns
    -------
    list of Camera
        Cameras sorted by image name, then image id, at least one. Poses are world to camera.

    Raises
    ------
    FormatError
        ``colmap-malformed``, ``colmap-trailing-bytes``, ``colmap-duplicate-camera``,
        ``colmap-missing-camera``; ``unknown-cameras``: the folder has no model.
    TruncatedError
        ``colmap-truncated``: a file has fewer records than it declares.
    UnsupportedError
        ``camera-model``: a camera is no pinhole.
    DataError
        ``bad-camera``: `Camera` rejects the values, or a quaternion is zero; ``no-cameras``.
    LimitError
        ``too-many-cameras``.
    StorageError
        See `open_for_read`.
    """
    limits = limits or Limits()
    suffix = _suffix(folder)
    if not suffix:
        raise FormatError("unknown-cameras", f"{folder}: expected cameras.bin and images.bin")
    binary = suffix == ".bin"
    path = folder / f"cameras{suffix}"
    with storage_errors(path), open_for_read(path) as file:
        read_intrinsics = _binary_intrinsics if binary else _text_intrinsics
        intrinsics: dict[int, _Intrinsics] = {}
        for number, values in read_intrinsics(file, str(path), limits):
            if number in intrinsics:
                raise FormatError(
                    "colmap-duplicate-camera", f"{path}: camera {number} twice, expected once"
                )
            intrinsics[number] = values
    path = folder / f"images{suffix}"
    with storage_errors(path), open_for_read(path) as file:
        read_images = _binary_images if binary else _text_images
        images = list(read_images(file, str(path), limits))
    if not images:
        raise DataError("no-cameras", f"{path}: holds no images, expected at least one")
    images.sort(key=lambda image: (image.name, image.number))
    # Very large values overflow here; `Camera` rejects the result.
    with np.errstate(over="ignore", invalid="ignore"):
        rotations = _rotations(images, str(path))
        translations = np.array([image.translation for image in images], np.float64)
        return [
            _camera(image, intrinsics, rotation, translation, str(path))
            for image, rotation, translation in zip(images, rotations, translations, strict=True)
        ]


def _camera(
    image: _Image,
    intrinsics: dict[int, _Intrinsics],
    rotation: F64,
    translation: F64,
    where: str,
) -> Camera:
    """Return the camera of an image."""
    values = intrinsics.get(image.camera)
    if values is None:
        raise FormatError(
            "colmap-missing-camera",
            f"{where}: image {image.number} ({image.name!r}) is of camera {image.camera}, expected "
            "one of the model's cameras",
        )
    try:
        return Camera(
            width=values.width,
            height=values.height,
            fx=values.fx,
            fy=values.fy,
            cx=values.cx,
            cy=values.cy,
            rotation=rotation,
            translation=translation,
            name=image.name,
        )
    except DataError as error:
        raise DataError(error.code, f"{where}: image {image.number}: {error.message}") from error


def _rotations(images: list[_Image], where: str) -> F64:
    """Return the (N, 3, 3) rotation matrices of the images' quaternions."""
    quaternions = np.array([image.quaternion for image in images], np.float64)
    norms = np.sqrt(np.square(quaternions).sum(axis=1))
    usable = (norms > 0.0) & (norms < np.inf)
    if not usable.all():
        image, norm = images[int(usable.argmin())], norms[int(usable.argmin())]
        raise DataError(
            "bad-camera",
            f"{where}: image {image.number}: camera {image.name!r}: quaternion of norm {norm}, "
            "expected about 1",
        )
    # Contiguous, so that `Camera` does not copy its matrix.
    return np.ascontiguousarray(matrices(quaternions / norms[:, None]))


def _intrinsics(name: str, width: int, height: int, values: list[float], where: str) -> _Intrinsics:
    """Return the intrinsics from the parameters of the camera model `name`; refuse distortion."""
    parameters = dict(zip(_PARAMETERS[name], values, strict=True))
    distortion = [key for key, value in parameters.items() if key[0] in "kp" and value != 0]
    if distortion:
        stated = ", ".join(f"{key}={parameters[key]:g}" for key in distortion)
        raise UnsupportedError(
            "camera-model",
            f"{where}: {name} with {stated}, expected no distortion: 3DGS trains on the images of "
            "COLMAP's image_undistorter, which writes a model without distortion to its folder",
        )
    fx = parameters.get("fx", parameters.get("f", 0.0))
    fy = parameters.get("fy", fx)
    return _Intrinsics(width, height, fx, fy, parameters["cx"], parameters["cy"])


def _unsupported_model(name: str, where: str) -> UnsupportedError:
    """Return the error about an unsupported camera model."""
    return UnsupportedError(
        "camera-model", f"{where}: camera model {name}, expected one of {', '.join(_PARAMETERS)}"
    )


def _binary_intrinsics(
    file: BinaryIO, where: str, limits: Limits
) -> Iterator[tuple[int, _Intrinsics]]:
    """Yield the id and the intrinsics of each camera of a ``cameras.bin``."""
    reader = RecordReader(file, where)
    min_bytes = _CAMERA.size + 8 * min(map(len, _PARAMETERS.values()))
    count = reader.read_count(min_bytes, "cameras")
    limits.require_cameras(count, where)
    for _ in range(count):
        number, model, width, height = _CAMERA.unpack(reader.read(_CAMERA.size, "a camera"))
        at = f"{where}: camera {number}"
        if model not in _MODELS:
            raise _unsupported_model(_UNSUPPORTED_MODELS.get(model, f"number {model}"), at)
        name, parameters = _MODELS[model]
        data = reader.read(8 * len(parameters), f"the parameters of camera {number}")
        values = list(struct.unpack(f"<{len(parameters)}d", data))
        yield number, _intrinsics(name, width, height, values, at)
    reader.require_end()


def _binary_images(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Image]:
    """Yield the images of an ``images.bin``."""
    reader = RecordReader(file, where)
    min_bytes = _POSE.size + 1 + COUNT.size
    count = reader.read_count(min_bytes, "images")
    limits.require_cameras(count, where)
    for _ in range(count):
        number, *pose, camera = _POSE.unpack(reader.read(_POSE.size, "an image"))
        name = reader.read_name(f"image {number}")
        points = reader.read_count(_POINT_BYTES, f"points of image {number}")
        reader.skip(points * _POINT_BYTES, f"{points} points of image {number}")
        yield _Image(number, tuple(pose[:4]), tuple(pose[4:]), camera, name)
    reader.require_end()


def _text_records(
    file: BinaryIO, where: str, limits: Limits, *, has_points: bool
) -> Iterator[tuple[str, list[str]]]:
    """Yield the location and the fields of each record of a text file.

    With `has_points`, as for images, the line of points after each record is skipped.
    """
    number = records = 0
    while line := file.readline(MAX_LINE_BYTES + 1):
        number += 1
        at = f"{where}: line {number}"
        if len(line) > MAX_LINE_BYTES:
            raise FormatError(
                "colmap-malformed",
                f"{at}: is longer than {MAX_LINE_BYTES} bytes, expected a record of fewer",
            )
        text = line.decode("utf-8", "replace").strip()
        if not text or text.startswith("#"):
            continue
        records += 1
        limits.require_cameras(records, where)
        # The last field of an image is its name, which may hold spaces.
        yield at, text.split(maxsplit=9 if has_points else -1)
        if has_points:
            # This line may be empty, or have megabytes.
            number += 1
            skip_line(file)


def _text_intrinsics(
    file: BinaryIO, where: str, limits: Limits
) -> Iterator[tuple[int, _Intrinsics]]:
    """Yield the id and the intrinsics of each camera of a ``cameras.txt``."""
    for at, fields in _text_records(file, where, limits, has_points=False):
        if len(fields) < 4:
            raise _malformed(at, fields, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
        name = fields[1]
        if name not in _PARAMETERS:
            raise _unsupported_model(name[:40], at)
        if len(fields) != 4 + len(_PARAMETERS[name]):
            raise _malformed(at, fields, f"the {len(_PARAMETERS[name])} parameters of {name}")
        try:
            number, width, height = int(fields[0]), int(fields[2]), int(fields[3])
            values = [float(field) for field in fields[4:]]
        except ValueError as error:
            raise _malformed(at, fields, "numbers") from error
        yield number, _intrinsics(name, width, height, values, at)


def _text_images(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Image]:
    """Yield the images of an ``images.txt``."""
    for at, fields in _text_records(file, where, limits, has_points=True):
        if len(fields) != 10:
            raise _malformed(at, fields, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        if len(fields[9]) >= MAX_NAME_BYTES:
            raise _malformed(at, fields, f"a name of fewer than {MAX_NAME_BYTES} characters")
        try:
            number, camera = int(fields[0]), int(fields[8])
            pose = [float(field) for field in fields[1:8]]
        except ValueError as error:
            raise _malformed(at, fields, "numbers") from error
        yield _Image(number, tuple(pose[:4]), tuple(pose[4:]), camera, fields[9])


def _malformed(where: str, fields: list[str], expected: str) -> FormatError:
    """Return the error about a malformed line."""
    return FormatError(
        "colmap-malformed", f"{where}: {' '.join(fields)[:80]!r}, expected {expected}"
    )
