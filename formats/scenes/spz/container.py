"""SPZ files as bytes: header, extension records, and the six streams of values in their wrapping.

Facts from the format's public description (github.com/nianticlabs/spz, README and
extensions/README). Versions 1 to 3 are one gzip member holding header, streams and extensions;
version 4 is a plain header, extensions, a table of contents and one zstd frame per stream.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from cogsplat.codec import splats
from cogsplat.codec.errors import FormatError, TruncatedError, UnsupportedError
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.formats.storage.limits import Limits

U8 = NDArray[np.uint8]

MAGIC: Final = b"NGSP"
GZIP_MAGIC: Final = b"\x1f\x8b"  # RFC 1952, 2.3.1

FLAG_ANTIALIASED: Final = 0x01
FLAG_EXTENSIONS: Final = 0x02
FLAG_LOD_TREE: Final = 0x80
"""Spark's levels of detail: opacities mean something else and coarse splats overlap fine ones."""

STREAMS: Final = ("positions", "alphas", "colors", "scales", "rotations", "sh")
"""In the order of the file."""

MAX_SH_DEGREE: Final = 4

MAX_FRACTIONAL_BITS: Final = 30
"""The reference shifts a 32-bit one by this number."""

# Common to all versions: magic, version, splats, SH degree, fractional bits, flags, and in version
# 4 the number of streams (reserved before).
_HEADER: Final = struct.Struct("<4sIIBBBB")
# Version 4 goes on with the offset of its table of contents and 12 reserved bytes.
_HEADER_4: Final = struct.Struct("<4sIIBBBBI12x")
_TOC_ENTRY: Final = struct.Struct("<QQ")  # stored and decoded bytes
_RECORD: Final = struct.Struct("<II")  # type, payload bytes

# Extensions are camera limits and the like; what is larger than this is none.
_MAX_EXTENSION_BYTES: Final = 1 << 20

# Deflate never does better than 1032:1 (zlib's technical notes).
_MAX_DEFLATE_RATIO: Final = 1032

_ZSTD_MAGIC: Final = bytes.fromhex("28b52ffd")  # RFC 8878, 3.1.1

# Level 15 takes eight times as long as 12 on SH of a million splats and saves 3 % of the file.
_ZSTD_LEVEL: Final = 12
_ZLIB_LEVEL: Final = 6
# zlib's default. With 9, the most there is, deflate ends its blocks later, and files of three
# trained scenes were 0.2 to 1.1 % larger.
_ZLIB_MEMORY: Final = 8


@dataclass(frozen=True)
class SpzHeader:
    """The header of an SPZ file.

    Parameters
    ----------
    version : int
        1 to 4.
    count : int
        Splats.
    sh_degree : int
        0 to 4.
    fractional_bits : int
        Of 24-bit positions; version 1 has half floats.
    flags : int
        `FLAG_ANTIALIASED` and others.
    """

    version: int
    count: int
    sh_degree: int
    fractional_bits: int
    flags: int

    @property
    def row_bytes(self) -> tuple[int, ...]:
        """Bytes per splat of each of `STREAMS`."""
        return (
            6 if self.version == 1 else 9,
            1,
            3,
            3,
            4 if self.version >= 3 else 3,
            3 * ((self.sh_degree + 1) ** 2 - 1),
        )


@dataclass(frozen=True, eq=False)
class SpzFile:
    """The parts of an SPZ file: header, streams, extensions.

    Parameters
    ----------
    header : SpzHeader
    extensions : tuple of (int, bytes)
        Type and payload of each record.
    streams : tuple of (count, row bytes) uint8
        Values as stored, in the order of `STREAMS`.
    """

    header: SpzHeader
    extensions: tuple[tuple[int, bytes], ...]
    streams: tuple[U8, ...]


