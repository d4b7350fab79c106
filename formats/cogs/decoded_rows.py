"""The arrays that a file's chunks are decoded into: their bytes, and how they are allocated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.codec.splats import Splats, sh_coefficients

from .root import Root

# Means, scales, quats, opacities and sh0 of one splat, float32.
_HEAD_ROW_BYTES: Final = 4 * (3 + 3 + 4 + 1 + 3)


def row_bytes(degree: int, kinds: Sequence[AttributeType] = ()) -> int:
    """Return the bytes of one decoded splat at an SH degree, with these extra attributes."""
    extras = sum(kind.row_bytes for kind in kinds)
    return _HEAD_ROW_BYTES + 12 * (sh_coefficients(degree) - 1) + extras


def allocate(rows: int, degree: int, root: Root, kinds: Sequence[AttributeType]) -> Splats:
    """Return splats whose values are not set, for so many rows of a file.

    Parameters
    ----------
    rows : int
    degree : int
        SH degree, 0 to 3.
    root : Root
    kinds : sequence of AttributeType
        Extra attributes.
    """
    return Splats(
        means=np.empty((rows, 3), np.float32),
        scales=np.empty((rows, 3), np.float32),
        quats=np.empty((rows, 4), np.float32),
        opacities=np.empty(rows, np.float32),
        sh0=np.empty((rows, 3), np.float32),
        shN=np.empty((rows, sh_coefficients(degree) - 1, 3), np.float32),
        info=root.info,
        extras={kind.name: kind.allocate(rows) for kind in kinds},
    )
