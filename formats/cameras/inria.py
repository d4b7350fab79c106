"""Reader and writer of ``cameras.json``, the camera format of the 3DGS reference training."""

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

# Relative tolerance between a stored translation and -rotationᵀ·position: files round rotations,
# and `Camera` accepts rotations that deviate by 1e-3 from orthonormal ones.
_TRANSLATION_TOLERANCE = 1e-2


def read_cameras_json(path: StrPath, *, limits: Limits | None = None) -> list[Camera]:
    """Read cameras from an INRIA ``cameras.json``.

    Parameters
    ----------
    path : path
        A JSON array with one object per camera. Its keys are ``width``, ``height``, ``fx``, ``fy``
        (px), ``position`` (3 numbers; the camera's centre, scene units) and ``rotation`` (3 rows
        of 3 numbers; camera to world, so that columns are the camera's axes). Optional keys are
        ``img_name``, ``cx``, ``cy`` (px; by default the image's centre) and ``translation`` (3
        numbers; world to camera, exact).
    limits : Limits, optional
        Limits; `Limits.cameras` limits the number of cameras.

    Returns
    -------
    list of Camera
        Cameras in file order, at least one.

    Raises
    ------
    FormatError
        ``bad-cameras-json``; the message names the entry and the key.
    DataError
        ``bad-camera``: `Camera` rejects the values; ``no-cameras``: the array is empty.
    LimitError
        ``too-many-cameras``; ``json-too-long``: an entry is longer than `MAX_VALUE_BYTES`.
    StorageError
        See `open_for_read`.
    """
    where = os.fspath(path)
    limits = limits or Limits()
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    # A first pass counts the entries, to check the limit before any camera is built.
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
    # Very large values overflow here; `Camera` rejects the result.
    with np.errstate(over="ignore", invalid="ignore"):
        cameras = [_camera(stream.value(), f"{where}: entry {index}") for index in stream.items()]
    if not cameras:
        raise DataError("no-cameras", f"{where}: the array is empty, expected cameras")
    return cameras


def _camera(entry: object, where: str) -> Camera:
    """Return the camera of an entry."""
    if not isinstance(entry, dict):
        raise _bad(where, entry, "an object")
    width, height = _size(entry, "width", where), _size(entry, "height", where)
    rotation = _array(entry, "rotation", (3, 3), where).T
    position = _array(entry, "position", (3,), where)
    translation = -rotation @ position
    if "translation" in entry:
        stored = _array(entry, "translation", (3,), where)
        if np.abs(stored - translation).max() > _TRANSLATION_TOLERANCE * np.abs(position).sum():
            raise _bad(f"{where}, key 'translation'", entry["translation"], "-rotationᵀ·position")
        translation = stored
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
    """Return an entry's finite number."""
    if key not in entry:
        raise FormatError(_CODE, f"{where}: has no key '{key}', expected a number")
    return _float(entry[key], f"{where}, key '{key}'")


def _float(value: object, where: str) -> float:
    """Return a JSON value as a finite float."""
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
    """Return an entry's width or height, px."""
    value = _number(entry, key, where)
    # Some writers store sizes such as 1920.0.
    if not value.is_integer():
        raise _bad(f"{where}, key '{key}'", value, "a whole number")
    return int(value)


def _array(
    entry: dict[object, object], key: str, shape: tuple[int, ...], where: str
) -> NDArray[np.float64]:
    """Return an entry's nested arrays of numbers, after checking their shape."""
    where = f"{where}, key '{key}'"
    if key not in entry:
        raise FormatError(_CODE, f"{where}: is missing, expected numbers")
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
    """Return the error about an unexpected JSON value."""
    return FormatError(_CODE, f"{where}: is {_kind(value)}, expected {expected}")


def _kind(value: object) -> str:
    """Describe a JSON value for a message: an array by its length, a scalar by its JSON text."""
    if isinstance(value, list):
        return f"an array of {len(value)}"
    if isinstance(value, dict):
        return "an object"
    return json.dumps(value)[:40]


def write_cameras_json(cameras: Sequence[Camera], path: StrPath, force: bool = False) -> None:
    """Write cameras as an INRIA ``cameras.json``, without loss.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras to write. ``cx``, ``cy`` and ``translation`` are added to the keys of INRIA's
        training, because the position does not determine the translation to the last bit.
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
