"""Positions of the byte planes in one payload, before decompression (SPEC 6.1, 6.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .byte_planes import LENGTH_MASK

I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class StoredPlanes:
    """Byte planes of one payload as stored, before decompression, with their positions.

    Parameters
    ----------
    payload : memoryview
        Bytes of the segment.
    words : (p,) uint32
        Word of each plane: its stored length and flags (SPEC 6.3).
    ends : (p,) int64
        End of each plane in the payload, bytes; the next plane begins there.
    """

    payload: memoryview
    words: U32
    ends: I64

    def body(self, index: int) -> memoryview:
        """Return the stored bytes of one plane."""
        end = int(self.ends[index])
        return self.payload[end - (int(self.words[index]) & LENGTH_MASK) : end]


def locate(payload: memoryview, words: U32, start: int) -> StoredPlanes:
    """Locate consecutive planes of a payload.

    Parameters
    ----------
    payload : memoryview
        Bytes of the segment.
    words : (p,) uint32
        Stored length and flags of each plane.
    start : int
        Position of the first plane. The caller checks that the last one ends within the payload.
    """
    lengths = (words & np.uint32(LENGTH_MASK)).astype(np.int64)
    return StoredPlanes(payload, words, start + np.cumsum(lengths))
