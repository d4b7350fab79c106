"""Real spherical harmonics in the convention of 3DGS, and view-dependent colours."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import MAX_SH_DEGREE, sh_coefficients

Number = TypeVar("Number", np.float64, NDArray[np.float64])

# Normalisation of the real bases, orthonormal on the sphere (Ramamoorthi and Hanrahan 2001, table
# of section 3.2, continued to degree 3).
C0 = 0.28209479177387814  # sqrt(1 / (4 pi))
C1 = 0.4886025119029199  # sqrt(3 / (4 pi))
C2_XY = 1.0925484305920792  # sqrt(15 / (4 pi)), also yz and xz
C2_ZZ = 0.31539156525252005  # sqrt(5 / (16 pi))
C2_XX_YY = 0.5462742152960396  # sqrt(15 / (16 pi))
C3_3 = 0.5900435899266435  # sqrt(35 / (32 pi))
C3_2 = 2.890611442640554  # sqrt(105 / (4 pi))
C3_1 = 0.4570457994644658  # sqrt(21 / (32 pi))
C3_0 = 0.3731763325901154  # sqrt(7 / (16 pi))
C3_XX_YY = 1.445305721320277  # sqrt(105 / (16 pi))

# Offset that 3DGS adds to the SH sum: zero coefficients are mid-grey.
COLOUR_OFFSET = 0.5


def terms(x: Number, y: Number, z: Number) -> tuple[Number, ...]:
    """Return the 15 SH basis functions above DC at a unit direction, by band l, m from -l to l.

    3DGS keeps the Condon-Shortley phase: bases of odd m are negated. The function accepts float64
    scalars and arrays; numpy code and compiled kernels share it.
    """
    xx, yy, zz = x * x, y * y, z * z
    return (
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2_XY * (x * y),
        -C2_XY * (y * z),
        C2_ZZ * (2.0 * zz - xx - yy),
        -C2_XY * (x * z),
        C2_XX_YY * (xx - yy),
        -C3_3 * (y * (3.0 * xx - yy)),
        C3_2 * (x * y * z),
        -C3_1 * (y * (4.0 * zz - xx - yy)),
        C3_0 * (z * (2.0 * zz - 3.0 * xx - 3.0 * yy)),
        -C3_1 * (x * (4.0 * zz - xx - yy)),
        C3_XX_YY * (z * (xx - yy)),
        -C3_3 * (x * (xx - 3.0 * yy)),
    )


def basis(directions: NDArray[np.floating], degree: int) -> NDArray[np.float64]:
    """Evaluate the real SH bases at unit directions.

    Parameters
    ----------
    directions : (N, 3) float
        Unit vectors from the camera to the splat.
    degree : int
        SH degree, 0 to 3.

    Returns
    -------
    (N, K) float64
        Values of the K = (degree + 1)² bases, DC first, then band by band.

    Raises
    ------
    ValueError
        The degree is not 0 to 3.
    """
    if not 0 <= degree <= MAX_SH_DEGREE:
        raise ValueError(f"SH degree {degree}, expected 0 to {MAX_SH_DEGREE}")
    wide = np.asarray(directions, dtype=np.float64)
    values = np.empty((len(wide), sh_coefficients(degree)))
    values[:, 0] = C0
    higher = terms(wide[:, 0], wide[:, 1], wide[:, 2])
    for column in range(1, values.shape[1]):
        values[:, column] = higher[column - 1]
    return values


def colours(
    sh0: NDArray[np.floating], shN: NDArray[np.floating], directions: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return the colour of each splat seen along its direction.

    Parameters
    ----------
    sh0 : (N, 3) float
        DC coefficients.
    shN : (N, K-1, 3) float
        Higher coefficients; K gives the degree.
    directions : (N, 3) float
        Unit vectors from the camera to the splat.

    Returns
    -------
    (N, 3) float32
        SH sum + 0.5, clamped to at least 0 as in 3DGS.
    """
    degree = {0: 0, 3: 1, 8: 2, 15: 3}[shN.shape[1]]
    values = basis(directions, degree)
    total = values[:, :1] * sh0 + np.einsum("nk,nkc->nc", values[:, 1:], shN) + COLOUR_OFFSET
    clamped: NDArray[np.float64] = np.maximum(total, 0.0)
    return clamped.astype(np.float32)
