"""Compiled chunk reader: decodes head, refinement and tail of a chunk in two compiled calls.

It covers the streams that the profiles `transform` and `vq` write in heads and refinements, and
tails on a basis (SPEC 6.5, 6.7, 6.10 to 6.17). For any other or invalid chunk it returns False.
numpy then decodes that chunk from the start and raises the errors, so that errors come from one
place. The module needs numba.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import swing_twist, zstd_frames
from .adaptive_step import KNEES
from .byte_planes import digit_tables
from .chunk_arrays import ChunkArrays, CodebookRows
from .kernels_bits import exact, read_floats
from .kernels_chunk_layout import (
    COMPONENTS_OF,
    INDEXED_STREAMS,
    MAX_PLANES,
    MEAN_BITS,
    MEANS,
    NO_STREAM,
    OPACITIES,
    OPACITY_DIGITS,
    QUATS,
    SCALE_DIGITS,
    SCALE_FACTOR,
    SCALES,
    SH0,
    SH0_DIGITS,
    SHAPE,
    SHN,
    TRANSFORM_STREAMS,
    locate,
)
from .kernels_codebook_index import gather, read_indices
from .kernels_grid import read_values, scales_from_differences, sh0_from_coordinates
from .kernels_planes import PARAMS, PRESENT, ROWS, ChunkPlanes
from .kernels_shn_transform import BASIS_COLUMNS, read_coefficients
from .kernels_sorted_means import AXES_OF_BITS, read_means
from .kernels_swing_twist import read_rotations
from .shn_transform import GROUP_STARTS
from .sorted_means import POWERS

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

# Limit of decompressed and unpacked planes: a fixed part and bytes per splat. Encoded chunks have
# about 60 bytes per splat. Larger chunks are left to numpy, which needs less memory for them.
_PLANE_BYTES_PER_SPLAT: Final = 96
_MIN_PLANE_BYTES: Final = 1 << 14


@called_with(
    "uint8[::1], int64[:, ::1], int64[:, ::1], "
    "Tuple((uint8[:, :, ::1], float32[::1], float32[::1], float32[::1], uint64[::1], int64[::1])), "
    "Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1])), "
    "Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[:, ::1]))"
)
@exact
def _decode_chunk(
    data: U8,
    records: I64,
    spans: I64,
    constants: tuple[U8, F32, F32, F32, U64, I64],
    books: tuple[F32, F32, F32],
    out: tuple[F32, F32, F32, F32, F32, F32],
) -> bool:
    """Decode a chunk into `out`; return False if a stream is invalid.

    Parameters
    ----------
    data, records, spans
        As in `ChunkPlanes`.
    constants : tuple
        `_CONSTANTS`, lookup tables of the kernels: `digit_tables()`, `KNEES`, `swing_twist.STEPS`,
        `POWERS`, `AXES_OF_BITS`, `GROUP_STARTS`.
    books : tuple
        (C, 3) log scales and (C, 4) quaternions of the shape codebook that the head refers to, and
        (C, d) rows of the colour codebook that the tail refers to.
    out : tuple
        Means, scales, quats, opacities, sh0 and shN, two-dimensional; shN without rows if there
        is no tail.
    """
    tables, knees, rotation_steps, powers, axes_of_bits, group_starts = constants
    means, scales, quats, opacities, sh0, shN = out
    planes = ChunkPlanes(data, records, spans, tables)
    rows = len(scales)
    indexed = records[SHAPE, PRESENT] != 0
    # Of a head with indices, scales and quats are those of escape rows.
    stored = records[SCALES, ROWS]
    if records[QUATS, ROWS] != stored:
        return False
    differences = np.empty((stored, 3), np.float32)
    refined = records[SCALE_DIGITS, PRESENT] != 0
    head_differences = np.empty((rows if refined else 0, 3), np.float32)
    stored_scales, stored_quats = scales, quats
    if indexed:
        stored_scales = np.empty((stored, 3), np.float32)
        stored_quats = np.empty((stored, 4), np.float32)
    # Steps follow from the scales of the head alone.
    head_scales = stored_scales
    if refined:
        head_scales = np.empty((rows, 3), np.float32)
    if stored:
        if not read_values(
            planes, records[SCALES], records[SCALE_DIGITS], head_differences, differences
        ):
            return False
        scales_from_differences(differences, stored_scales)
        if refined:
            scales_from_differences(head_differences, head_scales)
        if not read_rotations(
            planes, records[QUATS], knees, rotation_steps, head_scales, stored_quats
        ):
            return False
    no_rows = head_differences[:0]
    if indexed:
        indices = np.empty(rows, np.uint32)
        factors = np.empty((rows, 1), np.float32)
        if not read_indices(planes, records[SHAPE], len(books[0]), stored, indices):
            return False
        if not read_values(planes, records[SCALE_FACTOR], records[NO_STREAM], no_rows, factors):
            return False
        gather(books[0], stored_scales, indices, scales)
        gather(books[1], stored_quats, indices, quats)
        for row in range(rows):
            for axis in range(3):
                scales[row, axis] = scales[row, axis] + factors[row, 0]
        head_scales = scales
    if not read_means(
        planes, records[MEANS], records[MEAN_BITS], knees, powers, axes_of_bits, head_scales, means
    ):
        return False
    if not read_values(planes, records[OPACITIES], records[OPACITY_DIGITS], no_rows, opacities):
        return False
    axes = np.empty(9, np.float32)
    if not read_floats(data, records[SH0, PARAMS] + 36, 9, 1.0, axes):
        return False
    coordinates = np.empty((rows, 3), np.float32)
    if not read_values(planes, records[SH0], records[SH0_DIGITS], no_rows, coordinates):
        return False
    sh0_from_coordinates(coordinates, axes.reshape(3, 3), sh0)
    if records[SHN, PRESENT] and len(shN):
        return read_coefficients(planes, records[SHN], group_starts, books[2], shN)
    return True


_CONSTANTS: Final = (
    digit_tables(),
    KNEES,
    swing_twist.STEPS,
    POWERS,
    AXES_OF_BITS,
    np.array(GROUP_STARTS, np.int64),
)

_NO_BOOK: Final = np.zeros((0, 0), np.float32)


def read(
    head: memoryview,
    refinement: memoryview | None,
    tail: memoryview | None,
    books: CodebookRows,
    out: ChunkArrays,
) -> bool:
    """Decode a chunk that has the streams of the profile `transform`, shapes perhaps indexed.

    Parameters
    ----------
    head, refinement, tail : memoryview or None
        Payloads, their CRCs already checked; None if absent or not requested.
    books : CodebookRows
    out : ChunkArrays

    Returns
    -------
    bool
        False if the chunk is invalid or has other streams. `out` then holds arbitrary values.
    """
    payload = b"".join((head, refinement or b"", tail or b""))
    ends = np.array((len(head), len(head) + len(refinement or b""), len(payload)), np.int64)
    limit = _MIN_PLANE_BYTES + _PLANE_BYTES_PER_SPLAT * len(out.scales)
    arrays = (
        out.means,
        out.scales,
        out.quats,
        out.opacities[:, None],
        out.sh0,
        out.shN if tail is not None else out.shN[:0],
    )
    for streams in (TRANSFORM_STREAMS, INDEXED_STREAMS):
        found = _locate(payload, ends, streams, limit, len(out.scales))
        if found is not None:
            break
    else:
        return False
    data, records, spans = found
    colours, shapes = _NO_BOOK, (_NO_BOOK, _NO_BOOK)
    if records[SHN, PRESENT]:
        book = books.colours(_codebook_number(data, records, SHN))
        if book is None or book.shape[1] > BASIS_COLUMNS:
            return False
        colours = book
    if records[SHAPE, PRESENT]:
        rows = books.shapes(_codebook_number(data, records, SHAPE))
        if rows is None:
            return False
        shapes = rows
    return _decode_chunk(data, records, spans, _CONSTANTS, (*shapes, colours), arrays)


def _codebook_number(data: U8, records: I64, stream: int) -> int:
    """Return the number of a stream's codebook, the first integer of its parameters."""
    at = int(records[stream, PARAMS])
    return int.from_bytes(data[at : at + 4].tobytes(), "little")


