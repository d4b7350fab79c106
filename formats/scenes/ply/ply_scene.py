"""3DGS scenes as PLY: little-endian by blocks of rows, other layouts through plyfile."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from io import BufferedReader

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.splats import Extra, SceneInfo, Splats
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.scenes.dropped_values import warn_of_losses
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .comments import parse_scene_info, scene_comments
from .extra_properties import NORMALS, as_origin, extra_columns, extra_properties, without_padding
from .foreign_layouts import read_columns
from .header import PlyHeader, check_size, match_fields, read_header, splat_fields

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Rows are gathered into columns while a block of this size is in the processor's cache.
_BLOCK_BYTES = 1 << 18

_LITTLE_FLOAT = np.dtype("<f4")

# By the number of f_rest properties, as `match_fields` lets pass.
_DEGREES = {0: 0, 9: 1, 24: 2, 45: 3}

# The names of the PLY description, which every reader knows.
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
class PlyRows:
    """How much a PLY holds, as its header says.

    Parameters
    ----------
    splats : int
    sh_degree : int
    extra_bytes : int
        Bytes of one splat's extra attributes, normals that may be padding among them.
    """

    splats: int
    sh_degree: int
    extra_bytes: int


def ply_rows(path: StrPath) -> PlyRows:
    """Return how much a PLY holds, without reading its rows.

    Raises
    ------
    CogsplatError
        As `read_ply` raises for the header.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        vertex = read_header(file, where).vertex(where)
    fields = match_fields(vertex, where)
    others = extra_properties(vertex, fields, where)
    extra_bytes = sum(int(prop.dtype[1:]) for prop in others)
    return PlyRows(vertex.count, _DEGREES[len(fields["shN"])], extra_bytes)


def read_ply(
    path: StrPath, *, limits: Limits | None = None, zeros: Zeros = IN_MEMORY.zeros
) -> Splats:
    """Read a 3DGS scene from a PLY file.

    Parameters
    ----------
    path : path
        Any PLY with the properties x y z, f_dc_0 to 2, f_rest_0 to (0, 9, 24 or 45) - 1, opacity,
        scale_0 to 2, rot_0 to 3 of its element ``vertex``. Canonical files (little-endian,
        ``vertex`` first) take numpy alone, others plyfile.
    limits : Limits, optional
        What the file may cost.
    zeros : callable
        Makes the arrays, as `Workspace.zeros` does; rows are read into them block by block.

    Returns
    -------
    Splats
        As stored: log scales, logit opacities, quaternions of any norm. Rows with NaN are kept;
        `Splats.require_valid` refuses them. `Splats.info` is what our own comments say. Every
        other scalar property is one of `Splats.extras`, in its type; normals that are all zero,
        which training writes as padding, are not. Where x y z are doubles far from zero, their
        centre becomes part of ``info.origin``, with a warning.

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
    LimitError
        ``decoded-size``, ``too-many-splats``.
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
        others = extra_properties(vertex, fields, where)
        (limits or Limits()).require_scene(
            vertex.count,
            sh_degree=_DEGREES[len(fields["shN"])],
            source_bytes=before.st_size,
            where=where,
            beside_bytes=vertex.count * sum(int(prop.dtype[1:]) for prop in others),
        )
        arrays: dict[str, F32 | F64] = {
            name: zeros((vertex.count, len(p)), np.float32) for name, p in fields.items()
        }
        if any(p.dtype == "f8" for p in vertex.properties if p.name in fields["means"]):
            arrays["means"] = np.empty((vertex.count, 3), np.float64)
        extras: dict[str, Extra] = {
            prop.name: zeros((vertex.count,), prop.dtype) for prop in others
        }
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
        arrays["means"], moved = as_origin(arrays["means"].astype(np.float64), where)
        x, y, z = (a + b for a, b in zip(info.origin, moved, strict=True))
        info = replace(info, origin=(x, y, z))
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
        extras=without_padding(extras),
    )


def _read_rows(
    file: BufferedReader,
    header: PlyHeader,
    fields: dict[str, list[str]],
    arrays: Mapping[str, F32 | F64],
    extras: Mapping[str, Extra],
    where: str,
) -> None:
    """Fill arrays of (N, properties), and extras of (N,), from the rows behind the header."""
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
                f"{vertex.count}, expected the bytes that were there when it was opened",
            )
        stop = start + len(block)
        # Rows of one type are a matrix, whose columns are gathered at once.
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
    """Return, for each field that has any, the positions of its properties in a file's row."""
    return {
        field: np.array([names.index(name) for name in group], np.intp)
        for field, group in fields.items()
        if group
    }


def write_ply(
    splats: Splats, path: StrPath, *, force: bool = False, absolute: bool = False
) -> None:
    """Write a scene as a canonical PLY, as 3DGS training writes it, whole or not at all.

    Parameters
    ----------
    splats : Splats
        Written as they are; extras become properties of their types, those of several components
        one for each, ``name_0`` and on. Without normals among them normals are zeros. What
        `splats.info` says beside the defaults goes into comments that `read_ply` reads back.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.
    absolute : bool
        Write centres as doubles in world coordinates, ``origin + means``, and no origin: what
        programs for georeferenced scenes read. `read_ply` takes the origin out again.

    Raises
    ------
    DataError
        ``bad-scene-info``: `splats.info` holds a value that is none.
    StorageError
        As `atomic_write`, ``exists`` among them.

    Warns
    -----
    CogsplatWarning
        An extra has a name that no property can have.
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
    """Write a scene that comes in parts, as `write_ply` writes it; one part is held at a time.

    Parameters
    ----------
    parts : iterable of Splats
        At least one, of one SH degree and with the same extras; `info` is the first one's.
    count : int
        Rows of all parts.
    path, force, absolute
        As in `write_ply`.

    Returns
    -------
    Splats
        No rows: SH degree, `info` and extras of what was written.

    Raises
    ------
    DataError, StorageError
        As `write_ply`.
    ValueError
        No parts, or another number of rows than `count`.
    """
    coming = iter(parts)
    splats = next(coming, None)
    if splats is None:
        raise ValueError("no parts, expected at least one")
    like = splats.take(slice(0, 0))
    rest = splats.shN.shape[1]
    fields = splat_fields(3 * rest)
    drawn = {name for group in fields.values() for name in group}
    extras, losses = extra_columns(splats.extras, drawn)
    dtypes = dict.fromkeys(["x", "y", "z", *NORMALS], "f4")
    if absolute:
        dtypes |= dict.fromkeys(fields["means"], "f8")
    info = replace(splats.info, origin=SceneInfo().origin) if absolute else splats.info
    origin = np.array(splats.info.origin)
    dtypes |= {f"f_dc_{c}": "f4" for c in range(3)}
    dtypes |= {f"f_rest_{k}": "f4" for k in range(3 * rest)}
    dtypes |= {"opacity": "f4"} | {f"scale_{k}": "f4" for k in range(3)}
    dtypes |= {f"rot_{k}": "f4" for k in range(4)}
    # A name that has a place already keeps it: that of normals.
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
            splats = next(coming, None)
            if splats is not None:
                extras, _ = extra_columns(splats.extras, drawn)
        if written != count:
            raise ValueError(f"{written} rows in all parts, expected {count}")
    warn_of_losses(path, "ply", losses)
    return like
