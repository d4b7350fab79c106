"""Trace-normalised covariances from scales and quats, and back (Niedermayr et al. 2024, 3.2)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import rotations

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Row, column and weight of the stored entries. Off-diagonal entries occur twice in the matrix; with
# weight 2, distances of vectors are Frobenius distances of matrices.
_UPPER: Final = ((0, 0, 1.0), (1, 1, 1.0), (2, 2, 1.0), (0, 1, 2.0), (0, 2, 2.0), (1, 2, 2.0))

MIN_RELATIVE_SCALE: Final = 1e-4
"""Lower bound of a shape's thinnest axis relative to its norm; smaller axes change no pixel."""


def scale_factor(scales: F32) -> F32:
    """Return log‖exp(scales)‖ of (n, 3) log scales, (n,) float32."""
    wide = scales.astype(np.float64)
    top = wide.max(axis=1)
    sums = np.exp(2 * (wide - top[:, None])).sum(axis=1)
    factors: F32 = (top + 0.5 * np.log(sums)).astype(np.float32)
    return factors


def shape_vectors(quats: F32, scales: F32) -> F32:
    """Return the shapes of splats as (n, 6) float32 vectors of trace-normalised covariances.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit quaternions, wxyz.
    scales : (n, 3) float32
        Log scales.

    Returns
    -------
    (n, 6) float32
        Entries xx, yy, zz, √2·xy, √2·xz, √2·yz of R·diag(s²)·Rᵀ divided by its trace, with s the
        scales. Distances of vectors are Frobenius distances of matrices.
    """
    relative = np.exp(2 * (scales - scale_factor(scales)[:, None]).astype(np.float64))
    turned = rotations.matrices(quats)
    covariance = np.einsum("nij,nj,nkj->nik", turned, relative, turned)
    columns = [covariance[:, i, j] * np.sqrt(weight) for i, j, weight in _UPPER]
    return np.stack(columns, axis=1).astype(np.float32)


def principal_axes(covariances: F64) -> tuple[F64, F64]:
    """Decompose covariances into variances along the principal axes and rotations.

    Parameters
    ----------
    covariances : (n, 3, 3) float64
        Symmetric covariance matrices.

    Returns
    -------
    variances : (n, 3) float64
        Variances, ascending; rounding may make the smallest one slightly negative.
    quats : (n, 4) float64
        Rotations of the principal axes: unit quaternions, wxyz.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.geometry.covariance import principal_axes
    >>> variances, quats = principal_axes(np.diag([1.0, 4.0, 9.0])[None])
    >>> variances.tolist(), quats.tolist()
    ([[1.0, 4.0, 9.0]], [[1.0, 0.0, 0.0, 0.0]])
    """
    variances, axes = np.linalg.eigh(covariances)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    return variances, rotations.from_matrices(axes)


def quats_and_scales(vectors: F32) -> tuple[F32, F32]:
    """Return the quats and normalised log scales of (C, 6) vectors from `shape_vectors`.

    Returns
    -------
    quats : (C, 4) float32
        Unit quaternions, wxyz. Axes are ordered so that w is the largest component.
    scales : (C, 3) float32
        Log scales with ‖exp(scales)‖ = 1.
    """
    covariance = np.empty((len(vectors), 3, 3))
    for column, (i, j, weight) in enumerate(_UPPER):
        covariance[:, i, j] = covariance[:, j, i] = vectors[:, column] / np.sqrt(weight)
    variances, quats = principal_axes(covariance)
    deviations = np.sqrt(np.maximum(variances, MIN_RELATIVE_SCALE**2))
    scales = np.log(deviations / np.sqrt(np.square(deviations).sum(axis=1, keepdims=True)))
    return rotations.largest_w(quats.astype(np.float32), scales.astype(np.float32))
