"""Chunk tails: the SH coefficients above DC of a chunk (SPEC 7.3)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.codec.streams import kinds
from cogsplat.codec.streams.records import Attribute
from cogsplat.codec.streams.stream_inputs import Inputs

from .bands import read_band
from .codebooks import Codebook, ColourCodebook, missing_codebook_error
from .stream_set import StreamSet

F32 = NDArray[np.float32]


def decode_tail(
    payload: memoryview,
    codebooks: Mapping[int, Codebook],
    out: F32,
    where: str,
    *,
    sh_degree: int = MAX_SH_DEGREE,
) -> None:
    """Decode a chunk's tail into the rows of shN.

    Parameters
    ----------
    payload, codebooks, where
        See `decode_head`.
    out : (n, K-1, 3) float32
        Rows of the chunk, C-contiguous; bands of the file beyond K are skipped.
    sh_degree : int
        SH degree of the file; a tail must not have bands above it.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        The payload breaks SPEC 6 or 7.3.
    """
    found = StreamSet(payload, where, len(out), "7.3")
    if found.has(Attribute.SHN):
        _read_from_codebook(found, codebooks, out, sh_degree)
    else:
        for band in range(1, sh_degree + 1):
            read_band(found, band, out)
    found.require_empty()


def _read_from_codebook(
    found: StreamSet, codebooks: Mapping[int, Codebook], out: F32, sh_degree: int
) -> None:
    """Decode shN from its codebook stream and escape rows into `out`."""
    stream = found.pop(Attribute.SHN)
    use = kinds.codebook_use(stream)
    escape = np.zeros((use.escape_rows, *out.shape[1:]), np.float32)
    if use.escape_rows:
        for band in range(1, sh_degree + 1):
            read_band(found, band, escape, escape=True)
    book = codebooks.get(use.number)
    coefficients = out.shape[1]
    if not isinstance(book, ColourCodebook) or book.shN.shape[1] < coefficients:
        raise missing_codebook_error(stream, use.number, "colour")
    # Not -1 for the columns: there may be no rows.
    columns = 3 * coefficients
    inputs = Inputs(
        codebook=book.shN[:, :coefficients].reshape(len(book), columns),
        escape=escape.reshape(len(escape), columns),
    )
    kinds.read(stream, out.reshape(len(out), columns), inputs)