def is_spz(head: bytes) -> bool:
    """Tell whether a file is SPZ of any version by its first bytes."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(31).decompress(head, _HEADER.size)
        except zlib.error:
            return False
    return head.startswith(MAGIC)


def unpack(data: bytes, where: str, limits: Limits) -> SpzFile:
    """Split an SPZ file into header, streams and extensions.

    Parameters
    ----------
    data : bytes
        All of it.
    where : str
        Names the file in messages.
    limits : Limits
        What the file may cost, arrays that are made of its values included.

    Raises
    ------
    FormatError
        ``spz-magic``, ``spz-bad-sh``, ``spz-fractional-bits``, ``spz-gzip``, ``spz-toc``,
        ``spz-zstd``, ``spz-extension``, ``spz-trailing-bytes``.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    TruncatedError
        ``spz-truncated``.
    UnsupportedError
        ``spz-version``, ``spz-lod-tree``.
    """
    if data.startswith(GZIP_MAGIC):
        return _unpack_gzip(data, where, limits)
    if not MAGIC.startswith(data[:4]):
        raise FormatError(
            "spz-magic",
            f"{where}: starts with {data[:4].hex(' ') or 'nothing'}, expected "
            f"{GZIP_MAGIC.hex(' ')} (gzip) or {MAGIC.hex(' ')}",
        )
    return _unpack_zstd(memoryview(data), where, limits)


def _header(head: bytes, where: str, versions: range) -> SpzHeader:
    if len(head) < _HEADER.size:
        raise TruncatedError(
            "spz-truncated", f"{where}: {len(head)} bytes, expected a header of {_HEADER.size}"
        )
    magic, version, count, degree, bits, flags, _ = _HEADER.unpack_from(head)
    if magic != MAGIC:
        raise FormatError(
            "spz-magic",
            f"{where}: the gzip member starts with {magic.hex(' ')}, expected {MAGIC.hex(' ')}",
        )
    if version not in versions:
        raise UnsupportedError(
            "spz-version",
            f"{where}: version {version} in this wrapping, expected "
            f"{versions.start} to {versions.stop - 1}",
        )
    if degree > MAX_SH_DEGREE:
        raise FormatError(
            "spz-bad-sh", f"{where}: SH degree {degree}, expected 0 to {MAX_SH_DEGREE}"
        )
    if bits > MAX_FRACTIONAL_BITS:
        raise FormatError(
            "spz-fractional-bits",
            f"{where}: {bits} fractional bits, expected 0 to {MAX_FRACTIONAL_BITS}",
        )
    if flags & FLAG_LOD_TREE:
        raise UnsupportedError(
            "spz-lod-tree",
            f"{where}: holds a tree of levels of detail (flag {FLAG_LOD_TREE:#x}), "
            "expected plain splats",
        )
    return SpzHeader(version, count, degree, bits, flags)


def _check_cost(
    header: SpzHeader, limits: Limits, file_bytes: int, where: str, *, copies: int
) -> None:
    """Refuse a scene whose values and arrays take more than its file may cost."""
    limits.require_scene(
        header.count,
        sh_degree=min(header.sh_degree, splats.MAX_SH_DEGREE),
        source_bytes=file_bytes,
        where=where,
        beside_bytes=copies * header.count * sum(header.row_bytes),
    )


def _unpack_gzip(data: bytes, where: str, limits: Limits) -> SpzFile:
    # 31: a window of 2^15 and a gzip wrapping, whose CRC is checked at the end.
    inflater = zlib.decompressobj(31)
    try:
        header = _header(inflater.decompress(data, _HEADER.size), where, range(1, 4))
        sizes = [header.count * row for row in header.row_bytes]
        if sum(sizes) > _MAX_DEFLATE_RATIO * len(data):
            raise TruncatedError(
                "spz-truncated",
                f"{where}: {len(data)} bytes cannot hold the {sum(sizes)} bytes of "
                f"{header.count} splats",
            )
        # Inflated twice at once: zlib's pieces, and what they are joined to.
        _check_cost(header, limits, len(data), where, copies=2)
        body = inflater.decompress(inflater.unconsumed_tail, sum(sizes)) if sum(sizes) else b""
        rest = inflater.decompress(inflater.unconsumed_tail, _MAX_EXTENSION_BYTES)
    except zlib.error as error:
        raise FormatError("spz-gzip", f"{where}: {error}, expected a sound gzip member") from error
    if len(body) < sum(sizes):
        raise TruncatedError(
            "spz-truncated",
            f"{where}: {len(body)} bytes of values, expected {sum(sizes)} for "
            f"{header.count} splats",
        )
    if len(rest) == _MAX_EXTENSION_BYTES:
        raise FormatError(
            "spz-trailing-bytes",
            f"{where}: {len(rest)} bytes and more behind the values, expected fewer",
        )
    if not inflater.eof:
        raise TruncatedError("spz-truncated", f"{where}: the gzip member has no end")
    if inflater.unused_data:
        raise FormatError(
            "spz-trailing-bytes",
            f"{where}: {len(inflater.unused_data)} bytes behind the gzip member, expected none",
        )
    extensions: tuple[tuple[int, bytes], ...] = ()
    if header.flags & FLAG_EXTENSIONS:
        extensions = _records(memoryview(rest), where)
    elif rest and not _unknown_flags(header):
        raise FormatError(
            "spz-trailing-bytes",
            f"{where}: {len(rest)} bytes behind the values that no flag announces, expected none",
        )
    whole = np.frombuffer(body, np.uint8)
    ends = np.cumsum(sizes)[:-1]
    streams = [
        part.reshape(header.count, row)
        for part, row in zip(np.split(whole, ends), header.row_bytes, strict=True)
    ]
    return SpzFile(header, extensions, tuple(streams))


def _unknown_flags(header: SpzHeader) -> int:
    return header.flags & ~(FLAG_ANTIALIASED | FLAG_EXTENSIONS)


def _unpack_zstd(data: memoryview, where: str, limits: Limits) -> SpzFile:
    header = _header(bytes(data[: _HEADER.size]), where, range(4, 5))
    if len(data) < _HEADER_4.size:
        raise TruncatedError(
            "spz-truncated", f"{where}: {len(data)} bytes, expected a header of {_HEADER_4.size}"
        )
    *_, num_streams, toc = _HEADER_4.unpack_from(data)
    # Streams without bytes are left out.
    rows = [(name, row) for name, row in zip(STREAMS, header.row_bytes, strict=True) if row]
    if not header.count and not num_streams:
        rows = []
    if num_streams != len(rows):
        raise FormatError(
            "spz-toc",
            f"{where}: {num_streams} streams for SH degree {header.sh_degree}, "
            f"expected {len(rows)}",
        )
    start = toc + num_streams * _TOC_ENTRY.size
    if toc < _HEADER_4.size:
        raise FormatError(
            "spz-toc",
            f"{where}: table of contents at byte {toc}, expected {_HEADER_4.size} or more",
        )
    if start > len(data):
        raise TruncatedError(
            "spz-truncated",
            f"{where}: {len(data)} bytes, expected a table of contents up to byte {start}",
            needed=start,
        )
    extensions: tuple[tuple[int, bytes], ...] = ()
    if header.flags & FLAG_EXTENSIONS:
        extensions = _records(data[_HEADER_4.size : toc], where)
    parts: list[tuple[str, memoryview, int]] = []
    for k, (name, row) in enumerate(rows):
        stored, decoded = _TOC_ENTRY.unpack_from(data, toc + k * _TOC_ENTRY.size)
        if decoded != header.count * row:
            raise FormatError(
                "spz-toc",
                f"{where}: {name} of {decoded} bytes, expected {header.count * row} for "
                f"{header.count} splats",
            )
        if start + stored > len(data):
            raise TruncatedError(
                "spz-truncated",
                f"{where}: {name} ends at byte {start + stored}, expected an end at or before "
                f"{len(data)}, where the file does",
                needed=start + stored,
            )
        parts.append((name, data[start : start + stored], decoded))
        start += stored
    if start != len(data):
        raise FormatError(
            "spz-trailing-bytes",
            f"{where}: {len(data) - start} bytes behind the streams, expected none",
        )
    _check_cost(header, limits, len(data), where, copies=1)
    streams = {name: np.empty((header.count, 0), np.uint8) for name in STREAMS}
    # The largest first, so that it is not what the others wait for.
    parts.sort(key=lambda part: -part[2])
    decoded_parts = ordered_map(
        lambda part: _inflate(part[1], part[2], f"{where}: {part[0]}"), parts, thread_count(0)
    )
    for (name, _, size), values in zip(parts, decoded_parts, strict=True):
        streams[name] = values.reshape(header.count, size // header.count if header.count else 0)
    return SpzFile(header, extensions, tuple(streams[name] for name in STREAMS))


def _inflate(stored: memoryview, size: int, where: str) -> U8:
    # Skippable and legacy frames have other magic numbers, and zstd would accept the first.
    if bytes(stored[:4]) != _ZSTD_MAGIC:
        raise FormatError(
            "spz-zstd",
            f"{where}: starts with {bytes(stored[:4]).hex()}, expected {_ZSTD_MAGIC.hex()}",
        )
    try:
        frame = zstandard.get_frame_parameters(stored)
        # Before anything is allocated; a frame that states no size is held to the table's.
        if frame.content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN) or frame.dict_id:
            raise FormatError(
                "spz-zstd",
                f"{where}: a frame of {frame.content_size} bytes with dictionary {frame.dict_id}, "
                f"expected {size} bytes and none",
            )
        values = zstandard.ZstdDecompressor().decompress(
            stored, max_output_size=size, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise FormatError("spz-zstd", f"{where}: {error}, expected a sound frame") from error
    if len(values) != size:
        raise FormatError("spz-zstd", f"{where}: {len(values)} bytes, expected {size}")
    return np.frombuffer(values, np.uint8)


def _records(zone: memoryview, where: str) -> tuple[tuple[int, bytes], ...]:
    if len(zone) > _MAX_EXTENSION_BYTES:
        raise FormatError(
            "spz-extension",
            f"{where}: {len(zone)} bytes of extensions, expected at most {_MAX_EXTENSION_BYTES}",
        )
    records = []
    at = 0
    while at < len(zone):
        if at + _RECORD.size > len(zone):
            raise FormatError(
                "spz-extension",
                f"{where}: {len(zone) - at} bytes left for an extension record, "
                f"expected {_RECORD.size}",
            )
        kind, length = _RECORD.unpack_from(zone, at)
        at += _RECORD.size
        if at + length > len(zone):
            raise FormatError(
                "spz-extension",
                f"{where}: extension {kind:#010x} of {length} bytes, expected at most "
                f"{len(zone) - at}",
            )
        records.append((kind, bytes(zone[at : at + length])))
        at += length
    return tuple(records)


def pack(header: SpzHeader, streams: Sequence[U8]) -> list[bytes]:
    """Wrap streams as version 2, 3 or 4, without extensions.

    Parameters
    ----------
    header : SpzHeader
        Version 2, 3 or 4.
    streams : sequence of (count, row bytes) uint8
        In the order of `STREAMS`.

    Returns
    -------
    list of bytes
        The file in pieces; the same for the same input, whatever the number of threads.
    """
    fields = (MAGIC, header.version, header.count, header.sh_degree, header.fractional_bits)
    if header.version < 4:
        deflater = zlib.compressobj(_ZLIB_LEVEL, zlib.DEFLATED, 31, _ZLIB_MEMORY)
        pieces = [deflater.compress(_HEADER.pack(*fields, header.flags, 0))]
        pieces += [deflater.compress(stream.tobytes()) for stream in streams]
        return [*pieces, deflater.flush()]
    full = [stream for stream in streams if stream.size]
    # Checksums and stated sizes let readers find damage and allocate once.
    frames = list(
        ordered_map(
            lambda stream: zstandard.ZstdCompressor(
                level=_ZSTD_LEVEL, write_checksum=True, write_content_size=True, threads=0
            ).compress(stream.tobytes()),
            full,
            thread_count(0),
        )
    )
    toc = [_TOC_ENTRY.pack(len(f), s.size) for f, s in zip(frames, full, strict=True)]
    head = _HEADER_4.pack(*fields, header.flags, len(full), _HEADER_4.size)
    return [head, *toc, *frames]
