"""Streams packed into a payload and read back; errors say ``head 5``."""

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import kinds
from cogsplat.codec.streams import records as streams
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import COMPONENTS


def stored(*given_streams, max_rows=1 << 18):
    """The streams as a reader has them."""
    payload = streams.pack(given_streams)
    return streams.unpack(memoryview(payload), "head 5", max_rows)


def numbers(stream):
    """Values of a stream, as many components as its attribute has."""
    (one,) = stored(stream)
    out = np.full((one.rows, COMPONENTS[one.attribute]), np.nan, np.float32)
    kinds.read(one, out)
    return out


def refused(call, code, clause=None, kind=FormatError):
    """Call something that must raise this reason code."""
    with pytest.raises(kind, match="head 5") as caught:
        call()
    assert caught.value.code == code
    if clause:
        assert caught.value.clause == clause


def grid_of(levels, low=0.0, high=1.0):
    """A grid of one range and these numbers of levels."""
    return Grid(
        np.full(len(levels), low, np.float32),
        np.full(len(levels), high, np.float32),
        np.array(levels, np.uint32),
    )
