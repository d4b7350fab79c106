"""Inputs of a stream's reader besides the stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .records import StoredStream

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Decoded values and streams that the reader of a stream may need.

    Parameters
    ----------
    scales : (rows, 3) float32, optional
        Log scales of the same rows, decoded without refinement: the adaptive steps of means and
        rotations follow from them (SPEC 6.10).
    refinement : StoredStream, optional
        Stream of the chunk's refinement that refines this stream (SPEC 7.4).
    coarse : (rows, c) float32, optional
        Array that receives the values without refinement.
    codebook : (C, d) float32, optional
        Rows of the codebook that the stream refers to.
    escape : (e, d) float32, optional
        Escape rows of the same payload, indexed after the rows of the codebook.
    """

    scales: F32 | None = None
    refinement: StoredStream | None = None
    coarse: F32 | None = None
    codebook: F32 | None = None
    escape: F32 | None = None


NO_INPUTS: Final = Inputs()
"""Inputs of streams that need none."""
