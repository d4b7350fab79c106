"""SPZ container: header, extension records, and six compressed streams of values.

Source: the format's public description (github.com/nianticlabs/spz, README and extensions/README).
Versions 1 to 3 are one gzip member with header, streams and extensions. Version 4 has an
uncompressed header, extensions, a table of contents, and one zstd frame per stream.
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
"""Flag of Spark's tree of levels of detail, whose coarse splats overlap fine ones."""

STREAMS: Final = ("positions", "alphas", "colors", "scales", "rotations", "sh")
"""Names of the streams, in file order."""

MAX_SH_DEGREE: Final = 4

MAX_FRACTIONAL_BITS: Final = 30
"""Limit on fractional bits: the reference shifts a 32-bit 1 by their number."""

# Header of all versions: magic, version, splats, SH degree, fractional bits, flags, and in version
# 4 the number of streams (reserved in earlier versions).
_HEADER: Final = struct.Struct("<4sIIBBBB")
# Header of version 4: the same, then the offset of the table of contents and 12 reserved bytes.
_HEADER_4: Final = struct.Struct("<4sIIBBBBI12x")
_TOC_ENTRY: Final = struct.Struct("<QQ")  # compressed and decompressed bytes
_RECORD: Final = struct.Struct("<II")  # type, payload bytes

# Limit on all extensions of a file together; known ones hold camera limits or a georeference.
_MAX_EXTENSION_BYTES: Final = 1 << 20

# The best ratio of deflate is 1032:1 (zlib's technical notes).
_MAX_DEFLATE_RATIO: Final = 1032

_ZSTD_MAGIC: Final = bytes.fromhex("28b52ffd")  # RFC 8878, 3.1.1

# On the SH of a million splats, level 15 took eight times as long as 12 and saved 3 % of the file.
_ZSTD_LEVEL: Final = 12
_ZLIB_LEVEL: Final = 6
# zlib's default memory level. The maximum, 9, made files of three trained scenes 0.2 to 1.1 %
# larger, because deflate ends its blocks later.
_ZLIB_MEMORY: Final = 8


@dataclass(frozen=True)
class SpzHeader:
    """The header of an SPZ file.

    Parameters
    ----------
    version : int
        Version of the file, 1 to 4.
    count : int
        Number of splats.
    sh_degree : int
        SH degree, 0 to 4.
    fractional_bits : int
        Fractional bits of the 24-bit positions; unused in version 1, which stores half floats.
    flags : int
        Bit field of `FLAG_ANTIALIASED`, `FLAG_EXTENSIONS`, `FLAG_LOD_TREE`.
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
        Parsed header.
    extensions : tuple of (int, bytes)
        Type and payload of each extension record.
    streams : tuple of (count, row bytes) uint8
        Decompressed streams, in the order of `STREAMS`.
    """

    header: SpzHeader
    extensions: tuple[tuple[int, bytes], ...]
    streams: tuple[U8, ...]


def is_spz(head: bytes) -> bool:
    """Return whether a file that begins with `head` is SPZ of any version."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(31).decompress(head, _HEADER.size)
        except zlib.error:
            return False
    return head.startswith(MAGIC)


def unpack(data: bytes, where: str, limits: Limits) -> SpzFile:
    """Parse an SPZ file and decompress its streams.

    Parameters
    ----------
    data : bytes
        The whole file.
    where : str
        Name of the file for messages.
    limits : Limits
        Limits on splats and decoded bytes, including the arrays of the scene.

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
    """Parse and check the header; `versions` is the range valid for the file's compression."""
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
            f"{where}: version {version}, expected "
            f"{versions.start} to {versions.stop - 1} for this compression",
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
    """Check a scene's arrays and `copies` of its streams against the limits."""
    limits.require_scene(
        header.count,
        sh_degree=min(header.sh_degree, splats.MAX_SH_DEGREE),
        source_bytes=file_bytes,
        where=where,
        extra_bytes=copies * header.count * sum(header.row_bytes),
    )


def _unpack_gzip(data: bytes, where: str, limits: Limits) -> SpzFile:
    """Parse a file of version 1 to 3."""
    # 31 means a window of 2^15 bytes and a gzip member, whose CRC is checked.
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
        # Two copies at the peak: zlib's pieces, and the bytes that they are joined to.
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
            f"{where}: {len(rest)} bytes or more behind the values, expected fewer",
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
    """Return the flags of a header without the known ones."""
    return header.flags & ~(FLAG_ANTIALIASED | FLAG_EXTENSIONS)


def _unpack_zstd(data: memoryview, where: str, limits: Limits) -> SpzFile:
    """Parse a file of version 4."""
    header = _header(bytes(data[: _HEADER.size]), where, range(4, 5))
    if len(data) < _HEADER_4.size:
        raise TruncatedError(
            "spz-truncated", f"{where}: {len(data)} bytes, expected a header of {_HEADER_4.size}"
        )
    *_, num_streams, toc = _HEADER_4.unpack_from(data)
    # Empty streams are not stored.
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
                f"{where}: {name} ends at byte {start + stored}, expected an end within the "
                f"{len(data)} bytes of the file",
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
    # Largest stream first, so that its thread does not finish last.
    parts.sort(key=lambda part: -part[2])
    decoded_parts = ordered_map(
        lambda part: _decompress(part[1], part[2], f"{where}: {part[0]}"), parts, thread_count(0)
    )
    for (name, _, size), values in zip(parts, decoded_parts, strict=True):
        streams[name] = values.reshape(header.count, size // header.count if header.count else 0)
    return SpzFile(header, extensions, tuple(streams[name] for name in STREAMS))


def _decompress(stored: memoryview, size: int, where: str) -> U8:
    """Decompress one zstd frame of `size` decompressed bytes."""
    # zstd would accept a skippable frame, which has another magic number.
    if bytes(stored[:4]) != _ZSTD_MAGIC:
        raise FormatError(
            "spz-zstd",
            f"{where}: starts with {bytes(stored[:4]).hex()}, expected {_ZSTD_MAGIC.hex()}",
        )
    try:
        frame = zstandard.get_frame_parameters(stored)
        # Checked before any allocation. A frame may omit its size; the table of contents has it.
        if frame.content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN) or frame.dict_id:
            raise FormatError(
                "spz-zstd",
                f"{where}: a frame of {frame.content_size} bytes with dictionary {frame.dict_id}, "
                f"expected {size} bytes and no dictionary",
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
    """Split the bytes of all extensions into types and payloads."""
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
    """Compress streams into an SPZ file of version 2, 3 or 4, without extensions.

    Parameters
    ----------
    header : SpzHeader
        Header with version 2, 3 or 4.
    streams : sequence of (count, row bytes) uint8
        Uncompressed streams, in the order of `STREAMS`.

    Returns
    -------
    list of bytes
        Consecutive pieces of the file; equal for any number of threads.
    """
    fields = (MAGIC, header.version, header.count, header.sh_degree, header.fractional_bits)
    if header.version < 4:
        deflater = zlib.compressobj(_ZLIB_LEVEL, zlib.DEFLATED, 31, _ZLIB_MEMORY)
        pieces = [deflater.compress(_HEADER.pack(*fields, header.flags, 0))]
        pieces += [deflater.compress(stream.tobytes()) for stream in streams]
        return [*pieces, deflater.flush()]
    full = [stream for stream in streams if stream.size]
    # A reader detects damage by the checksum, and allocates once by the stated size.
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
