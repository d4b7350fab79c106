"""Size and allocation of the arrays that chunks are decoded into."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.codec.splats import Splats, sh_coefficients
from cogsplat.codec.streams.payload_limits import MAX_PLANE_BYTES
from cogsplat.codec.streams.shn_transform import MAX_BASIS_ROWS

from .root import Root

SCRATCH_ROW_BYTES: Final = 128
"""Working memory per splat of the chunk that is being decoded, bytes."""
# Measured: 30 to 130 bytes, for planes, codes and copies of one attribute at a time.

# Further working memory per splat and coordinate of shN on a basis: its code and its value
# (measured: 6 bytes).
_SCRATCH_COORDINATE_BYTES: Final = 8
_FIRST_COORDINATES: Final = 26

# Bytes of the mean, scales, quaternion, opacity and sh0 of one splat, float32.
_HEAD_ROW_BYTES: Final = 4 * (3 + 3 + 4 + 1 + 3)


def row_bytes(degree: int, kinds: Sequence[AttributeType] = ()) -> int:
    """Return the size of one decoded splat, bytes.

    Parameters
    ----------
    degree : int
        SH degree, 0 to 3.
    kinds : sequence of AttributeType
        Types of the extra attributes.
    """
    extras = sum(kind.row_bytes for kind in kinds)
    return _HEAD_ROW_BYTES + 12 * (sh_coefficients(degree) - 1) + extras


def scratch_bytes(rows: int, degree: int, root: Root) -> int:
    """Return the maximum working memory for decoding a chunk of `rows` splats, bytes."""
    books = [book.rows for book in root.codebooks if book.attribute == "colour"]
    width = min(max(books, default=0), MAX_BASIS_ROWS) if degree else 0
    # A plane holds the codes of a group of coordinates (SPEC 6.14), so its maximum length limits
    # their number. The first groups have 26 coordinates together.
    coordinates = rows * width
    coordinates = min(coordinates, rows * _FIRST_COORDINATES + MAX_PLANE_BYTES)
    return rows * SCRATCH_ROW_BYTES + coordinates * _SCRATCH_COORDINATE_BYTES


def allocate(rows: int, degree: int, root: Root, kinds: Sequence[AttributeType]) -> Splats:
    """Allocate splats for decoding, with uninitialised values.

    Parameters
    ----------
    rows : int
        Number of splats.
    degree : int
        SH degree, 0 to 3.
    root : Root
        Root of the file, for the scene's conventions.
    kinds : sequence of AttributeType
        Types of the extra attributes.
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
