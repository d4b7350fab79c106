"""PlayCanvas' compressed PLY: 16 bytes per splat, value ranges per 256 splats, SH in bytes.

The format has no specification. This module follows public readers and writers (SuperSplat pull
request 313, splat-transform pull request 169). An element ``chunk`` holds the value ranges of 256
splats each, ``vertex`` four 32-bit words per splat, and ``sh`` one byte per SH coefficient above
DC. Axes are those of the source PLY.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, StorageError, TruncatedError, UnsupportedError
from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo, Splats
from cogsplat.formats.scenes.ply.comments import parse_scene_info, scene_comments
from cogsplat.formats.scenes.ply.header import Element, PlyHeader, check_size, is_ply, read_header
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .dropped_values import dropped_extras, warn_dropped
from .quantised_values import (
    BYTE_LOGITS,
    from_smallest_three,
    morton_order,
    opacity_bytes,
    to_smallest_three,
)

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]
# Minimum and maximum per chunk, each (chunks, 3), of means, log scales and colours.
Ranges = list[tuple[F32, F32]]

CHUNK_SPLATS: Final = 256
"""Splats that share one row of the element ``chunk``."""

_BLOCK_CHUNKS: Final = 64

_XYZ: Final = ("x", "y", "z")
_RANGES: Final = tuple(
    f"{end}_{name}"
    for names in (_XYZ, ("scale_x", "scale_y", "scale_z"))
    for end in ("min", "max")
    for name in names
)
# Absent in files of 2024, whose colours range from 0 to 1.
_COLOUR_RANGES: Final = tuple(f"{end}_{c}" for end in ("min", "max") for c in "rgb")
_WORDS: Final = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_REST_COUNTS: Final = (9, 24, 45)

# Bits of x, y and z in a word of a position or scale: 31-21, 20-11, 10-0.
_SHIFTS_111011: Final = np.array([21, 11, 0], np.uint32)
_LEVELS_111011: Final = np.array([2047, 1023, 2047], np.uint32)
_COLOUR_SHIFTS: Final = np.array([24, 16, 8], np.uint32)
_QUAT_SHIFTS: Final = np.array([20, 10, 0], np.uint32)
_QUAT_LEVELS: Final = 1023
_SQRT2: Final = float(np.sqrt(2.0))

# Log scales are clipped to ±20: one outlier would widen the range of its 255 neighbours.
_MAX_LOG_SCALE: Final = 20.0

# SH coefficients from -4 to 4 in 256 cells. A byte decodes to its cell's centre, the first and last
# byte to the ends of the range.
_SH_RANGE: Final = 8.0
_SH_VALUES: Final = ((np.arange(256) + 0.5) / 256 * _SH_RANGE - _SH_RANGE / 2).astype(np.float32)
_SH_VALUES[0], _SH_VALUES[255] = -_SH_RANGE / 2, _SH_RANGE / 2


def is_compressed_ply(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a compressed PLY."""
    if not is_ply(head):
        return False
    header, _, _ = head.partition(b"\nend_header")
    return re.search(rb"\nproperty [a-z0-9]+ packed_position(\r?\n|$)", header) is not None


