"""PLY layouts that are not canonical, through plyfile: text, big-endian, vertices not first.

plyfile is licensed under the GPL and belongs to the extra ``encode``, so it is imported only when
such a file is met.
"""

from __future__ import annotations

import importlib
import io
import os
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import (
    FormatError,
    MissingExtraError,
    TruncatedError,
    UnsupportedError,
)
from cogsplat.codec.splats import Extra

from .header import PlyHeader

# plyfile makes one array of each list: about 250 bytes and 5 µs for what may be one byte of the
# file. Splats come without lists; a mesh beside them may have some.
_MAX_LISTS = 1 << 17

# plyfile splits a line of text at once; 45 + 17 numbers take some 1600 bytes.
_MAX_LINE_BYTES = 1 << 20

_BLOCK_ROWS = 16384


def read_columns(
    file: BinaryIO,
    header: PlyHeader,
    fields: dict[str, list[str]],
    arrays: Mapping[str, NDArray[np.float32] | NDArray[np.float64]],
    extras: Mapping[str, Extra],
    where: str,
) -> None:
    """Fill arrays from a PLY of any layout.

    Parameters
    ----------
    file : BinaryIO
        The file, at any position; it is left open.
    header : PlyHeader
        Its header; `check_size` has passed.
    fields : dict
        For each array, the vertex properties of its columns.
    arrays : dict
        For each field an (N, properties) array to fill; values wider than its type are rounded,
        or ±inf where float32 ends.
    extras : mapping
        For each other property that is wanted an (N,) array of its type.
    where : str
        Name of the file for messages.

    Raises
    ------
    FormatError
        ``ply-malformed``: what plyfile refuses, or a line of text beyond 1 MiB;
        ``ply-trailing-bytes``: more lines of text than the header counts.
    TruncatedError
        ``ply-truncated``: fewer.
    UnsupportedError
        ``needs-plyfile``: it is not installed; ``ply-too-many-lists``.
    """
    _check_lists(header, where)
    if header.format == "ascii":
        _check_lines(file, header, where)
    try:
        plyfile = importlib.import_module("plyfile")
    except ImportError as error:
        raise MissingExtraError(
            "needs-plyfile",
            f"{where}: {_layout(header)}; without plyfile (pip install 'cogsplat[encode]') only "
            "binary_little_endian files whose first element is vertex, all of floats, are read",
        ) from error
    # A copy, because a text stream closes the file below it.
    with os.fdopen(os.dup(file.fileno()), "rb") as copy:
        copy.seek(0)
        text = header.format == "ascii"
        # plyfile refuses comments beyond ASCII, which its own text stream would give it.
        stream = io.TextIOWrapper(copy, "ascii", "backslashreplace") if text else copy
        try:
            vertices = plyfile.PlyData.read(stream)["vertex"].data
        except OSError:
            raise
        # Whatever a foreign parser trips over here, it is the file's fault.
        except Exception as error:
            raise FormatError(
                "ply-malformed",
                f"{where}: {_layout(header)}: {str(error)[:200] or type(error).__name__}, "
                "expected a well-formed PLY",
            ) from error
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(vertices), _BLOCK_ROWS):
            block = vertices[start : start + _BLOCK_ROWS]
            for field, group in fields.items():
                for column, name in enumerate(group):
                    arrays[field][start : start + len(block), column] = block[name]
            for name, values in extras.items():
                values[start : start + len(block)] = block[name]


def _layout(header: PlyHeader) -> str:
    elements = ", ".join(element.name for element in header.elements)
    return f"{header.format} with the elements {elements}"


def _check_lists(header: PlyHeader, where: str) -> None:
    lists = sum(
        element.count * sum(1 for prop in element.properties if prop.length_dtype)
        for element in header.elements
    )
    if lists > _MAX_LISTS:
        raise UnsupportedError(
            "ply-too-many-lists",
            f"{where}: {lists} lists beside the vertices, expected at most {_MAX_LISTS}",
        )


def _check_lines(file: BinaryIO, header: PlyHeader, where: str) -> None:
    expected = sum(element.count for element in header.elements)
    rows = 0
    file.seek(header.data_offset)
    while line := file.readline(_MAX_LINE_BYTES + 1):
        if len(line) > _MAX_LINE_BYTES:
            raise FormatError(
                "ply-malformed",
                f"{where}: row {rows} is longer than {_MAX_LINE_BYTES} bytes, expected less",
            )
        rows += not line.isspace()
    if rows < expected:
        raise TruncatedError(
            "ply-truncated", f"{where}: {rows} rows of text, expected {expected} by its header"
        )
    if rows > expected:
        raise FormatError(
            "ply-trailing-bytes", f"{where}: {rows} rows of text, expected {expected} by its header"
        )
