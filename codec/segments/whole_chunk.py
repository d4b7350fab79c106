"""Decoding of a whole chunk: head, refinement and tail (SPEC 7.2 to 7.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import decoding_tiers
from cogsplat.codec.streams.chunk_arrays import ChunkArrays, CodebookRows
from cogsplat.codec.streams.records import Kind

from .codebooks import Codebook, ColourCodebook, ShapeCodebook
from .heads import decode_head
from .tails import decode_tail

F32 = NDArray[np.float32]

# Offset of the kind of a payload's first stream (SPEC 6.1, 6.2).
_FIRST_KIND: Final = 3


def decode_chunk(
    head: memoryview,
    refinement: memoryview | None,
    tail: memoryview | None,
    codebooks: tuple[Mapping[int, Codebook], Mapping[int, Codebook]],
    out: Splats,
    where: str,
    *,
    sh_degree: int,
) -> None:
    """Decode a chunk into the rows of `out`; shN is 0 without a tail.

    Parameters
    ----------
    head, refinement, tail : memoryview or None
        Bytes of the segments, their CRCs already checked; None if absent or not requested.
    codebooks : tuple of mappings
        Codebooks by number: those that the head needs, and those that the tail needs.
    out : Splats
        Rows of the chunk, as views of a larger scene.
    where : str
        Name of the chunk in messages.
    sh_degree : int
        SH degree of the file.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        See `decode_head` and `decode_tail`, in this order.
    """
    # Indices of shN are looked up by numpy, as fast as compiled code would.
    indexed = tail is not None and len(tail) > _FIRST_KIND and tail[_FIRST_KIND] == Kind.VQ
    compiled = _decode_compiled(head, refinement, None if indexed else tail, codebooks, out)
    if not compiled:
        decode_head(head, codebooks[0], out, f"{where} head", refinement)
    if tail is None:
        out.shN[:] = 0
    elif indexed or not compiled:
        decode_tail(tail, codebooks[1], out.shN, f"{where} tail", sh_degree=sh_degree)


def _decode_compiled(
    head: memoryview,
    refinement: memoryview | None,
    tail: memoryview | None,
    codebooks: tuple[Mapping[int, Codebook], Mapping[int, Codebook]],
    out: Splats,
) -> bool:
    """Decode a chunk by the compiled reader; return False if numpy must decode it instead."""
    read = decoding_tiers.chunk_reader()
    if read is None:
        return False
    columns = out.shN.shape[1] * 3

    def shapes(number: int) -> tuple[F32, F32] | None:
        book = codebooks[0].get(number)
        return (book.scales, book.quats) if isinstance(book, ShapeCodebook) else None

    def colours(number: int) -> F32 | None:
        book = codebooks[1].get(number)
        if not isinstance(book, ColourCodebook) or 3 * book.shN.shape[1] < columns:
            return None
        return book.shN[:, : columns // 3].reshape(len(book), columns)

    arrays = ChunkArrays(
        out.means,
        out.scales,
        out.quats,
        out.opacities,
        out.sh0,
        out.shN.reshape(len(out), columns),
    )
    return read(head, refinement, tail, CodebookRows(shapes, colours), arrays)
