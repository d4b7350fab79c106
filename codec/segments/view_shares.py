"""The view table: what each chunk adds to the pictures of some viewpoints (SPEC 5.12).

A client reads from it which chunks a pose near one of these viewpoints shows: it knows of walls,
which boxes alone do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams.byte_planes import pack_plane, unpack_plane
from cogsplat.codec.streams.payload_limits import MAX_PLANE_BYTES

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

MAX_VIEWS: Final = 64
"""Views of a table, at most (SPEC 5.12)."""

MAX_CODES: Final = MAX_PLANE_BYTES
"""Codes of a table, at most: they are one plane (SPEC 6.3)."""

DIRECTION_UNIT: Final = 127
"""Length of a stored direction, about (SPEC 5.12)."""

_WORD: Final = np.dtype("<u4")

# SPEC 5.12: code 2e + m stands for (2 + m) · 2^(e - 128), code 0 for nothing.
_SHARES: Final = np.array(
    [0.0, *(np.ldexp(2.0 + (code & 1), (code >> 1) - 128) for code in range(1, 256))]
)
# A share goes to the code whose own share is nearest.
_BETWEEN: Final = 0.5 * (_SHARES[1:] + _SHARES[:-1])


@dataclass(frozen=True, eq=False)
class ViewTable:
    """What each chunk of a scene adds to the pictures of some viewpoints.

    Parameters
    ----------
    positions : (V, 3) float32
        Where a viewpoint is, in the space of the means. V is 1 to `MAX_VIEWS`.
    directions : (V, 3) int8
        Where it looks, in `DIRECTION_UNIT`; not (0, 0, 0).
    codes : (V, c) uint8
        For each viewpoint and chunk the share of the picture, as `encode_shares` gives it.
    """

    positions: NDArray[np.float32]
    directions: NDArray[np.int8]
    codes: U8

    @property
    def shares(self) -> F64:
        """Share of each viewpoint's picture that each chunk makes up, (V, c) float64, 0 to 1."""
        return _SHARES[self.codes]


def encode_shares(shares: F64) -> U8:
    """Return the codes of shares of pictures, each the nearest.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.segments.view_shares import encode_shares
    >>> encode_shares(np.array([0.0, 0.25, 0.26, 1.0])).tolist()
    [0, 250, 250, 254]
    """
    codes: U8 = np.searchsorted(_BETWEEN, shares, side="right").astype(np.uint8)
    return codes


def quantise_directions(directions: F64) -> NDArray[np.int8]:
    """Return directions, (V, 3) float64 of unit length, as a table stores them."""
    return np.rint(DIRECTION_UNIT * directions).astype(np.int8)


def pack_codes(codes: U8) -> bytes:
    """Return the codes of a table as the word of a plane and the plane.

    Each code is stored as what it has more than that of the viewpoint before, modulo 256.
    """
    differences = np.diff(codes, axis=0, prepend=np.zeros((1, codes.shape[1]), np.uint8))
    word, stored = pack_plane(np.ascontiguousarray(differences).reshape(-1))
    return np.array([word], _WORD).tobytes() + stored


def unpack_codes(packed: bytes, views: int, chunks: int, where: str) -> U8:
    """Return the codes of a table, (views, chunks) uint8.

    Parameters
    ----------
    packed : bytes
        At least the word.
    views, chunks : int
    where : str
        Names the segment in messages.

    Raises
    ------
    FormatError
        As `byte_planes.unpack_plane`.
    """
    word = int(np.frombuffer(packed, _WORD, 1)[0])
    plane = unpack_plane(memoryview(packed)[_WORD.itemsize :], word, views * chunks, where)
    codes: U8 = np.cumsum(plane.reshape(views, chunks), axis=0, dtype=np.uint8)
    return codes
