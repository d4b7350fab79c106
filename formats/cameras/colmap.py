"""COLMAP reconstructions: the cameras and images of a sparse model, binary or text.

Layout after COLMAP's documentation, "Output format": little-endian, no padding.
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
from cogsplat.formats.storage.atomic import open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .colmap_records import COUNT, MAX_LINE_BYTES, MAX_NAME_BYTES, RecordReader, skip_line

F64 = NDArray[np.float64]

# COLMAP, camera models: number in binary files, name, parameters.
_MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fx", "fy", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
}
# Never read, but named in the refusal.
_OTHER_MODELS = {
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
_POSE = struct.Struct("<I7dI")  # id, qw qx qy qz, tx ty tz, camera; a zero-ended name follows
_POINT_BYTES = 24  # x, y as doubles, then the point's 64-bit number


@dataclass(frozen=True)
class _Lens:
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class _Image:
    number: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int
    name: str


def find_model(folder: Path) -> Path | None:
    """Return the folder that holds a sparse model: this one, its ``sparse/0`` or ``sparse``."""
    for candidate in (folder, folder / "sparse" / "0", folder / "sparse"):
        if _suffix(candidate):
            return candidate
    return None


def _suffix(folder: Path) -> str:
    # COLMAP itself prefers binary where both are there.
    for suffix in (".bin", ".txt"):
        if all((folder / f"{stem}{suffix}").is_file() for stem in ("cameras", "images")):
            return suffix
    return ""


def read_colmap(folder: Path, *, limits: Limits | None = None) -> list[Camera]:
    """Read one camera per image of a sparse model.

    Parameters
    ----------
    folder : Path
        Holds ``cameras`` and ``images``, both ``.bin`` or both ``.txt``. Pinhole models are read,
        and SIMPLE_RADIAL, RADIAL and OPENCV whose distortion is zero. Both sides count pixel
        centres from 0.5, so principal points are taken as they are.
    limits : Limits, optional
        `Limits.cameras` counts for cameras and for images.

    Returns
    -------
    list of Camera
        Sorted by image name, then image number, at least one. Poses are as COLMAP's: world to
        camera.

    Raises
    ------
    FormatError
        ``colmap-malformed``, ``colmap-trailing-bytes``, ``colmap-duplicate-camera``,
        ``colmap-missing-camera``; ``unknown-cameras``: the files are not there.
    TruncatedError
        ``colmap-truncated``: a file ends before what it counts.
    UnsupportedError
        ``camera-model``: a lens that is not a pinhole.
    DataError
        ``bad-camera``: as `Camera`, or a zero quaternion; ``no-cameras``.
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
        read_lenses = _binary_lenses if binary else _text_lenses
        lenses: dict[int, _Lens] = {}
        for number, lens in read_lenses(file, str(path), limits):
            if number in lenses:
                raise FormatError(
                    "colmap-duplicate-camera", f"{path}: camera {number} twice, expected once"
                )
            lenses[number] = lens
    path = folder / f"images{suffix}"
    with storage_errors(path), open_for_read(path) as file:
        read_images = _binary_images if binary else _text_images
        images = list(read_images(file, str(path), limits))
    if not images:
        raise DataError("no-cameras", f"{path}: holds no images, expected at least one")
    images.sort(key=lambda image: (image.name, image.number))
    # Absurd magnitudes overflow on the way to `Camera`, which refuses what comes of them.
    with np.errstate(over="ignore", invalid="ignore"):
        rotations = _rotations(images, str(path))
        translations = np.array([image.translation for image in images], np.float64)
        return [
            _camera(image, lenses, rotation, translation, str(path))
            for image, rotation, translation in zip(images, rotations, translations, strict=True)
        ]


def _camera(
    image: _Image, lenses: dict[int, _Lens], rotation: F64, translation: F64, where: str
) -> Camera:
    lens = lenses.get(image.lens)
    if lens is None:
        raise FormatError(
            "colmap-missing-camera",
            f"{where}: image {image.number} ({image.name!r}) is of camera {image.lens}, expected "
            "one of the model's cameras",
        )
    try:
        return Camera(
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            rotation=rotation,
            translation=translation,
            name=image.name,
        )
    except DataError as error:
        raise DataError(error.code, f"{where}: image {image.number}: {error.message}") from error


def _rotations(images: list[_Image], where: str) -> F64:
    """Return the (N, 3, 3) rotation matrices of wxyz quaternions, normalised."""
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
    # One row after the other in memory, so that no camera copies its own.
    return np.ascontiguousarray(matrices(quaternions / norms[:, None]))


