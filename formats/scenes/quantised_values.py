"""Conversions shared by quantised formats: byte opacities, smallest-three quats, Morton order."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

# Rows per step of a conversion, so that its temporary arrays stay in the processor's cache.
_BLOCK_ROWS: Final = 1 << 14

_TINY: Final = float(np.finfo(np.float32).tiny)

# Indices of the three smallest components, in order, for each index of the largest one.
_OTHERS: Final = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]], np.intp)


def opacity_logits(opacities_unit: NDArray[np.floating]) -> F32:
    """Return the logits of linear opacities: -inf for 0, +inf for 1, NaN for NaN.

    Parameters
    ----------
    opacities_unit : array of float
        Linear opacities, 0 to 1; any shape.
    """
    wide = opacities_unit.astype(np.float64)
    with np.errstate(divide="ignore"):
        return (np.log(wide) - np.log1p(-wide)).astype(np.float32)


def unit_opacities(opacities: F32) -> NDArray[np.float64]:
    """Return the linear opacities, 0 to 1, of logits of any shape; ±inf is allowed."""
    # tanh, because 1 / (1 + exp(-x)) overflows for large negative x.
    half: NDArray[np.float64] = np.tanh(0.5 * opacities.astype(np.float64))
    return 0.5 * half + 0.5


BYTE_LOGITS: Final = opacity_logits(np.arange(256) / 255)
"""Lookup table from an opacity byte to its logit, (256,) float32; the ends are ±inf."""


def opacity_bytes(opacities: F32) -> U8:
    """Quantise logits to opacity bytes: 255 × the linear opacity, rounded."""
    return np.rint(unit_opacities(opacities) * 255).astype(np.uint8)


def to_smallest_three(quats: F32) -> tuple[NDArray[np.intp], F32]:
    """Split each quaternion into its three smallest components and the index of the largest.

    Parameters
    ----------
    quats : (N, 4) float32
        Quaternions wxyz of any non-zero norm.

    Returns
    -------
    largest : (N,) intp
        Index into wxyz of the largest component.
    others : (N, 3) float32
        The other components in wxyz order, within ±√½. The quaternion is normalised first, with
        the sign that makes its largest component positive.
    """
    largest = np.empty(len(quats), np.intp)
    others = np.empty((len(quats), 3), np.float32)
    for start in range(0, len(quats), _BLOCK_ROWS):
        wide = quats[start : start + _BLOCK_ROWS].astype(np.float64)
        index = np.abs(wide).argmax(axis=1)
        # Divide by the largest component first: the squares of a tiny quaternion underflow.
        wide /= np.take_along_axis(wide, index[:, None], axis=1)
        wide /= np.sqrt(np.square(wide).sum(axis=1, keepdims=True))
        largest[start : start + _BLOCK_ROWS] = index
        others[start : start + _BLOCK_ROWS] = np.take_along_axis(wide, _OTHERS[index], axis=1)
    return largest, others


def from_smallest_three(largest: NDArray[np.integer], others: F32) -> F32:
    """Rebuild (N, 4) wxyz quaternions from their smallest three components.

    Parameters
    ----------
    largest : (N,) int
        Index into wxyz of the largest component, 0 to 3.
    others : (N, 3) float32
        The other components, in wxyz order.

    Returns
    -------
    (N, 4) float32
        Unit quaternions; the largest component is 0 if the squares of `others` sum to more than 1.
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
    """Return the row indices that sort means along a Morton curve; ties keep their row order.

    Parameters
    ----------
    means : (N, 3) float32
        Centres, finite, in scene units.
    """
    if len(means) == 0:
        return np.empty(0, np.intp)
    low = means.min(axis=0).astype(np.float64)
    extent = means.max(axis=0).astype(np.float64) - low
    # One scale for all axes makes the curve's cells cubes.
    scale = (morton.MAX_LEVELS - 1) / max(float(extent.max()), _TINY)
    codes = np.empty((len(means), 3), np.uint32)
    for start in range(0, len(means), _BLOCK_ROWS):
        block = slice(start, start + _BLOCK_ROWS)
        codes[block] = (means[block] - low) * scale
    return np.argsort(morton.interleave(codes), kind="stable")
