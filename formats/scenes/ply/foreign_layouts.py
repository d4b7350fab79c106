"""PLY layouts that plyfile reads: text, big-endian, vertices behind another element.

plyfile is licensed under the GPL and belongs to the extra ``encode``, so only a file with such a
layout imports it.
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
from cogsplat.formats.storage.parser_errors import parser_errors

from .header import PlyHeader

# plyfile makes one array per list: about 250 bytes and 5 µs for possibly one byte of the file.
# Splats have no lists, but a mesh in the same file may.
_MAX_LISTS = 1 << 17

# plyfile splits a whole line of text at once; a splat of SH degree 3 has some 1600 bytes.
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
    """Fill arrays with the vertices of a PLY of any layout, read by plyfile.

    Parameters
    ----------
    file : BinaryIO
        The open file, at any position; it stays open.
    header : PlyHeader
        The file's header, which `check_size` has accepted.
    fields : dict of str to list of str
        Vertex properties of each array's columns.
    arrays : mapping of str to (N, properties) array
        Arrays to fill, by field. Doubles are rounded to the array's type, to ±inf beyond its range.
    extras : mapping of str to (N,) array
        Arrays to fill with extra properties, by property name.
    where : str
        Name of the file for messages.

    Raises
    ------
    FormatError
        ``ply-malformed``: plyfile rejects the file, or a line of text exceeds 1 MiB;
        ``ply-trailing-bytes``: there are more lines of text than rows in the header.
    TruncatedError
        ``ply-truncated``: there are fewer lines of text than rows in the header.
    UnsupportedError
        ``needs-plyfile``: plyfile is not installed; ``ply-too-many-lists``.
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
    # A duplicate descriptor, because a text stream closes its underlying file.
    with os.fdopen(os.dup(file.fileno()), "rb") as copy:
        copy.seek(0)
        text = header.format == "ascii"
        # Escape non-ASCII comments: plyfile would reject them.
        stream = io.TextIOWrapper(copy, "ascii", "backslashreplace") if text else copy
        with parser_errors(
            lambda found: FormatError(
                "ply-malformed", f"{where}: {_layout(header)}: {found}, expected a well-formed PLY"
            ),
            passed=(OSError,),
        ):
            vertices = plyfile.PlyData.read(stream)["vertex"].data
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(vertices), _BLOCK_ROWS):
            block = vertices[start : start + _BLOCK_ROWS]
            for field, group in fields.items():
                for column, name in enumerate(group):
                    arrays[field][start : start + len(block), column] = block[name]
            for name, values in extras.items():
                values[start : start + len(block)] = block[name]


def _layout(header: PlyHeader) -> str:
    """Describe a file's format and elements, for a message."""
    elements = ", ".join(element.name for element in header.elements)
    return f"{header.format} with the elements {elements}"


def _check_lists(header: PlyHeader, where: str) -> None:
    """Raise ``ply-too-many-lists`` if a file has more lists than plyfile can hold in memory."""
    lists = sum(
        element.count * sum(1 for prop in element.properties if prop.length_dtype)
        for element in header.elements
    )
    if lists > _MAX_LISTS:
        raise UnsupportedError(
            "ply-too-many-lists",
            f"{where}: {lists} lists, expected at most {_MAX_LISTS}",
        )


def _check_lines(file: BinaryIO, header: PlyHeader, where: str) -> None:
    """Check the length and the number of a text file's lines against its header."""
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