def _locate(
    payload: bytes, ends: I64, streams: I64, limit: int, rows: int
) -> tuple[U8, I64, I64] | None:
    """Return data, records and spans of `ChunkPlanes`; None for streams that it cannot hold.

    Parameters
    ----------
    payload : bytes
        Head, refinement and tail end to end.
    ends : (3,) int64
        End of each part in `payload`.
    streams : (s, 6) int64
        `TRANSFORM_STREAMS` or `INDEXED_STREAMS`.
    limit : int
        Limit of the total size of all planes after decompression and unpacking, bytes.
    rows : int
        Splats of the chunk.
    """
    records = np.empty((len(streams) + 1, 6), np.int64)
    spans = np.empty((4, MAX_PLANES), np.int64)
    frames = np.empty((MAX_PLANES, 2), np.uint64)
    sizes = np.empty(MAX_PLANES, np.uint64)
    stored = np.frombuffer(payload, np.uint8)
    count, expanded, symbols = locate(
        stored, ends, rows, streams, COMPONENTS_OF, limit, records, spans, frames, sizes
    )
    if count < 0:
        return None
    # Low bits are read two bytes at a time: two bytes must follow the last plane.
    data = np.empty(len(payload) + expanded + symbols + 2, np.uint8)
    data[: len(payload)] = stored
    if count:
        raw = zstd_frames.decompress_located(memoryview(payload), frames[:count], sizes[:count])
        if raw is None or len(raw) != expanded:
            return None
        data[len(payload) : len(payload) + expanded] = np.frombuffer(raw, np.uint8)
    return data, records, spans
