"""Reader and writer of 3DGS scenes in PLY; plyfile reads the non-canonical layouts."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from io import BufferedReader

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.capture import moved_capture
from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.splats import Extra, SceneInfo, Splats
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.scenes.dropped_values import warn_dropped
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .comments import parse_scene_info, scene_comments
from .extra_properties import (
    NORMALS,
    extra_columns,
    extra_properties,
    split_origin,
    without_zero_normals,
)
from .foreign_layouts import read_columns
from .header import PlyHeader, check_size, match_fields, read_header, splat_fields

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Bytes of a block of rows, which is split into columns while it is in the processor's cache.
_BLOCK_BYTES = 1 << 18

_LITTLE_FLOAT = np.dtype("<f4")

# SH degree by the number of f_rest properties.
_DEGREES = {0: 0, 9: 1, 24: 2, 45: 3}

# PLY name of each numpy type, from the PLY description, which every reader knows.
_TYPE_NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}


@dataclass(frozen=True)
class PlySize:
    """Size of a PLY scene, according to its header.

    Parameters
    ----------
    splats : int
        Number of splats.
    sh_degree : int
        SH degree, 0 to 3.
    extra_bytes : int
        Bytes of one splat's extra attributes, including normals.
    """

    splats: int
    sh_degree: int
    extra_bytes: int


def ply_size(path: StrPath) -> PlySize:
    """Return the size of a PLY scene from its header, without reading its rows.

    Raises
    ------
    CogsplatError
        The header cannot be read; see `read_ply`.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        vertex = read_header(file, where).vertex(where)
    fields = match_fields(vertex, where)
    extra_bytes = sum(int(prop.dtype[1:]) for prop in extra_properties(vertex, fields, where))
    return PlySize(vertex.count, _DEGREES[len(fields["shN"])], extra_bytes)


