"""What the reader of a stream is given besides the stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .records import StoredStream

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Decoded values and streams that a stream may depend on; each kind uses those it needs.

    Parameters
    ----------
    scales : (rows, 3) float32, optional
        Log scales of the same rows as the head alone gives them: the adaptive step of means and
        rotations follows from these (SPEC 6.10).
    refinement : StoredStream, optional
        The stream of the chunk's refinement that refines this one (SPEC 7.4).
    coarse : (rows, c) float32, optional
        Array to fill with the values that the stream has without its refinement.
    codebook : (C, d) float32, optional
        Rows of the codebook that the stream names.
    escape : (e, d) float32, optional
        Escape rows of the same payload, which follow the rows of the codebook.
    """

    scales: F32 | None = None
    refinement: StoredStream | None = None
    coarse: F32 | None = None
    codebook: F32 | None = None
    escape: F32 | None = None


NO_INPUTS: Final = Inputs()
"""For streams that depend on nothing else."""
