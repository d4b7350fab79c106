"""Float streams: float32 values, one plane for each byte (SPEC 6.8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from .grid import MAX_VALUE
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]


def write(attribute: Attribute, values: F32) -> Stream:
    """Return a float stream of (n, c) float32 values, four planes for each component."""
    # Always little-endian in the file.
    octets = np.ascontiguousarray(values, "<f4").view(np.uint8).reshape(len(values), -1)
    planes = [np.ascontiguousarray(octets[:, column]) for column in range(octets.shape[1])]
    return Stream(attribute, Kind.FLOAT, len(values), b"", planes)


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode the values of a float stream into (rows, c) float32 `out`; it needs no `inputs`.

    Raises
    ------
    FormatError
        ``stream-params``, ``stream-planes``; ``float-value``: NaN, or a magnitude above 2^100.
        Opacities may be infinite.
    """
    stream.require_params(0)
    stream.require_planes(4 * out.shape[1])
    for component in range(out.shape[1]):
        planes = [stream.plane(4 * component + byte, stream.rows) for byte in range(4)]
        values = np.stack(planes, axis=1).view("<f4")[:, 0]
        legal = np.abs(values) <= MAX_VALUE
        if stream.attribute == Attribute.OPACITIES:
            legal |= np.isinf(values)
        if not legal.all():
            raise FormatError(
                "float-value",
                f"{stream.where}, component {component}: NaN, or a magnitude above {MAX_VALUE:g}",
                clause="6.8",
            )
        out[:, component] = values
