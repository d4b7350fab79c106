"""SH bands as streams of their own, in tails and in colour codebooks (SPEC 7.1, 7.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import kinds
from cogsplat.codec.streams.records import SH_BANDS

from .stream_set import StreamSet

F32 = NDArray[np.float32]


def read_band(found: StreamSet, band: int, out: F32, *, escape: bool = False) -> None:
    """Decode one SH band of all rows into `out`; zeros if it has no stream.

    Parameters
    ----------
    found : StreamSet
        Streams of the payload; the band's stream is removed from the set.
    band : int
        Number of the band, 1 to 3.
    out : (n, K-1, 3) float32
        Coefficients above DC. If they do not include the band, `out` stays unchanged: the band's
        stream is checked but not decoded.
    escape : bool
        Whether to read the band's escape rows.
    """
    attribute = SH_BANDS[band - 1]
    first, last = band * band - 1, (band + 1) * (band + 1) - 1
    is_needed = out.shape[1] >= last
    # Not -1 for the columns: there may be no rows.
    values = out.reshape(len(out), 3 * out.shape[1])[:, 3 * first : 3 * last]
    if not found.has(attribute, escape=escape):
        values[:] = 0
        return
    stream = found.pop_escape(attribute, len(out)) if escape else found.pop(attribute)
    if is_needed:
        kinds.read(stream, values)
