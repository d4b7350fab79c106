"""Values that quantised formats share: byte opacities, smallest-three quats, Morton order."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

# Rows per step of the conversions: their temporaries stay in the processor's cache.
_BLOCK_ROWS: Final = 1 << 14

_TINY: Final = float(np.finfo(np.float32).tiny)

# For each index of a quaternion's largest component, where the other three go, in order.
_OTHERS: Final = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]], np.intp)


def opacity_logits(opacities_unit: NDArray[np.floating]) -> F32:
    """Return the logits of linear opacities of any shape: 0 gives -inf, 1 gives +inf, NaN stays.

    Parameters
    ----------
    opacities_unit : float
        From 0 to 1.
    """
    wide = opacities_unit.astype(np.float64)
    with np.errstate(divide="ignore"):
        return (np.log(wide) - np.log1p(-wide)).astype(np.float32)


def unit_opacities(opacities: F32) -> NDArray[np.float64]:
    """Return the linear opacities, 0 to 1, of logits of any shape, ±inf among them."""
    # Half a tangent in place of 1 / (1 + exp(-x)): it overflows nowhere.
    half: NDArray[np.float64] = np.tanh(0.5 * opacities.astype(np.float64))
    return 0.5 * half + 0.5


BYTE_LOGITS: Final = opacity_logits(np.arange(256) / 255)
"""Logit of each opacity that a byte can hold, (256,) float32; ±inf at its ends."""


def opacity_bytes(opacities: F32) -> U8:
    """Return the nearest of the 256 linear opacities for each logit."""
    return np.rint(unit_opacities(opacities) * 255).astype(np.uint8)


def to_smallest_three(quats: F32) -> tuple[NDArray[np.intp], F32]:
    """Return the index of each quaternion's largest component, and the other three components.

    Parameters
    ----------
    quats : (N, 4) float32
        wxyz, any non-zero norm.

    Returns
    -------
    largest : (N,) intp
        Index into wxyz of the component left out.
    others : (N, 3) float32
        The others in wxyz order, of the unit quaternion whose largest component is positive, so
        within ±√½.
    """
    largest = np.empty(len(quats), np.intp)
    others = np.empty((len(quats), 3), np.float32)
    for start in range(0, len(quats), _BLOCK_ROWS):
        wide = quats[start : start + _BLOCK_ROWS].astype(np.float64)
        index = np.abs(wide).argmax(axis=1)
        # Divided by the largest, sign included, first: squares of tiny quaternions vanish.
        wide /= np.take_along_axis(wide, index[:, None], axis=1)
        wide /= np.sqrt(np.square(wide).sum(axis=1, keepdims=True))
        largest[start : start + _BLOCK_ROWS] = index
        others[start : start + _BLOCK_ROWS] = np.take_along_axis(wide, _OTHERS[index], axis=1)
    return largest, others


def from_smallest_three(largest: NDArray[np.integer], others: F32) -> F32:
    """Return (N, 4) wxyz quaternions from their smallest three components, unit where these fit.

    Parameters
    ----------
    largest : (N,) int
        0 to 3.
    others : (N, 3) float32
    """
    quats = np.empty((len(others), 4), np.float32)
    rest = 1 - np.square(others).sum(axis=1)
    missing = np.sqrt(np.maximum(rest, 0))
    for index in range(4):
        rows = np.flatnonzero(largest == index)
        quats[rows, index] = missing[rows]
        for column, other in enumerate(_OTHERS[index]):
            quats[rows, other] = others[rows, column]
    return quats


def morton_order(means: F32) -> NDArray[np.intp]:
    """Return the rows in Morton order of their means, ties in row order.

    Parameters
    ----------
    means : (N, 3) float32
        Finite.
    """
    if len(means) == 0:
        return np.empty(0, np.intp)
    low = means.min(axis=0).astype(np.float64)
    extent = means.max(axis=0).astype(np.float64) - low
    # One cell size for all axes, so that cells are cubes.
    scale = (morton.MAX_LEVELS - 1) / max(float(extent.max()), _TINY)
    codes = np.empty((len(means), 3), np.uint32)
    for start in range(0, len(means), _BLOCK_ROWS):
        block = slice(start, start + _BLOCK_ROWS)
        codes[block] = (means[block] - low) * scale
    return np.argsort(morton.interleave(codes), kind="stable")
