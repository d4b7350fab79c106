"""View table: each chunk's share of what is seen all around some viewpoints (SPEC 5.12).

A client finds in it the chunks visible near a viewpoint. Unlike bounding boxes, the table accounts
for occlusion by walls.
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
"""Viewpoints of a table at most (SPEC 5.12)."""

MAX_CODES: Final = MAX_PLANE_BYTES
"""Codes of a table at most: the limit of the one plane that stores them (SPEC 6.3)."""

_WORD: Final = np.dtype("<u4")

# SPEC 5.12: code 2e + m means a share of (2 + m) · 2^(e - 128), code 0 means 0.
_SHARES: Final = np.array(
    [0.0, *(np.ldexp(2.0 + (code & 1), (code >> 1) - 128) for code in range(1, 256))]
)
# Boundaries between codes: a share becomes the code of the nearest share.
_BETWEEN: Final = 0.5 * (_SHARES[1:] + _SHARES[:-1])


@dataclass(frozen=True, eq=False)
class ViewTable:
    """Shares of all chunks in the panoramas of some viewpoints.

    A panorama is the six pictures of a cube around the viewpoint (`views.panorama`). The share of a
    chunk is the sum of its splats' blending weights over the six, divided by their number of
    pixels.

    Parameters
    ----------
    positions : (V, 3) float32
        Positions of the viewpoints in the space of the means; V is 1 to `MAX_VIEWS`.
    codes : (V, c) uint8
        Code of each chunk's share in the panorama of each viewpoint, from `encode_shares`.
    """

    positions: NDArray[np.float32]
    codes: U8

    @property
    def shares(self) -> F64:
        """Share of each chunk in the panorama of each viewpoint, (V, c) float64, as stored."""
        return _SHARES[self.codes]


def encode_shares(shares: F64) -> U8:
    """Return the nearest code of each share; codes are spaced about logarithmically (SPEC 5.12).

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.segments.view_shares import encode_shares
    >>> encode_shares(np.array([0.0, 0.25, 0.26, 1.0])).tolist()
    [0, 250, 250, 254]
    """
    codes: U8 = np.searchsorted(_BETWEEN, shares, side="right").astype(np.uint8)
    return codes


def pack_codes(codes: U8) -> bytes:
    """Return the codes of a table as bytes: the word of a byte plane, then the plane (SPEC 6.3).

    The plane stores differences from the codes of the previous viewpoint, modulo 256.
    """
    differences = np.diff(codes, axis=0, prepend=np.zeros((1, codes.shape[1]), np.uint8))
    word, stored = pack_plane(np.ascontiguousarray(differences).reshape(-1))
    return np.array([word], _WORD).tobytes() + stored


def unpack_codes(packed: bytes, views: int, chunks: int, where: str) -> U8:
    """Return the codes of a packed table, (views, chunks) uint8.

    Parameters
    ----------
    packed : bytes
        Word and plane; at least four bytes.
    views, chunks : int
        Numbers of viewpoints and of chunks.
    where : str
        Name of the segment in messages.

    Raises
    ------
    FormatError
        See `byte_planes.unpack_plane`.
    """
    word = int(np.frombuffer(packed, _WORD, 1)[0])
    plane = unpack_plane(memoryview(packed)[_WORD.itemsize :], word, views * chunks, where)
    codes: U8 = np.cumsum(plane.reshape(views, chunks), axis=0, dtype=np.uint8)
    return codes
