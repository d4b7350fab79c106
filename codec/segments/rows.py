"""Rows of a codebook gathered by index (SPEC 6.7)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams.records import StoredStream

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]


def gather(book: F32, kept: F32, indices: U32, out: F32) -> None:
    """Write the rows of a codebook, or of the escape vectors behind it, that indices name."""
    rows = np.concatenate([book, kept]) if len(kept) else book
    # The indices are in range; only a mode that cannot fail writes into `out` without a copy.
    np.take(rows, indices, axis=0, out=out, mode="clip")


def no_codebook(stream: StoredStream, number: int, what: str) -> FormatError:
    """Return the error for a codebook that a segment names but cannot use."""
    return FormatError(
        "codebook-missing",
        f"{stream.where}: codebook {number}, expected a {what} codebook that the segment needs",
        clause="6.7",
    )
