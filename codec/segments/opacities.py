"""Opacities of a chunk at a later level of the scene (SPEC 5.11, 7.5)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import kinds, opacity_differences, records, scalar
from cogsplat.codec.streams.records import Attribute

from .stream_set import StreamSet

F32 = NDArray[np.float32]

MAX_LOGIT: Final = 12.0
"""Largest magnitude of stored opacities, logits: σ(12) differs from 1 by 6e-6, far below 1/255."""


def pack_opacities(opacities: F32, first: F32, step: float) -> bytes:
    """Return the payload of a chunk's opacities at a level.

    The payload stores the opacities, or their differences to the head, whichever is smaller.

    Parameters
    ----------
    opacities : (n,) float32
        Logits at the level, in stored order.
    first : (n,) float32
        Logits decoded from the chunk's head and refinement.
    step : float
        Largest distance between stored values, logits.

    Examples
    --------
    >>> import numpy as np
    >>> first = np.linspace(-4, 4, 100, dtype=np.float32)
    >>> len(pack_opacities(first + 1, first, 0.1)) < len(pack_opacities(first, first * 0, 0.1))
    True
    """
    values = np.clip(opacities, -MAX_LOGIT, MAX_LOGIT)[:, None]
    differences = values - first[:, None]
    plain = scalar.write(Attribute.OPACITIES, values, grids.fit(values, step))
    parts = [records.pack([plain])]
    if np.isfinite(differences).all():
        added = opacity_differences.write(differences, grids.fit(differences, step))
        parts.append(records.pack([added]))
    return min(parts, key=len)


def decode_opacities(payload: memoryview, out: F32, where: str) -> None:
    """Replace the opacities of a chunk, in place, by its opacities at a finer level of detail.

    Parameters
    ----------
    payload : memoryview
        Bytes of the segment, its CRC already checked.
    out : (n,) float32
        On input, logits decoded from the chunk's head and refinement.
    where : str
        Name of the segment in messages.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        The payload breaks SPEC 6 or 7.5.
    """
    found = StreamSet(payload, where, len(out), "7.5", levels=True)
    kinds.read(found.pop(Attribute.OPACITIES), out[:, None])
    found.require_empty()
