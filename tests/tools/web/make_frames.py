"""Write tools/web/test/frames.bin: zstd frames by libzstd that take every way through a decoder.

Run ``python tests/tools/web/make_frames.py``. Each frame stands behind three little-endian u32: its
length, the length of what it gives, and the CRC-32 of that.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import zstandard

SEED = 5
LEVELS = (-5, 1, 3, 9, 19)


def contents() -> list[bytes]:
    """Return bytes of many sorts: random, skewed, constant, periodic, phrases, and long."""
    rng = np.random.default_rng(SEED)
    made = []
    for size in (1, 2, 17, 100, 545, 4096):
        made.append(bytes(rng.integers(0, 256, size, dtype=np.uint8)) if size < 600 else b"")
        made.append(bytes(np.clip(rng.geometric(0.3, size), 0, 255).astype(np.uint8)))
        made.append(bytes(rng.normal(128, 6, size).astype(np.uint8)))
        made.append(bytes([7]) * size)
        made.append((b"abcabcabdhello world " * size)[:size])
        made.append(bytes(np.repeat(rng.integers(0, 256, size, dtype=np.uint8), 3)[:size]))
        phrases = bytes(rng.integers(0, 20, 500, dtype=np.uint8))
        starts, lengths = rng.integers(0, 450, 300), rng.integers(3, 60, 300)
        made.append(
            b"".join(phrases[a : a + n] for a, n in zip(starts, lengths, strict=True))[:size]
        )
    # More than one block: tables are used again, and matches reach into the blocks before.
    noise = bytes(rng.integers(0, 4, 9000, dtype=np.uint8))
    made.append(noise * 33)
    made.append(bytes(300_000))
    return [content for content in made if content]


def main() -> None:
    """Write the frames beside this file, each content at the levels that give different frames."""
    frames: dict[bytes, bytes] = {}
    for content in contents():
        for level in LEVELS:
            compressor = zstandard.ZstdCompressor(level=level, write_content_size=True)
            frame = compressor.compress(content)
            frames[frame] = struct.pack("<III", len(frame), len(content), zlib.crc32(content))
    folder = Path(__file__).resolve().parents[3] / "tools" / "web" / "test"
    with (folder / "frames.bin").open("wb") as file:
        for frame, head in frames.items():
            file.write(head + frame)


if __name__ == "__main__":
    main()
