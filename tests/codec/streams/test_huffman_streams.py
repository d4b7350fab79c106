"""Huffman streams of libzstd's frames end with their last code; others are refused on request."""

from contextlib import nullcontext, suppress

import numpy as np
import pytest
import zstandard

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams.zstd_frames import decompress, exact_streams


def compressed(raw: bytes, level: int) -> bytes:
    compressor = zstandard.ZstdCompressor(
        level=level, write_checksum=False, write_content_size=True, threads=0
    )
    return compressor.compress(raw)


@pytest.mark.parametrize("level", [1, 3, 9, 17])
@pytest.mark.parametrize("rows", [40, 300, 5000, 300_000])
def test_frames_of_libzstd_are_exact(level: int, rows: int) -> None:
    rng = np.random.default_rng(rows)
    for symbols in (2, 5, 60, 250):
        shares = rng.random(symbols) ** 4
        plane = rng.choice(symbols, rows, p=shares / shares.sum()).astype(np.uint8)
        # Runs give blocks with sequences between their literals.
        for raw in (plane.tobytes(), np.repeat(plane, 3)[:rows].tobytes()):
            with exact_streams():
                assert decompress(memoryview(compressed(raw, level)), rows, "a plane") == raw


def test_a_changed_stream_is_refused_only_on_request() -> None:
    """Whatever bit of the streams changes, an exact reader accepts no more than another reader."""
    rng = np.random.default_rng(1)
    raw = rng.choice(6, 4000, p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]).astype(np.uint8).tobytes()
    frame = compressed(raw, 17)
    verdicts = set()
    for at in range(len(frame) - 600, len(frame)):
        changed = bytearray(frame)
        changed[at] ^= 1 << at % 8
        verdicts.add((is_read(bytes(changed), exact=False), is_read(bytes(changed), exact=True)))
    assert verdicts == {(True, True), (True, False), (False, False)}


def is_read(frame: bytes, *, exact: bool) -> bool:
    with exact_streams() if exact else nullcontext(), suppress(FormatError):
        decompress(memoryview(frame), 4000, "a plane")
        return True
    return False


def test_the_check_ends_with_its_block() -> None:
    # Two symbols of a bit each, four streams of 1,023 codes, the first with a bit too many.
    first, other = (1 << 1024).to_bytes(129, "little"), (1 << 1023).to_bytes(128, "little")
    section = b"\x80\x10" + b"\x81\0\x80\0\x80\0" + first + 3 * other
    block = (2 | 2 << 2 | 4092 << 4 | len(section) << 18).to_bytes(4, "little") + section + b"\0"
    header = bytes.fromhex("28b52ffd60") + (4092 - 256).to_bytes(2, "little")
    frame = memoryview(header + (5 | len(block) << 3).to_bytes(3, "little") + block)
    with pytest.raises(FormatError, match="Huffman"), exact_streams():
        decompress(frame, 4092, "a plane")
    assert decompress(frame, 4092, "a plane") == bytes(4092)
