"""Where the byte planes of one payload stand, before any is decompressed (SPEC 6.1, 6.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .byte_planes import LENGTH_MASK

I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class StoredPlanes:
    """All planes of one payload as they are stored.

    Parameters
    ----------
    payload : memoryview
        The segment's bytes.
    words : (p,) uint32
        Stored length and flags of each plane.
    ends : (p,) int64
        Where each plane ends; the next one begins there.
    """

    payload: memoryview
    words: U32
    ends: I64

    def body(self, index: int) -> memoryview:
        """Return the stored bytes of one plane."""
        end = int(self.ends[index])
        return self.payload[end - (int(self.words[index]) & LENGTH_MASK) : end]


def locate(payload: memoryview, words: U32, start: int) -> StoredPlanes:
    """Return the planes that follow each other from a byte of the payload on.

    Parameters
    ----------
    payload : memoryview
    words : (p,) uint32
    start : int
        Where the first plane begins. That the last one ends within the payload is for the caller
        to check.
    """
    lengths = (words & np.uint32(LENGTH_MASK)).astype(np.int64)
    return StoredPlanes(payload, words, start + np.cumsum(lengths))
