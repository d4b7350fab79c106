"""``cameras.json`` of the 3DGS reference training, read and written."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError, FormatError
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.json_stream import JsonStream
from cogsplat.formats.storage.limits import Limits

_CODE = "bad-cameras-json"

# How far a given translation may be from the one that position and rotation make, relative to
# the position: files round rotations, and `Camera` lets them be off orthonormal by 1e-3.
_TRANSLATION_TOLERANCE = 1e-2


def read_cameras_json(path: StrPath, *, limits: Limits | None = None) -> list[Camera]:
    """Read cameras from an INRIA ``cameras.json``.

    Parameters
    ----------
    path : path
        A JSON array of objects with ``width``, ``height``, ``fx``, ``fy`` (px), ``position`` (3;
        the centre, scene units) and ``rotation`` (3 rows of 3; camera to world, so its columns are
        the camera's axes), and maybe ``img_name``. Ours have ``cx``, ``cy`` (px; otherwise the
        image's centre) and ``translation`` (3; world to camera, the exact one) as well.
    limits : Limits, optional
        `Limits.cameras` counts.

    Returns
    -------
    list of Camera
        In file order, at least one.

    Raises
    ------
    FormatError
        ``bad-cameras-json``, with entry and key.
    DataError
        ``bad-camera``: as `Camera`; ``no-cameras``: the array is empty.
    LimitError
        ``too-many-cameras``: more than `limits` allow; ``json-too-long``: an entry is longer than
        `MAX_VALUE_BYTES`.
    StorageError
        See `open_for_read`.
    """
    where = os.fspath(path)
    limits = limits or Limits()
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    # Counted first, so that too many are refused before the first camera is made.
    stream = JsonStream(data, where, _CODE)
    if stream.peek() != b"[":
        raise FormatError(
            _CODE, f"{where}: is {_kind(stream.value())}, expected an array of cameras"
        )
    for index in stream.items():
        limits.require_cameras(index + 1, where)
        stream.value()
    stream.finish()
    stream = JsonStream(data, where, _CODE)
    # Absurd magnitudes overflow on the way to `Camera`, which refuses what comes of them.
    with np.errstate(over="ignore", invalid="ignore"):
        cameras = [_camera(stream.value(), f"{where}: entry {index}") for index in stream.items()]
    if not cameras:
        raise DataError("no-cameras", f"{where}: the array is empty, expected cameras")
    return cameras


def _camera(entry: object, where: str) -> Camera:
    if not isinstance(entry, dict):
        raise _bad(where, entry, "an object")
    width, height = _size(entry, "width", where), _size(entry, "height", where)
    rotation = _array(entry, "rotation", (3, 3), where).T
    position = _array(entry, "position", (3,), where)
    translation = -rotation @ position
    if "translation" in entry:
        given = _array(entry, "translation", (3,), where)
        if np.abs(given - translation).max() > _TRANSLATION_TOLERANCE * np.abs(position).sum():
            raise _bad(f"{where}, key 'translation'", entry["translation"], "-rotationᵀ·position")
        translation = given
    name = entry.get("img_name", "")
    if not isinstance(name, str):
        raise _bad(f"{where}, key 'img_name'", name, "a string")
    try:
        return Camera(
            width=width,
            height=height,
            fx=_number(entry, "fx", where),
            fy=_number(entry, "fy", where),
            cx=_number(entry, "cx", where) if "cx" in entry else width / 2,
            cy=_number(entry, "cy", where) if "cy" in entry else height / 2,
            rotation=rotation,
            translation=translation,
            name=name,
        )
    except DataError as error:
        raise DataError(error.code, f"{where}: {error.message}") from error


def _number(entry: dict[object, object], key: str, where: str) -> float:
    if key not in entry:
        raise FormatError(_CODE, f"{where}: has no key '{key}', expected a number")
    return _float(entry[key], f"{where}, key '{key}'")


def _float(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _bad(where, value, "a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _bad(where, value, "a number that fits a double")
    return number


def _size(entry: dict[object, object], key: str, where: str) -> int:
    value = _number(entry, key, where)
    # Some writers give sizes as 1920.0.
    if not value.is_integer():
        raise _bad(f"{where}, key '{key}'", value, "a whole number")
    return int(value)


def _array(
    entry: dict[object, object], key: str, shape: tuple[int, ...], where: str
) -> NDArray[np.float64]:
    where = f"{where}, key '{key}'"
    if key not in entry:
        raise FormatError(_CODE, f"{where}: is not there, expected numbers")
    numbers: list[float] = []

    def collect(value: object, sizes: tuple[int, ...]) -> None:
        if not sizes:
            numbers.append(_float(value, where))
            return
        if not isinstance(value, list) or len(value) != sizes[0]:
            raise _bad(where, value, " by ".join(map(str, shape)) + " numbers")
        for item in value:
            collect(item, sizes[1:])

    collect(entry[key], shape)
    return np.array(numbers, np.float64).reshape(shape)


def _bad(where: str, value: object, expected: str) -> FormatError:
    return FormatError(_CODE, f"{where}: is {_kind(value)}, expected {expected}")


def _kind(value: object) -> str:
    if isinstance(value, list):
        return f"an array of {len(value)}"
    if isinstance(value, dict):
        return "an object"
    return json.dumps(value)[:40]


def write_cameras_json(cameras: Sequence[Camera], path: StrPath, force: bool = False) -> None:
    """Write cameras as an INRIA ``cameras.json`` that `read_cameras_json` gives back exactly.

    Parameters
    ----------
    cameras : sequence of Camera
        ``cx``, ``cy`` and ``translation`` are written beside what INRIA's training writes: its
        position alone does not give the translation back to the last bit.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    StorageError
        See `atomic_write`, e.g. ``exists``.
    """
    entries = [
        {
            "id": index,
            "img_name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.rotation.T.tolist(),
            "fy": float(camera.fy),
            "fx": float(camera.fx),
            "cx": float(camera.cx),
            "cy": float(camera.cy),
            "translation": camera.translation.tolist(),
        }
        for index, camera in enumerate(cameras)
    ]
    with atomic_write(path, force) as file:
        file.write(json.dumps(entries, indent=1, allow_nan=False).encode() + b"\n")
