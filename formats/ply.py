"""3DGS scenes as PLY: little-endian float32 by blocks of rows, other layouts through plyfile."""

from __future__ import annotations

import os
from io import BufferedReader

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.splats import Splats

from .atomic import StrPath, atomic_write, open_for_read, storage_errors
from .ply_any import read_columns
from .ply_comments import parse_scene_info, scene_comments
from .ply_header import (
    PlyHeader,
    check_size,
    match_fields,
    read_header,
    splat_fields,
)

F32 = NDArray[np.float32]

# Rows are gathered into columns while a block of this size is in the processor's cache.
_BLOCK_BYTES = 1 << 18

_LITTLE_FLOAT = np.dtype("<f4")


def read_ply(path: StrPath) -> Splats:
    """Read a 3DGS scene from a PLY file.

    Parameters
    ----------
    path : path
        Any PLY with the properties x y z, f_dc_0 to 2, f_rest_0 to (0, 9, 24 or 45) - 1, opacity,
        scale_0 to 2, rot_0 to 3 of its element ``vertex``; others are skipped. Canonical files
        (little-endian, ``vertex`` first and all of float32) take numpy alone, others plyfile.

    Returns
    -------
    Splats
        As stored: log scales, logit opacities, quaternions of any norm. Rows with NaN are kept;
        `Splats.require_valid` refuses them. `Splats.info` is what our own comments say.

    Raises
    ------
    FormatError
        ``ply-`` and ``magic``, ``header-too-long``, ``bad-header``, ``bad-count``,
        ``duplicate-property``, ``duplicate-element``, ``empty-element``, ``no-vertex``,
        ``list-property``, ``bad-sh``, ``missing-property``, ``bad-comment``, ``trailing-bytes``,
        ``malformed``.
    TruncatedError
        ``ply-no-end-header``, ``ply-truncated``.
    UnsupportedError
        ``needs-plyfile``, ``ply-too-many-lists``.
    StorageError
        As `open_for_read`; ``file-changed``: it was written to meanwhile.

    Notes
    -----
    Nothing is allocated before the counts fit the file's size. The file is read, not mapped: one
    cut short by another process is an error, not a bus fault.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        before = os.fstat(file.fileno())
        header = read_header(file, where)
        vertex = header.vertex(where)
        fields = match_fields(vertex, where)
        info = parse_scene_info(header.comments, where)
        check_size(header, before.st_size, where)
        arrays = {name: np.empty((vertex.count, len(p)), np.float32) for name, p in fields.items()}
        if header.is_canonical:
            _read_rows(file, header, fields, arrays, where)
        else:
            read_columns(file, header, fields, arrays, where)
        after = os.fstat(file.fileno())
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise StorageError(
            "file-changed",
            f"{where}: went from {before.st_size} to {after.st_size} bytes or was rewritten while "
            "being read, expected a file at rest",
        )
    return Splats(
        means=arrays["means"],
        scales=arrays["scales"],
        quats=arrays["quats"],
        opacities=arrays["opacities"].reshape(-1),
        sh0=arrays["sh0"],
        shN=arrays["shN"].reshape(vertex.count, len(fields["shN"]) // 3, 3),
        info=info,
    )


def _read_rows(
    file: BufferedReader,
    header: PlyHeader,
    fields: dict[str, list[str]],
    arrays: dict[str, F32],
    where: str,
) -> None:
    """Fill arrays of (N, properties) from the rows behind the header."""
    vertex = header.elements[0]
    names = [prop.name for prop in vertex.properties]
    columns = _columns(names, fields)
    rows = max(1, _BLOCK_BYTES // vertex.min_stride)
    buffer = np.empty((min(rows, vertex.count), len(names)), _LITTLE_FLOAT)
    file.seek(header.data_offset)
    for start in range(0, vertex.count, rows):
        block = buffer[: min(rows, vertex.count - start)]
        got = file.readinto(block.data)
        if got != block.nbytes:
            raise TruncatedError(
                "ply-truncated",
                f"{where}: ended {block.nbytes - got} bytes early at row {start} of "
                f"{vertex.count}, expected the bytes that were there when it was opened",
            )
        for field, group in columns.items():
            arrays[field][start : start + len(block)] = block.take(group, axis=1, mode="clip")


def _columns(names: list[str], fields: dict[str, list[str]]) -> dict[str, NDArray[np.intp]]:
    """Return, for each field that has any, the positions of its properties in a file's row."""
    return {
        field: np.array([names.index(name) for name in group], np.intp)
        for field, group in fields.items()
        if group
    }


def write_ply(path: StrPath, splats: Splats, *, force: bool = False) -> None:
    """Write a scene as a canonical PLY, as 3DGS training writes it, whole or not at all.

    Parameters
    ----------
    path : path
        The output.
    splats : Splats
        Written as they are; normals are zeros. What `splats.info` says beside the defaults goes
        into comments that `read_ply` reads back.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    DataError
        ``bad-scene-info``: `splats.info` holds a value that is none.
    StorageError
        As `atomic_write`, ``exists`` among them.
    """
    rest = splats.shN.shape[1]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    names += [f"f_dc_{c}" for c in range(3)] + [f"f_rest_{k}" for k in range(3 * rest)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            *(f"comment {comment}" for comment in scene_comments(splats.info)),
            f"element vertex {len(splats)}",
            *(f"property float {name}" for name in names),
            "end_header\n",
        ]
    )
    columns = _columns(names, splat_fields(3 * rest))
    rows = max(1, _BLOCK_BYTES // (4 * len(names)))
    block = np.zeros((min(rows, len(splats)), len(names)), _LITTLE_FLOAT)
    with atomic_write(path, force) as file:
        file.write(header.encode("ascii"))
        for start in range(0, len(splats), rows):
            count = min(rows, len(splats) - start)
            for field, group in columns.items():
                values = getattr(splats, field)[start : start + count]
                block[:count, group] = values.reshape(count, -1)
            file.write(block[:count].data)
