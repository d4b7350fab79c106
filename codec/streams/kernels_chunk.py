"""Compiled chunk reader: decodes head, refinement and tail of a chunk in two compiled calls.

It covers the streams that the profiles `transform` and `vq` write (SPEC 6.5 to 6.7, 6.10 to 6.17).
For any other or invalid chunk it returns False. numpy then decodes that chunk from the start and
raises the errors, so that errors come from one place. The module needs numba.
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
from .kernels_bits import exact, inner_exact, read_floats
from .kernels_chunk_layout import (
    COMPONENTS_OF,
    MAX_PLANES,
    MEAN_BITS,
    MEANS,
    NO_STREAM,
    OPACITIES,
    OPACITY_DIGITS,
    QUAT_ESCAPES,
    QUATS,
    SCALE_DIGITS,
    SCALE_ESCAPES,
    SCALE_FACTOR,
    SCALES,
    SH0,
    SH0_DIGITS,
    SH1_ESCAPES,
    SH2_ESCAPES,
    SH3_ESCAPES,
    SHAPE,
    SHN,
    TRANSFORM_STREAMS,
    VQ_STREAMS,
    locate,
)
from .kernels_codebook_index import escape_rows, gather, has_escapes, read_indices
from .kernels_grid import read_values, scales_from_differences, sh0_from_coordinates
from .kernels_planes import PARAMS, PRESENT, ChunkPlanes
from .kernels_quaternion import read_quaternions
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
    "float32[:, ::1], Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[:, ::1]))"
)
@exact
def _decode_transform_chunk(
    data: U8,
    records: I64,
    spans: I64,
    constants: tuple[U8, F32, F32, F32, U64, I64],
    basis: F32,
    out: tuple[F32, F32, F32, F32, F32, F32],
) -> bool:
    """Decode a chunk of the profile `transform` into `out`; return False if a stream is invalid.

    Parameters
    ----------
    data, records, spans
        As in `ChunkPlanes`.
    constants : tuple
        `_CONSTANTS`, lookup tables of the kernels: `digit_tables()`, `KNEES`, `swing_twist.STEPS`,
        `POWERS`, `AXES_OF_BITS`, `GROUP_STARTS`.
    basis : (C, d) float32
        Rows of the colour codebook that the tail refers to.
    out : tuple
        Means, scales, quats, opacities, sh0 and shN, two-dimensional; shN without rows if there
        is no tail.
    """
    tables, knees, rotation_steps, powers, axes_of_bits, group_starts = constants
    means, scales, quats, opacities, sh0, shN = out
    planes = ChunkPlanes(data, records, spans, tables)
    rows = len(scales)
    differences = np.empty((rows, 3), np.float32)
    refined = records[SCALE_DIGITS, PRESENT] != 0
    head_differences = np.empty((rows if refined else 0, 3), np.float32)
    if not read_values(
        planes, records[SCALES], records[SCALE_DIGITS], head_differences, differences
    ):
        return False
    scales_from_differences(differences, scales)
    # Steps follow from the scales of the head alone.
    head_scales = scales
    if refined:
        head_scales = np.empty((rows, 3), np.float32)
        scales_from_differences(head_differences, head_scales)
    if not read_rotations(planes, records[QUATS], knees, rotation_steps, head_scales, quats):
        return False
    if not read_means(
        planes, records[MEANS], records[MEAN_BITS], knees, powers, axes_of_bits, head_scales, means
    ):
        return False
    no_rows = head_differences[:0]
    if not read_values(planes, records[OPACITIES], records[OPACITY_DIGITS], no_rows, opacities):
        return False
    axes = np.empty(9, np.float32)
    if not read_floats(data, records[SH0, PARAMS] + 36, 9, 1.0, axes):
        return False
    if not read_values(planes, records[SH0], records[SH0_DIGITS], no_rows, differences):
        return False
    sh0_from_coordinates(differences, axes.reshape(3, 3), sh0)
    if records[SHN, PRESENT] and len(shN):
        return read_coefficients(planes, records[SHN], group_starts, basis, shN)
    return True


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
def _decode_vq_chunk(
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
    constants, out
        As in `_decode_transform_chunk`.
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
    sh_degree: int,
) -> bool:
    """Decode a chunk that has the streams of the profile `transform` or `vq`.

    Parameters
    ----------
    head, refinement, tail : memoryview or None
        Payloads, their CRCs already checked; None if absent or not requested.
    books : CodebookRows
    out : ChunkArrays
    sh_degree : int
        SH degree of the file.

    Returns
    -------
    bool
        False if the chunk is invalid or has streams that neither profile writes; `out` then holds
        arbitrary values.
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
    for streams in (TRANSFORM_STREAMS, VQ_STREAMS):
        found = _locate(payload, ends, streams, limit, len(out.scales))
        if found is None:
            continue
        data, records, spans = found
        colours = _NO_BOOK
        if records[SHN, PRESENT]:
            book = books.colours(_codebook_number(data, records, SHN))
            if book is None or book.shape[1] > BASIS_COLUMNS:
                return False
            colours = book
        if streams is TRANSFORM_STREAMS:
            return _decode_transform_chunk(data, records, spans, _CONSTANTS, colours, arrays)
        shapes = books.shapes(_codebook_number(data, records, SHAPE))
        if shapes is None:
            return False
        return _decode_vq_chunk(
            data, records, spans, _CONSTANTS, (*shapes, colours), sh_degree, arrays
        )
    return False


def _codebook_number(data: U8, records: I64, stream: int) -> int:
    """Return the number of a stream's codebook, the first integer of its parameters."""
    at = int(records[stream, PARAMS])
    return int.from_bytes(data[at : at + 4].tobytes(), "little")


def _locate(
    payload: bytes, ends: I64, streams: I64, limit: int, rows: int
) -> tuple[U8, I64, I64] | None:
    """Return data, records and spans of `ChunkPlanes`; None if a stream is not in `streams`.

    Parameters
    ----------
    payload : bytes
        Head, refinement and tail end to end.
    ends : (3,) int64
        End of each part in `payload`.
    streams : int64
        `TRANSFORM_STREAMS` or `VQ_STREAMS`.
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
