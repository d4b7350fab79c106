"""Reader of .ksplat scenes, compression levels 0 to 2, the format of GaussianSplats3D 0.4.

A file has a header of 4096 bytes, one header of 1024 bytes per section, then the sections: sizes of
partly filled buckets, bucket centres, records. Level 0 stores float32. Level 1 stores half floats,
and positions as 16-bit offsets from the centre of the splat's bucket. Level 2 also stores SH as
bytes between a minimum and a maximum. Source: the public behaviour of
github.com/mkkellogg/GaussianSplats3D.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, TruncatedError, UnsupportedError
from cogsplat.codec.splats import Splats, empty, sh_coefficients
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import describe

from .quantised_values import BYTE_LOGITS
from .splat import COLOUR_BYTES, log_scales

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

HEADER_BYTES: Final = 4096
SECTION_HEADER_BYTES: Final = 1024

VERSION: Final = (0, 1)

# Version, section capacity and count, splat capacity and count, level, scene centre (for viewers;
# not added to positions), minimum and maximum SH coefficient of level 2.
_HEADER: Final = struct.Struct("<BB2xIIIIH2x3f2f")

# Splat count and capacity, splats in a full bucket, buckets, side of a bucket's block, bytes of a
# bucket's centre, half the range of positions, bytes of the section (ignored), full and partly
# filled buckets, SH degree.
_SECTION: Final = struct.Struct("<IIIIfH2xIIIIH")

_CENTRE_BYTES: Final = 12

# Values of fields that older writers left zero.
_DEFAULT_SH_RANGE: Final = 1.5
_DEFAULT_POSITION_RANGE: Final = 32767

_MAX_SH_DEGREE: Final = 2

_BLOCK_ROWS: Final = 1 << 14

# Log scales that replace a scale of zero, for float32 and half: the logarithm of half the smallest
# positive value.
_ZERO_LOG_SCALES: Final = (np.float32(np.log(2.0**-150)), np.float32(np.log(2.0**-25)))


@dataclass(frozen=True)
class _Header:
    """The fields of a file's header that reading needs."""

    level: int
    num_sections: int
    count: int
    sh_min: float
    sh_max: float


@dataclass(frozen=True)
class _Section:
    """Header of one section, and the offsets of its parts in the file."""

    count: int
    bucket_rows: int
    num_buckets: int
    block_size: float
    position_range: int
    full_buckets: int
    partial_buckets: int
    sh_degree: int
    offset: int
    centres_offset: int
    records_offset: int