def read_compressed_ply(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from a compressed PLY.

    Parameters
    ----------
    path : path
        The file, with or without colour ranges, of SH degree 0 to 3. Unknown elements are skipped.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        Splats in file order with unit quaternions. Opacity byte 255 is a logit of +inf, 0 of -inf.
        Ranges that are not finite give invalid rows, which `Splats.require_valid` rejects.

    Raises
    ------
    FormatError
        ``compressed-ply-`` followed by ``properties``, ``chunks``, ``sh``; codes of the header as
        in `read_ply`.
    TruncatedError
        ``ply-no-end-header``, ``ply-truncated``.
    UnsupportedError
        ``compressed-ply-layout``: the file is not little-endian, or has lists.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`; ``file-changed``: another process changed the file.

    Notes
    -----
    Counts are checked against the file's size before any allocation.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        before = os.fstat(file.fileno())
        header = read_header(file, where)
        _check_layout(header, where)
        check_size(header, before.st_size, where)
        vertex = header.vertex(where)
        chunk = _element(header, "chunk", where)
        _check_counts(vertex, chunk, where)
        info = parse_scene_info(header.comments, where)
        (limits or Limits()).require_scene(
            vertex.count,
            sh_degree=MAX_SH_DEGREE,
            source_bytes=before.st_size,
            where=where,
            # The file's tables stay in memory while they are unpacked.
            extra_bytes=before.st_size,
        )
        ranges = _read_ranges(file, header, chunk, where)
        words = _read_table(file, header, vertex, _WORDS, "u4", where)
        rest = _read_rest(file, header, vertex.count, where)
        after = os.fstat(file.fileno())
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise StorageError(
            "file-changed", f"{where}: was rewritten while being read, expected a file at rest"
        )
    return _unpack(ranges, words, rest, info)


def _check_layout(header: PlyHeader, where: str) -> None:
    """Raise ``compressed-ply-layout`` unless a file is little-endian without lists."""
    lists = [element.name for element in header.elements if element.has_lists]
    if header.format != "binary_little_endian" or lists:
        found = f"lists in {', '.join(lists)}" if lists else header.format
        raise UnsupportedError(
            "compressed-ply-layout", f"{where}: {found}, expected binary_little_endian, no lists"
        )


def _element(header: PlyHeader, name: str, where: str) -> Element:
    """Return the element of a name, or raise ``compressed-ply-properties``."""
    for element in header.elements:
        if element.name == name:
            return element
    raise FormatError(
        "compressed-ply-properties", f"{where}: no element '{name}', expected one next to vertex"
    )


def _check_counts(vertex: Element, chunk: Element, where: str) -> None:
    """Raise ``compressed-ply-chunks`` unless there is one chunk per 256 splats."""
    expected = -(-vertex.count // CHUNK_SPLATS)
    if chunk.count != expected:
        raise FormatError(
            "compressed-ply-chunks",
            f"{where}: {chunk.count} chunks for {vertex.count} splats, expected {expected}, one "
            f"for every {CHUNK_SPLATS}",
        )


def _read_table(
    file: BinaryIO,
    header: PlyHeader,
    element: Element,
    names: Sequence[str],
    dtype: str,
    where: str,
) -> NDArray[np.void]:
    """Return the rows of an element, after checking that properties `names` have type `dtype`."""
    types = {prop.name: prop.dtype for prop in element.properties}
    missing = [name for name in names if types.get(name) != dtype]
    if missing:
        kind = {"f4": "float", "u4": "uint", "u1": "uchar"}[dtype]
        raise FormatError(
            "compressed-ply-properties",
            f"{where}: element '{element.name}' lacks {', '.join(missing[:6])} as {kind}, "
            f"expected {', '.join(names[:6])}" + (", ..." if len(names) > 6 else ""),
        )
    start = header.data_offset
    for other in header.elements:
        if other is element:
            break
        start += other.count * other.min_stride
    file.seek(start)
    length = element.count * element.min_stride
    data = file.read(length)
    if len(data) != length:
        raise TruncatedError(
            "ply-truncated",
            f"{where}: {len(data)} bytes of element '{element.name}', expected {length}",
        )
    row = np.dtype([(prop.name, "<" + prop.dtype) for prop in element.properties])
    return np.frombuffer(data, row)


def _read_ranges(file: BinaryIO, header: PlyHeader, chunk: Element, where: str) -> Ranges:
    """Return the value ranges of all chunks; colours range from 0 to 1 if none are stored."""
    names = _RANGES
    if any(prop.name in _COLOUR_RANGES for prop in chunk.properties):
        names = _RANGES + _COLOUR_RANGES
    table = _read_table(file, header, chunk, names, "f4", where)
    ends = [
        np.stack([table[name] for name in names[k : k + 3]], axis=1).astype(np.float32)
        for k in range(0, len(names), 3)
    ]
    if len(ends) == 4:
        shape = (chunk.count, 3)
        ends += [np.zeros(shape, np.float32), np.ones(shape, np.float32)]
    return [(ends[k], ends[k + 1]) for k in range(0, 6, 2)]


def _read_rest(file: BinaryIO, header: PlyHeader, count: int, where: str) -> NDArray[np.uint8]:
    """Return the SH bytes, (N, 0, 9, 24 or 45) uint8, all of red, then green, then blue."""
    if all(element.name != "sh" for element in header.elements):
        return np.empty((count, 0), np.uint8)
    element = _element(header, "sh", where)
    names = [prop.name for prop in element.properties]
    wanted = [f"f_rest_{k}" for k in range(len(names))]
    if len(names) not in _REST_COUNTS or set(names) != set(wanted) or element.count != count:
        raise FormatError(
            "compressed-ply-sh",
            f"{where}: element 'sh' has {element.count} rows of {len(names)} properties, expected "
            f"{count} rows of f_rest_0 and on, {', '.join(map(str, _REST_COUNTS))} in all",
        )
    table = _read_table(file, header, element, wanted, "u1", where)
    bytes_ = table.view(np.uint8).reshape(count, len(names))
    return bytes_ if names == wanted else bytes_[:, [names.index(name) for name in wanted]]


def _unpack(
    ranges: Ranges, words: NDArray[np.void], rest: NDArray[np.uint8], info: SceneInfo
) -> Splats:
    """Return the scene from the chunks' ranges, the packed words and `rest`, the SH bytes."""
    count = len(words)
    per_channel = rest.shape[1] // 3
    means, scales, sh0 = (np.empty((count, 3), np.float32) for _ in range(3))
    quats = np.empty((count, 4), np.float32)
    opacities = np.empty(count, np.float32)
    shN = np.empty((count, per_channel, 3), np.float32)
    rows = _BLOCK_CHUNKS * CHUNK_SPLATS
    # Ranges of a damaged file may be NaN or overflow; they give invalid rows.
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, count, rows):
            block = slice(start, min(start + rows, count))
            chunks = slice(start // CHUNK_SPLATS, start // CHUNK_SPLATS + _BLOCK_CHUNKS)
            word = {name: words[name][block].astype(np.uint32) for name in _WORDS}
            means[block] = _interpolate(ranges[0], chunks, _unpack_111011(word["packed_position"]))
            scales[block] = _interpolate(ranges[1], chunks, _unpack_111011(word["packed_scale"]))
            colour_bytes = word["packed_color"][:, None] >> _COLOUR_SHIFTS & np.uint32(255)
            fractions = colour_bytes.astype(np.float32) / np.float32(255)
            colours = _interpolate(ranges[2], chunks, fractions)
            sh0[block] = (colours - np.float32(COLOUR_OFFSET)) / np.float32(C0)
            opacities[block] = BYTE_LOGITS[word["packed_color"] & 255]
            quats[block] = _unpack_quats(word["packed_rotation"])
            values = _SH_VALUES[rest[block]].reshape(block.stop - start, 3, per_channel)
            shN[block] = values.transpose(0, 2, 1)
    return Splats(means, scales, quats, opacities, sh0, shN, info)


def _unpack_111011(words: U32) -> F32:
    """Unpack words of 11, 10 and 11 bits to (n, 3) fractions of a chunk's range, 0 to 1."""
    codes = words[:, None] >> _SHIFTS_111011 & _LEVELS_111011
    fractions: F32 = np.divide(codes, _LEVELS_111011, dtype=np.float32)
    return fractions


def _interpolate(ends: tuple[F32, F32], chunks: slice, fractions: F32) -> F32:
    """Return the (n, 3) values at fractions, 0 to 1, of the ranges of consecutive chunks."""
    low, high = (end[chunks].repeat(CHUNK_SPLATS, axis=0)[: len(fractions)] for end in ends)
    # This form gives the ends exactly at 0 and 1.
    values: F32 = low * (np.float32(1) - fractions) + high * fractions
    return values


def _unpack_quats(words: U32) -> F32:
    """Unpack words of a 2-bit index and three 10-bit components to wxyz quaternions."""
    codes = words[:, None] >> _QUAT_SHIFTS & np.uint32(_QUAT_LEVELS)
    others = (codes.astype(np.float32) / np.float32(_QUAT_LEVELS) - np.float32(0.5)) * _SQRT2
    return from_smallest_three(words >> np.uint32(30), others.astype(np.float32))


def write_compressed_ply(splats: Splats, path: StrPath, *, force: bool = False) -> None:
    """Write a scene as a compressed PLY, atomically.

    Parameters
    ----------
    splats : Splats
        Scene, stored in Morton order. Log scales are clipped to ±20, SH coefficients above DC to
        ±4; opacities are rounded to 1/255. Values of `splats.info` other than the defaults become
        comments, which `read_compressed_ply` parses.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    DataError
        ``invalid-rows``; ``bad-scene-info``.
    StorageError
        See `atomic_write`, e.g. ``exists``.

    Warns
    -----
    CogsplatWarning
        The scene has extras, which are dropped.
    """
    splats.require_valid()
    warn_dropped(path, "compressed PLY", dropped_extras(splats))
    splats = splats.without_extras()
    count, rest = len(splats), 3 * splats.shN.shape[1]
    order = morton_order(splats.means)
    chunks = -(-count // CHUNK_SPLATS)
    lows = np.empty((chunks, 3, 3), "<f4")
    highs = np.empty((chunks, 3, 3), "<f4")
    words = np.empty((count, 4), "<u4")
    sh = np.empty((count, rest), np.uint8)
    rows = _BLOCK_CHUNKS * CHUNK_SPLATS
    for start in range(0, count, rows):
        block = slice(start, min(start + rows, count))
        part = splats.take(order[block])
        first = start // CHUNK_SPLATS
        columns = (
            part.means,
            part.scales.clip(-_MAX_LOG_SCALE, _MAX_LOG_SCALE),
            part.sh0 * np.float32(C0) + np.float32(COLOUR_OFFSET),
        )
        fractions = []
        for index, values in enumerate(columns):
            low, high = _chunk_ranges(values)
            lows[first : first + len(low), index] = low
            highs[first : first + len(low), index] = high
            fractions.append(_fractions(values, low, high))
        words[block, 0] = _pack_111011(fractions[0])
        words[block, 1] = _pack_quats(part.quats)
        words[block, 2] = _pack_111011(fractions[1])
        colours = np.rint(fractions[2] * 255).astype(np.uint32) << _COLOUR_SHIFTS
        words[block, 3] = np.bitwise_or.reduce(colours, axis=1) | opacity_bytes(part.opacities)
        cells = (part.shN.transpose(0, 2, 1) / np.float32(_SH_RANGE) + np.float32(0.5)) * 256
        sh[block] = cells.clip(0, 255).astype(np.uint8).reshape(len(part), rest)
    # Minimum and maximum of means, then of scales, then of colours.
    ranges = np.stack([lows, highs], axis=2)
    with atomic_write(path, force) as file:
        file.write(_header(splats, chunks))
        for array in (ranges, words, sh):
            file.write(array.data if array.size else b"")


def _header(splats: Splats, chunks: int) -> bytes:
    """Return the PLY header of a compressed scene."""
    rest = 3 * splats.shN.shape[1]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {comment}" for comment in scene_comments(splats.info)),
        f"element chunk {chunks}",
        *(f"property float {name}" for name in _RANGES + _COLOUR_RANGES),
        f"element vertex {len(splats)}",
        *(f"property uint {name}" for name in _WORDS),
    ]
    if rest:
        lines.append(f"element sh {len(splats)}")
        lines += [f"property uchar f_rest_{k}" for k in range(rest)]
    return "\n".join([*lines, "end_header\n"]).encode("ascii")


def _chunk_ranges(values: F32) -> tuple[F32, F32]:
    """Return the minimum and the maximum of every 256 rows, each (chunks, 3)."""
    starts = np.arange(0, len(values), CHUNK_SPLATS)
    low: F32 = np.minimum.reduceat(values, starts, axis=0)
    high: F32 = np.maximum.reduceat(values, starts, axis=0)
    return low, high


def _fractions(values: F32, low: F32, high: F32) -> NDArray[np.float64]:
    """Return (n, 3) values as fractions, 0 to 1, of the ranges of their chunks.

    `low` and `high` have one row per chunk.
    """
    wide_low = low.astype(np.float64)
    extent = high - wide_low
    extent[extent == 0] = 1
    repeated = wide_low.repeat(CHUNK_SPLATS, axis=0)[: len(values)]
    fractions: NDArray[np.float64] = values - repeated
    fractions /= extent.repeat(CHUNK_SPLATS, axis=0)[: len(values)]
    return fractions


def _pack_111011(fractions: NDArray[np.float64]) -> U32:
    """Pack (n, 3) fractions, 0 to 1, into words of 11, 10 and 11 bits."""
    codes = np.rint(fractions * _LEVELS_111011).astype(np.uint32) << _SHIFTS_111011
    packed: U32 = np.bitwise_or.reduce(codes, axis=1)
    return packed


def _pack_quats(quats: F32) -> U32:
    """Pack wxyz quaternions into words of a 2-bit index and three 10-bit components."""
    largest, others = to_smallest_three(quats)
    codes = np.rint((others / _SQRT2 + 0.5) * _QUAT_LEVELS).clip(0, _QUAT_LEVELS)
    packed: U32 = np.bitwise_or.reduce(codes.astype(np.uint32) << _QUAT_SHIFTS, axis=1)
    return packed | largest.astype(np.uint32) << np.uint32(30)
