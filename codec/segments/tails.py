"""Chunk tails: the SH coefficients above DC of a chunk (SPEC 7.3)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.codec.streams import colour_streams
from cogsplat.codec.streams.records import Attribute, Kind, StoredStream

from .bands import read_band
from .codebooks import (
    Codebook,
    ColourCodebook,
)
from .rows import gather, no_codebook
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
    """Write a chunk tail's shN into the rows of `out`.

    Parameters
    ----------
    payload, codebooks, where
        As in `decode_head`.
    out : (n, K-1, 3) float32
        The chunk's rows; K may be lower than the file's, and the bands above are skipped.
    sh_degree : int
        Of the file; bands above it have no place in a tail.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        The payload breaks SPEC 6 or 7.3.
    """
    rows = len(out)
    found = StreamSet(payload, where, rows, "7.3")
    bands = range(1, sh_degree + 1)
    if found.has(Attribute.SHN):
        colour = found.take(Attribute.SHN)
        if colour.kind == Kind.BASIS:
            number = colour_streams.basis_codebook(colour)
            basis = _colours(codebooks, colour, number, out.shape[1])
            colour_streams.read_shn(colour, basis.shN[:, : out.shape[1]], out)
            found.finish()
            return
        kept = np.zeros((colour.kept, *out.shape[1:]), np.float32)
        if colour.kept:
            for band in bands:
                read_band(found, band, kept, kept=True)
        book = _colours(codebooks, colour, colour.codebook, out.shape[1])
        gather(book.shN[:, : out.shape[1]], kept, colour.read_indices(len(book)), out)
    else:
        for band in bands:
            read_band(found, band, out)
    found.finish()


def _colours(
    codebooks: Mapping[int, Codebook], stream: StoredStream, number: int, coefficients: int
) -> ColourCodebook:
    book = codebooks.get(number)
    if not isinstance(book, ColourCodebook) or book.shN.shape[1] < coefficients:
        raise no_codebook(stream, number, "colour")
    return book