def read_ply(
    path: StrPath, *, limits: Limits | None = None, zeros: Zeros = IN_MEMORY.zeros
) -> Splats:
    """Read a 3DGS scene from a PLY file.

    Parameters
    ----------
    path : path
        A PLY whose element ``vertex`` has the properties of 3DGS training: x y z, f_dc_0 to 2,
        0, 9, 24 or 45 f_rest, opacity, scale_0 to 2 and rot_0 to 3. Canonical files
        (little-endian, ``vertex`` first, no lists) need numpy only; others need plyfile.
    limits : Limits, optional
        Limits on splats and decoded bytes.
    zeros : callable
        Allocator of the arrays, e.g. `Workspace.zeros`; rows are read into them block by block.

    Returns
    -------
    Splats
        Stored values: log scales, logit opacities, quaternions of any norm. Rows with NaN are
        kept; `Splats.require_valid` rejects them. `Splats.info` comes from our own comments.
        Every other scalar property becomes an extra of its type, except normals that are all
        zero. If x y z are doubles in map coordinates, their centre is added to ``info.origin``,
        with a warning.

    Raises
    ------
    FormatError
        ``ply-`` followed by ``magic``, ``header-too-long``, ``bad-header``, ``bad-count``,
        ``duplicate-property``, ``duplicate-element``, ``empty-element``, ``no-vertex``,
        ``list-property``, ``bad-sh``, ``missing-property``, ``bad-comment``, ``trailing-bytes``,
        ``malformed``.
    TruncatedError
        ``ply-no-end-header``, ``ply-truncated``.
    UnsupportedError
        ``needs-plyfile``, ``ply-too-many-lists``.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`; ``file-changed``: another process changed the file.

    Notes
    -----
    Counts are checked against the file's size before any allocation. The file is not mapped into
    memory, because a mapped file that another process truncates causes a bus fault.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        before = os.fstat(file.fileno())
        header = read_header(file, where)
        vertex = header.vertex(where)
        fields = match_fields(vertex, where)
        info = parse_scene_info(header.comments, where)
        check_size(header, before.st_size, where)
        extra = extra_properties(vertex, fields, where)
        (limits or Limits()).require_scene(
            vertex.count,
            sh_degree=_DEGREES[len(fields["shN"])],
            source_bytes=before.st_size,
            where=where,
            extra_bytes=vertex.count * sum(int(prop.dtype[1:]) for prop in extra),
        )
        arrays: dict[str, F32 | F64] = {
            name: zeros((vertex.count, len(p)), np.float32) for name, p in fields.items()
        }
        if any(p.dtype == "f8" for p in vertex.properties if p.name in fields["means"]):
            arrays["means"] = np.empty((vertex.count, 3), np.float64)
        extras: dict[str, Extra] = {prop.name: zeros((vertex.count,), prop.dtype) for prop in extra}
        if header.is_canonical:
            _read_rows(file, header, fields, arrays, extras, where)
        else:
            read_columns(file, header, fields, arrays, extras, where)
        after = os.fstat(file.fileno())
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise StorageError(
            "file-changed",
            f"{where}: went from {before.st_size} to {after.st_size} bytes or was rewritten while "
            "being read, expected a file at rest",
        )
    if arrays["means"].dtype == np.float64:
        arrays["means"], offset = split_origin(arrays["means"].astype(np.float64), where)
        x, y, z = (a + b for a, b in zip(info.origin, offset, strict=True))
        capture = moved_capture(info.capture, np.eye(3), -np.array(offset))
        info = replace(info, origin=(x, y, z), capture=capture)
    with np.errstate(over="ignore"):
        narrow = {name: values.astype(np.float32, copy=False) for name, values in arrays.items()}
    return Splats(
        means=narrow["means"],
        scales=narrow["scales"],
        quats=narrow["quats"],
        opacities=narrow["opacities"].reshape(-1),
        sh0=narrow["sh0"],
        shN=narrow["shN"].reshape(vertex.count, len(fields["shN"]) // 3, 3),
        info=info,
        extras=without_zero_normals(extras),
    )


def _read_rows(
    file: BufferedReader,
    header: PlyHeader,
    fields: dict[str, list[str]],
    arrays: Mapping[str, F32 | F64],
    extras: Mapping[str, Extra],
    where: str,
) -> None:
    """Fill (N, properties) arrays and (N,) extras from the rows of a canonical file."""
    vertex = header.elements[0]
    names = [prop.name for prop in vertex.properties]
    columns = _columns(names, fields)
    row = np.dtype([(prop.name, f"<{prop.dtype}") for prop in vertex.properties])
    rows = max(1, _BLOCK_BYTES // row.itemsize)
    buffer = np.empty(min(rows, vertex.count), row)
    file.seek(header.data_offset)
    for start in range(0, vertex.count, rows):
        block = buffer[: min(rows, vertex.count - start)]
        got = file.readinto(block.view(np.uint8).data)
        if got != block.nbytes:
            raise TruncatedError(
                "ply-truncated",
                f"{where}: ended {block.nbytes - got} bytes early at row {start} of "
                f"{vertex.count}, expected the size that it had when it was opened",
            )
        stop = start + len(block)
        # Rows of float32 only are a matrix, whose columns are gathered in one call.
        if all(prop.dtype == "f4" for prop in vertex.properties):
            flat = block.view(_LITTLE_FLOAT).reshape(len(block), len(names))
            for field, group in columns.items():
                arrays[field][start:stop] = flat.take(group, axis=1, mode="clip")
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                for field, properties in fields.items():
                    for column, name in enumerate(properties):
                        arrays[field][start:stop, column] = block[name]
        for name, values in extras.items():
            values[start:stop] = block[name]


def _columns(names: list[str], fields: dict[str, list[str]]) -> dict[str, NDArray[np.intp]]:
    """Return the column indices of each field's properties in a row; skip empty fields."""
    return {
        field: np.array([names.index(name) for name in group], np.intp)
        for field, group in fields.items()
        if group
    }


def write_ply(
    splats: Splats, path: StrPath, *, force: bool = False, absolute: bool = False
) -> None:
    """Write a scene as a PLY in the layout of 3DGS training, atomically.

    Parameters
    ----------
    splats : Splats
        Scene, stored unchanged. Extras become properties of their types; an extra with several
        components becomes ``name_0``, ``name_1``, … Normals are zeros unless they are extras.
        Values of `splats.info` other than the defaults become comments, which `read_ply` parses.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.
    absolute : bool
        Whether centres are doubles in world coordinates, ``origin + means``, without an origin
        comment, for programs that read georeferenced scenes. `read_ply` restores the origin.

    Raises
    ------
    DataError
        ``bad-scene-info``: `splats.info` has an invalid value.
    StorageError
        See `atomic_write`, e.g. ``exists``.

    Warns
    -----
    CogsplatWarning
        An extra's name is no valid property name.
    """
    write_ply_parts([splats], len(splats), path, force=force, absolute=absolute)