def _lens(name: str, width: int, height: int, values: list[float], where: str) -> _Lens:
    parameters = dict(zip(_PARAMETERS[name], values, strict=True))
    bent = [key for key, value in parameters.items() if key[0] in "kp" and value != 0]
    if bent:
        raise UnsupportedError(
            "camera-model",
            f"{where}: {name} with {', '.join(f'{k}={parameters[k]:g}' for k in bent)}, expected "
            "no distortion: splats are trained on the images of COLMAP's image_undistorter, whose "
            "model lies in the folder that it wrote",
        )
    fx = parameters.get("fx", parameters.get("f", 0.0))
    fy = parameters.get("fy", fx)
    return _Lens(width, height, fx, fy, parameters["cx"], parameters["cy"])


def _refuse_model(name: str, where: str) -> UnsupportedError:
    return UnsupportedError(
        "camera-model", f"{where}: camera model {name}, expected one of {', '.join(_PARAMETERS)}"
    )


def _binary_lenses(file: BinaryIO, where: str, limits: Limits) -> Iterator[tuple[int, _Lens]]:
    reader = RecordReader(file, where)
    least = _CAMERA.size + 8 * min(map(len, _PARAMETERS.values()))
    count = reader.count(least, "cameras")
    limits.require_cameras(count, where)
    for _ in range(count):
        number, model, width, height = _CAMERA.unpack(reader.take(_CAMERA.size, "a camera"))
        at = f"{where}: camera {number}"
        if model not in _MODELS:
            raise _refuse_model(_OTHER_MODELS.get(model, f"number {model}"), at)
        name, parameters = _MODELS[model]
        data = reader.take(8 * len(parameters), f"the parameters of camera {number}")
        values = list(struct.unpack(f"<{len(parameters)}d", data))
        yield number, _lens(name, width, height, values, at)
    reader.finish()


def _binary_images(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Image]:
    reader = RecordReader(file, where)
    least = _POSE.size + 1 + COUNT.size
    count = reader.count(least, "images")
    limits.require_cameras(count, where)
    for _ in range(count):
        number, *pose, lens = _POSE.unpack(reader.take(_POSE.size, "an image"))
        name = reader.name(f"image {number}")
        points = reader.count(_POINT_BYTES, f"points of image {number}")
        reader.skip(points * _POINT_BYTES, f"{points} points of image {number}")
        yield _Image(number, tuple(pose[:4]), tuple(pose[4:]), lens, name)
    reader.finish()


def _records(
    file: BinaryIO, where: str, limits: Limits, *, has_points: bool
) -> Iterator[tuple[str, list[str]]]:
    """Give the fields of each record and where it stands; images have a line of points behind."""
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
            # Empty where there are no points, and megabytes where there are many.
            number += 1
            skip_line(file)


def _text_lenses(file: BinaryIO, where: str, limits: Limits) -> Iterator[tuple[int, _Lens]]:
    for at, fields in _records(file, where, limits, has_points=False):
        if len(fields) < 4:
            raise _malformed(at, fields, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
        name = fields[1]
        if name not in _PARAMETERS:
            raise _refuse_model(name[:40], at)
        if len(fields) != 4 + len(_PARAMETERS[name]):
            raise _malformed(at, fields, f"the {len(_PARAMETERS[name])} parameters of {name}")
        try:
            number, width, height = int(fields[0]), int(fields[2]), int(fields[3])
            values = [float(field) for field in fields[4:]]
        except ValueError as error:
            raise _malformed(at, fields, "numbers") from error
        yield number, _lens(name, width, height, values, at)


def _text_images(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Image]:
    for at, fields in _records(file, where, limits, has_points=True):
        if len(fields) != 10:
            raise _malformed(at, fields, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        if len(fields[9]) >= MAX_NAME_BYTES:
            raise _malformed(at, fields, f"a name of fewer than {MAX_NAME_BYTES} characters")
        try:
            number, lens = int(fields[0]), int(fields[8])
            pose = [float(field) for field in fields[1:8]]
        except ValueError as error:
            raise _malformed(at, fields, "numbers") from error
        yield _Image(number, tuple(pose[:4]), tuple(pose[4:]), lens, fields[9])


def _malformed(where: str, fields: list[str], expected: str) -> FormatError:
    return FormatError(
        "colmap-malformed", f"{where}: {' '.join(fields)[:80]!r}, expected {expected}"
    )
