"""Compiled decoding of a chunk of the profile `vq`, for `kernels_chunk.read` (SPEC 6.7).

It is a module of its own because compiling it takes as long as compiling all of `kernels_chunk`,
and most files have no such chunk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .kernels_bits import exact, inner_exact
from .kernels_chunk_layout import (
    MEANS,
    NO_STREAM,
    OPACITIES,
    QUAT_ESCAPES,
    SCALE_ESCAPES,
    SCALE_FACTOR,
    SH0,
    SH1_ESCAPES,
    SH2_ESCAPES,
    SH3_ESCAPES,
    SHAPE,
    SHN,
)
from .kernels_codebook_index import escape_rows, gather, has_escapes, read_indices
from .kernels_grid import read_values
from .kernels_planes import PRESENT, ChunkPlanes
from .kernels_quaternion import read_quaternions
from .kernels_sorted_means import read_means

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]


@inner_exact
def _decode_shapes(
    planes: ChunkPlanes, book_scales: F32, book_quats: F32, scales: F32, quats: F32
) -> bool:
    """Decode scales and rotations from a shape codebook and escape rows (SPEC 6.7, 7.2).

    Returns False if a stream is invalid.
    """
    records = planes.records
    rows = len(scales)
    escapes = escape_rows(planes, records[SHAPE])
    if escapes > rows or not has_escapes(records[SCALE_ESCAPES], escapes):
        return False
    if not has_escapes(records[QUAT_ESCAPES], escapes):
        return False
    escape_scales = np.empty((escapes, 3), np.float32)
    escape_quats = np.empty((escapes, 4), np.float32)
    if escapes:
        if not read_values(
            planes, records[SCALE_ESCAPES], records[NO_STREAM], escape_scales[:0], escape_scales
        ):
            return False
        if not read_quaternions(planes, records[QUAT_ESCAPES], escape_quats):
            return False
    indices = np.empty(rows, np.uint32)
    if not read_indices(planes, records[SHAPE], len(book_scales) + escapes, indices):
        return False
    gather(book_scales, escape_scales, indices, scales)
    gather(book_quats, escape_quats, indices, quats)
    factors = np.empty((rows, 1), np.float32)
    if not read_values(planes, records[SCALE_FACTOR], records[NO_STREAM], factors[:0], factors):
        return False
    for row in range(rows):
        for axis in range(3):
            scales[row, axis] = scales[row, axis] + factors[row, 0]
    return True


@inner_exact
def _decode_colours(planes: ChunkPlanes, book: F32, sh_degree: int, out: F32) -> bool:
    """Decode shN from a colour codebook and escape rows, band by band (SPEC 6.7, 7.3).

    Bands above the columns of `out` are skipped; bands above `sh_degree` are invalid. Returns False
    if a stream is invalid.
    """
    records = planes.records
    rows, columns = out.shape
    escapes = escape_rows(planes, records[SHN])
    if escapes > rows:
        return False
    values = np.zeros((escapes, columns), np.float32)
    for band in range(1, 4):
        stream = SH1_ESCAPES if band == 1 else (SH2_ESCAPES if band == 2 else SH3_ESCAPES)
        if not records[stream, PRESENT]:
            continue
        first, last = 3 * (band * band - 1), 3 * ((band + 1) * (band + 1) - 1)
        if band > sh_degree or not has_escapes(records[stream], escapes):
            return False
        if last > columns:
            continue
        own = np.empty((escapes, last - first), np.float32)
        if not read_values(planes, records[stream], records[NO_STREAM], own[:0], own):
            return False
        for row in range(escapes):
            for column in range(last - first):
                values[row, first + column] = own[row, column]
    indices = np.empty(rows, np.uint32)
    if not read_indices(planes, records[SHN], len(book) + escapes, indices):
        return False
    gather(book, values, indices, out)
    return True


@called_with(
    "uint8[::1], int64[:, ::1], int64[:, ::1], "
    "Tuple((uint8[:, :, ::1], float32[::1], float32[::1], float32[::1], uint64[::1], int64[::1])), "
    "Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1])), int64, "
    "Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[:, ::1]))"
)
@exact
def decode_vq_chunk(
    data: U8,
    records: I64,
    spans: I64,
    constants: tuple[U8, F32, F32, F32, U64, I64],
    books: tuple[F32, F32, F32],
    sh_degree: int,
    out: tuple[F32, F32, F32, F32, F32, F32],
) -> bool:
    """Decode a chunk of the profile `vq` into `out`; return False if a stream is invalid.

    Parameters
    ----------
    data, records, spans
        As in `ChunkPlanes`.
    constants : tuple
        Lookup tables, `kernels_chunk._CONSTANTS`.
    out : tuple
        Means, scales, quats, opacities, sh0 and shN, two-dimensional; shN without rows if there
        is no tail.
    books : tuple
        (C, 3) log scales and (C, 4) quaternions of the shape codebook, (C, d) rows of the colour
        codebook.
    sh_degree : int
        SH degree of the file.
    """
    tables, knees, _, powers, axes_of_bits, _ = constants
    means, scales, quats, opacities, sh0, shN = out
    planes = ChunkPlanes(data, records, spans, tables)
    if not _decode_shapes(planes, books[0], books[1], scales, quats):
        return False
    if not read_means(
        planes, records[MEANS], records[NO_STREAM], knees, powers, axes_of_bits, scales, means
    ):
        return False
    if not read_values(planes, records[OPACITIES], records[NO_STREAM], opacities[:0], opacities):
        return False
    if not read_values(planes, records[SH0], records[NO_STREAM], sh0[:0], sh0):
        return False
    if records[SHN, PRESENT] and len(shN):
        return _decode_colours(planes, books[2], sh_degree, shN)
    return True