def read_ksplat(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from a .ksplat file.

    Parameters
    ----------
    path : path
        File of version 0.1 or a later minor version, level 0 to 2, SH degree 0 to 2.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        All sections in file order, in RDF axes, at the highest SH degree of any section; missing
        coefficients are zeros. Opacity byte 255 is a logit of +inf, 0 of -inf. Rows with NaN are
        kept.

    Raises
    ------
    FormatError
        ``ksplat-`` followed by ``level``, ``count``, ``bad-sh``, ``buckets``, ``trailing-bytes``.
    TruncatedError
        ``ksplat-truncated``.
    UnsupportedError
        ``ksplat-version``.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`.

    Notes
    -----
    Every section is checked to lie inside the file before any allocation.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    header = _read_header(data, where)
    sections = _read_sections(data, header, where)
    degree = max((section.sh_degree for section in sections if section.count), default=0)
    (limits or Limits()).require_scene(
        header.count,
        sh_degree=degree,
        source_bytes=len(data),
        where=where,
        # Bucket index of each splat, int64.
        extra_bytes=8 * header.count,
    )
    splats = empty(degree, header.count)
    start = 0
    for section in sections:
        part = splats.take(slice(start, start + section.count))
        _read_section(data, header, section, part, where)
        start += section.count
    return splats


def _read_header(data: bytes, where: str) -> _Header:
    """Parse and check a file's header."""
    if len(data) < HEADER_BYTES:
        raise TruncatedError(
            "ksplat-truncated",
            f"{where}: {len(data)} bytes, expected a header of {HEADER_BYTES}",
            needed=HEADER_BYTES,
        )
    major, minor, num_sections, _, _, count, level, *_, low, high = _HEADER.unpack_from(data)
    if major != VERSION[0] or minor < VERSION[1]:
        raise UnsupportedError(
            "ksplat-version",
            f"{where}: version {major}.{minor} ({describe(data[:64])}), expected "
            f"{VERSION[0]}.{VERSION[1]}",
        )
    if level > 2:
        raise FormatError("ksplat-level", f"{where}: compression level {level}, expected 0 to 2")
    return _Header(level, num_sections, count, low or -_DEFAULT_SH_RANGE, high or _DEFAULT_SH_RANGE)


def _read_sections(data: bytes, header: _Header, where: str) -> list[_Section]:
    """Parse the section headers, and check that the sections fill the file exactly."""
    offset = HEADER_BYTES + header.num_sections * SECTION_HEADER_BYTES
    if offset > len(data):
        raise TruncatedError(
            "ksplat-truncated",
            f"{where}: {len(data)} bytes, expected {header.num_sections} section headers up to "
            f"byte {offset}",
            needed=offset,
        )
    sections = []
    for k in range(header.num_sections):
        fields = _SECTION.unpack_from(data, HEADER_BYTES + k * SECTION_HEADER_BYTES)
        count, capacity, bucket_rows, num_buckets, block_size, centre_bytes, *rest = fields
        position_range, _, full, partial, degree = rest
        if degree > _MAX_SH_DEGREE:
            raise FormatError(
                "ksplat-bad-sh",
                f"{where}: section {k} of SH degree {degree}, expected 0 to {_MAX_SH_DEGREE}",
            )
        if count > capacity:
            raise FormatError(
                "ksplat-count",
                f"{where}: section {k} of {count} splats, expected at most {capacity}, its "
                "capacity",
            )
        if header.level and (centre_bytes != _CENTRE_BYTES or full + partial > num_buckets):
            raise FormatError(
                "ksplat-buckets",
                f"{where}: section {k} has {full} full and {partial} partly filled buckets with "
                f"centres of {centre_bytes} bytes, expected at most {num_buckets} buckets with "
                f"centres of {_CENTRE_BYTES} bytes",
            )
        centres = offset + 4 * partial
        records = centres + centre_bytes * num_buckets
        sections.append(
            _Section(
                count=count,
                bucket_rows=bucket_rows,
                num_buckets=num_buckets,
                block_size=block_size,
                position_range=position_range or _DEFAULT_POSITION_RANGE,
                full_buckets=full,
                partial_buckets=partial,
                sh_degree=degree,
                offset=offset,
                centres_offset=centres,
                records_offset=records,
            )
        )
        offset = records + capacity * _record(header.level, degree).itemsize
        if offset > len(data):
            raise TruncatedError(
                "ksplat-truncated",
                f"{where}: {len(data)} bytes, expected section {k} with {capacity} splats up to "
                f"byte {offset}",
                needed=offset,
            )
    if offset != len(data):
        raise FormatError(
            "ksplat-trailing-bytes",
            f"{where}: {len(data) - offset} bytes behind the last section, expected none",
        )
    total = sum(section.count for section in sections)
    if total != header.count:
        raise FormatError(
            "ksplat-count",
            f"{where}: {header.count} splats, expected {total}, the sum of its sections",
        )
    return sections


def _record(level: int, degree: int) -> np.dtype[np.void]:
    """Return the numpy type of a splat's record."""
    number = "<f2" if level else "<f4"
    return np.dtype(
        [
            ("means", "<u2" if level else "<f4", 3),
            ("scales", number, 3),
            ("quats", number, 4),
            ("rgba", "u1", 4),
            ("sh", "u1" if level == 2 else number, 3 * (sh_coefficients(degree) - 1)),
        ]
    )


def _read_section(data: bytes, header: _Header, section: _Section, out: Splats, where: str) -> None:
    """Decode a section into `out`, a view of the scene's rows."""
    records = np.frombuffer(
        data, _record(header.level, section.sh_degree), section.count, section.records_offset
    )
    buckets = _bucket_rows(data, section, where) if header.level else None
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.float32(section.block_size / 2 / section.position_range)
        sh_step = (header.sh_max - header.sh_min) / 255
        sh_bytes = (np.arange(256) * sh_step + header.sh_min).astype(np.float32)
    for start in range(0, section.count, _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        block = records[rows]
        # Rows with NaN are kept, without warnings.
        with np.errstate(over="ignore", invalid="ignore"):
            if buckets is None:
                out.means[rows] = block["means"]
            else:
                centres, bucket_of = buckets
                offsets = block["means"].astype(np.float32) - np.float32(section.position_range)
                out.means[rows] = offsets * step + centres[bucket_of[rows]]
            linear = block["scales"].astype(np.float32)
            out.scales[rows] = log_scales(linear, _ZERO_LOG_SCALES[1 if header.level else 0])
            out.quats[rows] = block["quats"]
            values = sh_bytes[block["sh"]] if header.level == 2 else block["sh"].astype(np.float32)
        out.sh0[rows] = COLOUR_BYTES[block["rgba"][:, :3]]
        out.opacities[rows] = BYTE_LOGITS[block["rgba"][:, 3]]
        # SH is stored band by band, and within a band channel by channel, red first.
        at = 0
        for band in range(1, section.sh_degree + 1):
            width = 2 * band + 1
            columns = values[:, 3 * at : 3 * (at + width)].reshape(-1, 3, width)
            out.shN[rows, at : at + width] = columns.transpose(0, 2, 1)
            at += width


def _bucket_rows(data: bytes, section: _Section, where: str) -> tuple[F32, NDArray[np.intp]]:
    """Return the (buckets, 3) centres of a section's buckets, and each splat's bucket index."""
    centres = np.frombuffer(data, "<f4", 3 * section.num_buckets, section.centres_offset)
    sizes = np.frombuffer(data, "<u4", section.partial_buckets, section.offset)
    in_full = section.full_buckets * section.bucket_rows
    # Splats are stored bucket by bucket, full buckets first.
    ends = in_full + np.cumsum(sizes, dtype=np.uint64)
    in_buckets = int(ends[-1]) if len(ends) else in_full
    if in_buckets < section.count:
        raise FormatError(
            "ksplat-buckets",
            f"{where}: buckets for {in_buckets} splats, expected {section.count}",
        )
    rows = np.arange(section.count, dtype=np.uint64)
    bucket_of = section.full_buckets + np.searchsorted(ends, rows, side="right")
    full = min(in_full, section.count)
    if full:
        bucket_of[:full] = np.arange(full) // section.bucket_rows
    return centres.astype(np.float32).reshape(-1, 3), bucket_of
