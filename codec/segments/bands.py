"""SH bands as streams of numbers, in tails and in colour codebooks (SPEC 7.1, 7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams.records import SH_BANDS

from .stream_set import StreamSet

F32 = NDArray[np.float32]


def read_band(found: StreamSet, band: int, out: F32, *, kept: bool = False) -> None:
    """Fill one band of (n, K-1, 3) `out`: zeros where the stream is absent, nothing if K is low."""
    attribute = SH_BANDS[band - 1]
    first, last = band * band - 1, (band + 1) * (band + 1) - 1
    wanted = out.shape[1] >= last
    if not found.has(attribute, kept=kept):
        if wanted:
            out[:, first:last] = 0
        return
    stream = found.take_kept(attribute, len(out)) if kept else found.take(attribute)
    if wanted:
        values = np.empty((len(out), (last - first) * 3), np.float32)
        stream.read_numbers(values)
        out[:, first:last] = values.reshape(len(out), last - first, 3)
