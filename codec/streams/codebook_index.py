"""Vq streams: indices into a codebook followed by escape rows (SPEC 6.7)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import grid_planes
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

_PARAMS: Final = struct.Struct("<II")


@dataclass(frozen=True)
class CodebookUse:
    """Codebook number and count of escape rows that a stream refers to.

    Parameters
    ----------
    number : int
        Number of the codebook in the file.
    escape_rows : int
        Number of escape rows in the same payload.
    """

    number: int
    escape_rows: int = 0


def write(attribute: Attribute, indices: U32, codebook: int, size: int) -> Stream:
    """Return a vq stream.

    Parameters
    ----------
    attribute : Attribute
        `SHAPE` or `SHN`.
    indices : (n,) uint32
        Rows of the codebook, below `size`; `size` stands for the next escape row.
    codebook : int
        Number of the codebook in the file.
    size : int
        Rows of the codebook.
    """
    escape_rows = int((indices == size).sum())
    planes = grid_planes.split_planes(indices, size + min(escape_rows, 1))
    params = _PARAMS.pack(codebook, escape_rows)
    return Stream(attribute, Kind.VQ, len(indices), params, planes)


def parse(stream: StoredStream) -> CodebookUse:
    """Return the codebook number and the count of escape rows of a vq stream.

    Raises
    ------
    FormatError
        ``stream-params``; ``stream-rows``: the stream has fewer rows than escape rows.
    """
    number, escape_rows = _PARAMS.unpack(stream.require_params(_PARAMS.size))
    if escape_rows > stream.rows:
        raise FormatError(
            "stream-rows",
            f"{stream.where}: {escape_rows} escape rows, expected at most {stream.rows}",
            clause="6.7",
        )
    return CodebookUse(number, escape_rows)


def read_indices(stream: StoredStream, size: int) -> U32:
    """Return the (rows,) indices of a vq stream, escape rows numbered from `size` on.

    Parameters
    ----------
    stream : StoredStream
        Vq stream.
    size : int
        Number of rows of the codebook.

    Raises
    ------
    FormatError
        Codes of `parse`; ``stream-planes``; ``index-range``.
    """
    escape_rows = parse(stream).escape_rows
    codes = size + min(escape_rows, 1)
    planes = stream.read_planes([stream.rows] * grid_planes.code_bytes(codes))
    indices = grid_planes.join_planes(planes, stream.rows)
    if len(indices) and int(indices.max()) >= codes:
        raise FormatError(
            "index-range",
            f"{stream.where}: index {int(indices.max())}, expected below {codes}",
            clause="6.7",
        )
    escaped = np.flatnonzero(indices == size)
    if len(escaped) != escape_rows:
        raise FormatError(
            "index-range",
            f"{stream.where}: {len(escaped)} indices {size}, which stands for an escape row, "
            f"expected {escape_rows}",
            clause="6.7",
        )
    indices[escaped] += np.arange(escape_rows, dtype=np.uint32)
    return indices


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Look up the rows of a vq stream in codebook and escape rows, into (rows, d) float32 `out`.

    Needs `inputs.codebook`, and `inputs.escape` if the stream has escape rows.

    Raises
    ------
    FormatError
        Codes of `read_indices`.
    ValueError
        No codebook is given.
    """
    if inputs.codebook is None:
        raise ValueError("no codebook for a vq stream")
    indices = read_indices(stream, len(inputs.codebook))
    gather(inputs.codebook, inputs.escape, indices, out)


def gather(codebook: F32, escape: F32 | None, indices: U32, out: F32) -> None:
    """Copy rows of a codebook and of its escape rows, by index, into (n, d) float32 `out`.

    Parameters
    ----------
    codebook : (C, d) float32
        Rows of the codebook.
    escape : (e, d) float32 or None
        Escape rows, which follow the rows of the codebook.
    indices : (n,) uint32
        Below C + e, checked by the caller.
    out : (n, d) float32
        Selected rows.
    """
    # mode="raise" would make numpy copy `out`. Rows of clipped indices are overwritten below.
    np.take(codebook, indices, axis=0, out=out, mode="clip")
    if escape is not None and len(escape):
        escaped = np.flatnonzero(indices >= len(codebook))
        out[escaped] = escape[indices[escaped] - np.uint32(len(codebook))]
