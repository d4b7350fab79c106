"""Reader of the points of a COLMAP sparse model, binary or text.

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

from cogsplat.codec.errors import DataError, FormatError
from cogsplat.formats.storage.atomic import is_file, is_folder, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .colmap import find_model
from .colmap_records import MAX_LINE_BYTES, RecordReader, skip_line

_POINT = struct.Struct("<Q3d3BdQ")  # id, x y z, red green blue, error, length of the track
_TRACK_ENTRY_BYTES = 8  # image id and the point's index in the image
_FIELDS = 8  # fields of a text line before its track

_Point = tuple[float, float, float, int, int, int]


@dataclass(frozen=True, eq=False)
class Points:
    """The P points of a sparse model.

    Parameters
    ----------
    positions : (P, 3) float64
        Positions in scene units and in the world frame of the model's cameras; finite.
    colours : (P, 3) uint8
        RGB colours, display-referred.
    """

    positions: NDArray[np.float64]
    colours: NDArray[np.uint8]


def find_points(folder: Path) -> Path | None:
    """Return the path of the points of a folder's sparse model; None if there is none."""
    model = find_model(folder) if is_folder(folder) else None
    if model is None:
        return None
    # Binary first, like COLMAP itself.
    found = (model / f"points3D{suffix}" for suffix in (".bin", ".txt"))
    return next((path for path in found if is_file(path)), None)


def read_points(path: Path, *, limits: Limits | None = None) -> Points:
    """Read the points of a sparse model.

    Parameters
    ----------
    path : Path
        ``points3D.bin`` or ``points3D.txt``.
    limits : Limits, optional
        Limits; `Limits.splats` limits the number of points.

    Returns
    -------
    Points
        Points in file order, at least one.

    Raises
    ------
    FormatError
        ``colmap-malformed``, ``colmap-trailing-bytes``.
    TruncatedError
        ``colmap-truncated``: the file has fewer points than it declares.
    DataError
        ``bad-point``: a position is not finite; ``no-points``.
    LimitError
        ``too-many-splats``.
    StorageError
        See `open_for_read`.
    """
    limits = limits or Limits()
    read = _binary_points if path.suffix == ".bin" else _text_points
    with storage_errors(path), open_for_read(path) as file:
        found = list(read(file, str(path), limits))
    if not found:
        raise DataError("no-points", f"{path}: holds no points, expected at least one")
    table = np.array(found, np.float64)
    finite = np.isfinite(table[:, :3]).all(axis=1)
    if not finite.all():
        row = int(finite.argmin())
        raise DataError(
            "bad-point",
            f"{path}: record {row} lies at {table[row, :3].tolist()}, expected finite numbers",
        )
    return Points(np.ascontiguousarray(table[:, :3]), table[:, 3:].astype(np.uint8))


def _binary_points(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Point]:
    """Yield the points of a ``points3D.bin``."""
    reader = RecordReader(file, where)
    count = reader.read_count(_POINT.size, "points")
    limits.require_splats(count, where)
    for _ in range(count):
        record = reader.read(_POINT.size, "a point")
        _, x, y, z, red, green, blue, _, track_length = _POINT.unpack(record)
        reader.skip(track_length * _TRACK_ENTRY_BYTES, f"the track of {track_length} images")
        yield x, y, z, red, green, blue
    reader.require_end()


def _text_points(file: BinaryIO, where: str, limits: Limits) -> Iterator[_Point]:
    """Yield the points of a ``points3D.txt``."""
    number = records = 0
    while line := file.readline(MAX_LINE_BYTES):
        number += 1
        if not line.endswith(b"\n"):
            # The line has a long track, which is not needed.
            skip_line(file)
        text = line.decode("utf-8", "replace").strip()
        if not text or text.startswith("#"):
            continue
        records += 1
        limits.require_splats(records, where)
        fields = text.split(maxsplit=_FIELDS)
        at = f"{where}: line {number}"
        try:
            x, y, z = (float(field) for field in fields[1:4])
            red, green, blue = (int(field) for field in fields[4:7])
        except ValueError as error:
            raise _malformed(at, fields) from error
        if len(fields) < _FIELDS or not all(0 <= value <= 255 for value in (red, green, blue)):
            raise _malformed(at, fields)
        yield x, y, z, red, green, blue


def _malformed(where: str, fields: list[str]) -> FormatError:
    """Return the error about a malformed line."""
    return FormatError(
        "colmap-malformed",
        f"{where}: {' '.join(fields)[:80]!r}, expected POINT3D_ID X Y Z R G B ERROR TRACK[], "
        "colours of 0 to 255",
    )
