"""Heads of which a test gives some streams and the rest are constants that cost no plane."""

import numpy as np

from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.streams import records, scalar
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import COMPONENTS, Attribute, Kind, Stream

ORDER = (Attribute.SCALES, Attribute.QUATS, Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0)


def flat(components, value=0.0):
    """A grid of one level."""
    level = np.full(components, value, np.float32)
    return Grid(level, level, np.ones(components, np.uint32))


def constant(attribute, rows) -> Stream:
    """Zeros, or no rotation."""
    if attribute == Attribute.QUATS:
        return Stream(attribute, Kind.QUAT, rows, bytes(4) + flat(3).pack(), [])
    values = np.zeros((rows, COMPONENTS[attribute]), np.float32)
    return scalar.write(attribute, values, flat(COMPONENTS[attribute]))


def decode(*given: Stream) -> Splats:
    """Rows of a head of these streams; errors say ``chunk 7``."""
    rows = given[0].rows
    parts = {stream.attribute: stream for stream in given}
    payload = records.pack([parts.get(name) or constant(name, rows) for name in ORDER])
    out = empty(0, rows)
    for name in ("means", "scales", "quats", "opacities", "sh0"):
        getattr(out, name)[:] = np.nan
    decode_head(memoryview(payload), {}, out, "chunk 7")
    return out