def write_ply_parts(
    parts: Iterable[Splats],
    count: int,
    path: StrPath,
    *,
    force: bool = False,
    absolute: bool = False,
) -> Splats:
    """Write a scene in consecutive parts like `write_ply`, with one part in memory at a time.

    Parameters
    ----------
    parts : iterable of Splats
        Parts of the scene, at least one, of equal SH degree and extras. The first part's `info`
        is stored.
    count : int
        Splats in all parts together.
    path, force, absolute
        See `write_ply`.

    Returns
    -------
    Splats
        Scene without splats, with the SH degree, `info` and extras of the parts.

    Raises
    ------
    DataError, StorageError
        See `write_ply`.
    ValueError
        There are no parts, or their splats do not add up to `count`.
    """
    remaining = iter(parts)
    splats = next(remaining, None)
    if splats is None:
        raise ValueError("no parts, expected at least one")
    template = splats.take(slice(0, 0))
    rest = splats.shN.shape[1]
    fields = splat_fields(3 * rest)
    standard = {name for group in fields.values() for name in group}
    extras, dropped = extra_columns(splats.extras, standard)
    dtypes = dict.fromkeys(["x", "y", "z", *NORMALS], "f4")
    if absolute:
        dtypes |= dict.fromkeys(fields["means"], "f8")
    info, origin = splats.info, np.array(splats.info.origin)
    if absolute:
        # In float64: of positions on the globe, float32 keeps half a metre.
        x, y, z = info.origin
        placed = tuple((a + x, b + y, c + z, focal) for a, b, c, focal in info.capture)
        info = replace(info, origin=SceneInfo().origin, capture=placed)
    dtypes |= {f"f_dc_{c}": "f4" for c in range(3)}
    dtypes |= {f"f_rest_{k}": "f4" for k in range(3 * rest)}
    dtypes |= {"opacity": "f4"} | {f"scale_{k}": "f4" for k in range(3)}
    dtypes |= {f"rot_{k}": "f4" for k in range(4)}
    # Normals among the extras keep their column and get the extra's type.
    dtypes |= {name: values.dtype.str[1:] for name, values in extras.items()}
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            *(f"comment {comment}" for comment in scene_comments(info)),
            f"element vertex {count}",
            *(f"property {_TYPE_NAMES[dtype]} {name}" for name, dtype in dtypes.items()),
            "end_header\n",
        ]
    )
    row = np.dtype([(name, f"<{dtype}") for name, dtype in dtypes.items()])
    columns = _columns(list(dtypes), fields)
    rows = max(1, _BLOCK_BYTES // row.itemsize)
    buffer = np.zeros(min(rows, count), row)
    uniform = set(dtypes.values()) == {"f4"}
    written = 0
    with atomic_write(path, force) as file:
        file.write(header.encode("ascii"))
        while splats is not None:
            for start in range(0, len(splats), rows):
                block = buffer[: min(rows, len(splats) - start)]
                stop = start + len(block)
                for field, group in columns.items():
                    values = getattr(splats, field)[start:stop].reshape(len(block), -1)
                    if absolute and field == "means":
                        values = values.astype(np.float64) + origin
                    if uniform:
                        flat = block.view(_LITTLE_FLOAT).reshape(len(block), len(dtypes))
                        flat[:, group] = values
                    else:
                        for column, name in enumerate(fields[field]):
                            block[name] = values[:, column]
                for name, extra in extras.items():
                    block[name] = extra[start:stop]
                file.write(block.view(np.uint8).data)
            written += len(splats)
            splats = next(remaining, None)
            if splats is not None:
                extras, _ = extra_columns(splats.extras, standard)
        if written != count:
            raise ValueError(f"{written} rows in all parts, expected {count}")
    warn_dropped(path, "ply", dropped)
    return template
