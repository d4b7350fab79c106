"""Conformance vectors of hand-made zstd frame headers, with each field of SPEC 6.3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cogsplat.codec.streams.records import Attribute

from . import handmade_streams as handmade
from . import worked_example
from .file_builder import build, one_chunk, payload, poke, record
from .invalid import Invalid
from .valid import Valid

_ROWS: Final = 300

# RFC 8878, 3.1.1: magic; bits of the descriptor; the content size in two bytes, less 256; one RLE
# block, the last, of zeros.
_MAGIC: Final = bytes.fromhex("28b52ffd")
_SIZE_IN_2: Final = 0x40
_SINGLE_SEGMENT: Final = 0x20
_UNUSED_BIT: Final = 0x10
_RESERVED_BIT: Final = 0x08
_SMALLEST_WINDOW: Final = b"\x00"
_LARGEST_WINDOW: Final = b"\xff"
_SIZE: Final = (_ROWS - 256).to_bytes(2, "little")
_BLOCK: Final = (1 | 1 << 1 | _ROWS << 3).to_bytes(3, "little") + b"\0"


# A frame of one compressed block, 300 symbols below 8: literals in four streams, and no sequence.
_LITERALS: Final = bytes.fromhex(
    "28b52ffd602c003d0300c6d2188664443210160018001600f106b23fd107b03881e19795458d03fc9949540e1904"
    "578893d69c6750264254385a267015d1c9504d5a6432886cb7c66ac84971825d801e8f5090cb0142539eb726ea79"
    "3a1626af6448be8ee6e7efe99c90353b04d8d40a00"
)
# Offsets of the block's literal count and sequence count.
_LITERALS_AT: Final = 11
_SEQUENCES_AT: Final = 112


def _file(frame: bytes, rows: int = _ROWS) -> bytes:
    """Return a file whose plane of opacities is stored as the given zstd frame."""
    opacities = handmade.scalar(Attribute.OPACITIES, [(-2.0, 2.0, 8)], [[0] * rows])
    head = handmade.uniform_head(rows, opacities)
    records = [record(stream) for stream in head]
    place = handmade.stream_index(head, Attribute.OPACITIES)
    records[place].planes = [(len(frame) | 1 << 31, frame)]
    return build(one_chunk(payload(records), rows))


# Enough symbols for libzstd to decode two codes at once; an odd number in each of four streams.
_HUFFMAN_ROWS: Final = 4 * 1023


def _huffman_frame(tree: bytes, streams: Sequence[bytes], rows: int) -> bytes:
    """Return a zstd frame of one block of Huffman literals.

    Parameters
    ----------
    tree : bytes
        Description of the Huffman code.
    streams : sequence of bytes
        One or four Huffman streams.
    rows : int
        Number of literals, which is the decompressed size in bytes.
    """
    table = b"".join(len(stream).to_bytes(2, "little") for stream in streams[:-1])
    section = tree + table + b"".join(streams)
    size_format, bits, header_bytes = (0, 10, 3) if len(streams) == 1 else (2, 14, 4)
    header = 2 | size_format << 2 | rows << 4 | len(section) << (4 + bits)
    block = header.to_bytes(header_bytes, "little") + section + b"\0"
    return (
        _MAGIC
        + bytes([_SIZE_IN_2 | _SINGLE_SEGMENT])
        + (rows - 256).to_bytes(2, "little")
        + (1 | 2 << 1 | len(block) << 3).to_bytes(3, "little")
        + block
    )


# RFC 8878, 4.2.1.1: weights of the first of two symbols, in half a byte; codes of one bit.
_TWO_SYMBOLS: Final = b"\x80\x10"
_NO_LONGEST_CODE: Final = b"\x80\x20"


def _zeros(bits: int) -> bytes:
    """Return a Huffman stream of a number of zero bits, with its end mark."""
    return (1 << bits).to_bytes(bits // 8 + 1, "little")


def _file_of_streams(first: bytes) -> bytes:
    """Return a file of 4,092 splats, with opacities in four Huffman streams, `first` and zeros."""
    frame = _huffman_frame(_TWO_SYMBOLS, [first, *[_zeros(1023)] * 3], _HUFFMAN_ROWS)
    return _file(frame, _HUFFMAN_ROWS)


# RFC 8878, 3.1.1.2: the last block, raw and of 0 bytes, and an RLE block of 3.
_EMPTY: Final = _MAGIC + bytes([_SINGLE_SEGMENT, 0])
_NO_BYTES: Final = b"\x01\0\0"
_THREE_BYTES: Final = (1 | 1 << 1 | 3 << 3).to_bytes(3, "little") + b"\0"


def _file_of_empty(frame: bytes) -> bytes:
    """Return a file in which the given zstd frame stores a plane of 0 bytes."""
    quats = worked_example.swing_twist_record()
    place = next(i for i, (_, stored) in enumerate(quats.planes) if not stored)
    quats.planes[place] = (len(frame) | 1 << 31, frame)
    return worked_example.with_quats(quats)


def valid() -> list[Valid]:
    """Return the valid vectors of zstd frame headers that encoders seldom write."""

    def good(name: str, frame: bytes, note: str) -> Valid:
        return Valid(name, _file(frame), ("6.3",), note)

    unused = bytes([_SIZE_IN_2 | _SINGLE_SEGMENT | _UNUSED_BIT])
    # 2^23 bytes: exponent 13.
    window = bytes([13 << 3])
    return [
        good("frame-unused-bit", _MAGIC + unused + _SIZE + _BLOCK,
             "the unused bit of a frame header set: decoders ignore it"),
        good("frame-window-8m", _MAGIC + bytes([_SIZE_IN_2]) + window + _SIZE + _BLOCK,
             "the largest window that is allowed"),
        Valid("frame-huffman", _file_of_streams(_zeros(1023)), ("6.3",),
              "four Huffman streams of 1,023 codes of one bit"),
        Valid("frame-empty", _file_of_empty(_EMPTY + _NO_BYTES), ("6.3",),
              "a plane of 0 bytes in a zstd frame"),
    ]  # fmt: skip


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of zstd frame headers and of Huffman streams."""

    def bad(name: str, frame: bytes, code: str, note: str) -> Invalid:
        return Invalid(name, _file(frame), f"zstd-{code}", "6.3", note, "decode")

    def frame(descriptor: int, fields: bytes) -> bytes:
        return _MAGIC + bytes([_SIZE_IN_2 | descriptor]) + fields + _BLOCK

    def bad_empty(name: str, frame: bytes, note: str) -> Invalid:
        return Invalid(name, _file_of_empty(frame), "zstd-frame", "6.3", note, "decode")

    def bad_stream(name: str, first: bytes, note: str) -> Invalid:
        return Invalid(name, _file_of_streams(first), "zstd-frame", "6.3", note, "verify")

    no_longest = _huffman_frame(_NO_LONGEST_CODE, [_zeros(_ROWS)], _ROWS)
    one_window = bytes([13 << 3 | 1])
    whole = frame(0, _SMALLEST_WINDOW + _SIZE)
    return [
        bad("zstd-magic-only", whole[:4], "frame", "the magic number alone"),
        bad("zstd-header-cut", whole[:7], "frame", "ends inside the content size"),
        bad_empty("zstd-empty-header", _EMPTY, "a plane of 0 bytes, its frame cut to the header"),
        bad_empty("zstd-empty-behind", _EMPTY + _NO_BYTES + b"\0",
                  "a plane of 0 bytes, and a byte behind its frame"),
        bad_empty("zstd-empty-more", _EMPTY + _THREE_BYTES,
                  "a frame that states 0 bytes and holds 3"),
        bad("zstd-reserved-bit", frame(_RESERVED_BIT, _SMALLEST_WINDOW + _SIZE), "frame",
            "the reserved bit of the descriptor set"),
        bad("zstd-literals-many", poke(_LITERALS, _LITERALS_AT, "B", 0xF2), "frame",
            "a block of 812 literals in a frame of 300 bytes"),
        bad("zstd-sequence-cut", poke(_LITERALS, _SEQUENCES_AT, "B", 1), "frame",
            "a block that states a sequence and ends"),
        bad("zstd-huffman-weights", no_longest, "frame", "a Huffman code in which no weight is 1"),
        bad_stream("zstd-huffman-left", _zeros(1024), "a Huffman stream of a bit more"),
        bad_stream("zstd-huffman-beyond", _zeros(1022), "a Huffman stream of a bit less"),
        bad_stream("zstd-huffman-mark", bytes(128), "a Huffman stream without the mark of its end"),
        bad("zstd-window-8m", frame(0, one_window + _SIZE), "window", "a window of 9 MiB"),
        bad("zstd-window-2-41", frame(0, _LARGEST_WINDOW + _SIZE), "window",
            "the largest window that a header can state, 3.75 TiB"),
        bad("zstd-dictionary-0", frame(1, _SMALLEST_WINDOW + b"\0" + _SIZE), "dictionary",
            "a dictionary field of one byte that holds 0"),
        bad("zstd-dictionary-0-4", frame(3, _SMALLEST_WINDOW + bytes(4) + _SIZE), "dictionary",
            "a dictionary field of four bytes that holds 0"),
        bad("zstd-size-first", frame(1, _LARGEST_WINDOW + b"\x07" + b"\0\0"), "size",
            "another content size, too large a window and a dictionary: the size comes first"),
        bad("zstd-window-first", frame(1 | 4, _LARGEST_WINDOW + b"\x07" + _SIZE), "window",
            "too large a window, a dictionary and a checksum: the window comes first"),
        bad("zstd-dictionary-first", frame(1 | 4, _SMALLEST_WINDOW + b"\x07" + _SIZE),
            "dictionary", "a dictionary and a checksum: the dictionary comes first"),
    ]  # fmt: skip
