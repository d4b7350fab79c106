"""All streams of a chunk read together, where kernels are in use and the chunk is a usual one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import compiled

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ChunkArrays:
    """Where the values of a chunk go, float32, C-contiguous.

    Parameters
    ----------
    means, scales, sh0 : (n, 3)
        Scales are log scales.
    quats : (n, 4)
        Unit, wxyz.
    opacities : (n,)
        Logits.
    shN : (n, d)
        Coefficient by coefficient, R G B inside; without columns where none are wanted.
    """

    means: F32
    scales: F32
    quats: F32
    opacities: F32
    sh0: F32
    shN: F32  # noqa: N815 - the field's name in 3DGS


def read(
    head: memoryview,
    refinement: memoryview | None,
    tail: memoryview | None,
    basis_of: Callable[[int], F32 | None],
    out: ChunkArrays,
) -> bool:
    """Write the values of a chunk, if it is made of the streams that the encoder usually writes.

    Parameters
    ----------
    head, refinement, tail : memoryview or None
        Their payloads, the CRCs already checked; None for those that are not there or not wanted.
    basis_of : callable
        Returns the (C, d) float32 rows of a colour codebook by its number, with as many columns as
        `ChunkArrays.shN`; None where there are none.
    out : ChunkArrays

    Returns
    -------
    bool
        False where no kernels are in use, or where anything is wrong or unusual: then the arrays
        hold anything, and the payloads are to be read stream by stream, which raises what is to be
        raised.
    """
    kernel = compiled.chunk_reader()
    return kernel is not None and kernel(head, refinement, tail, basis_of, out)
