"""Arrays that the compiled chunk reader reads and writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ChunkArrays:
    """Arrays that receive the values of a chunk, float32, C-contiguous.

    Parameters
    ----------
    means, scales, sh0 : (n, 3)
        Scales are log scales.
    quats : (n, 4)
        Unit, wxyz.
    opacities : (n,)
        Logits.
    shN : (n, d)
        Coefficient by coefficient, R G B inside; d is 0 at SH degree 0.
    """

    means: F32
    scales: F32
    quats: F32
    opacities: F32
    sh0: F32
    shN: F32  # noqa: N815 - the field's name in 3DGS


@dataclass(frozen=True)
class CodebookRows:
    """Rows of the codebooks that a chunk needs, by number; None where it needs no such codebook.

    Parameters
    ----------
    shapes : callable
        Returns the (C, 3) log scales and the (C, 4) quaternions of a shape codebook.
    colours : callable
        Returns the (C, d) SH coefficients of a colour codebook, in the layout of `ChunkArrays.shN`.
    """

    shapes: Callable[[int], tuple[F32, F32] | None]
    colours: Callable[[int], F32 | None]
