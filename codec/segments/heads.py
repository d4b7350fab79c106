"""Chunk heads: means, opacities, sh0, scales and quats, refined if possible (SPEC 7.2, 7.4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import codebook_index, kinds
from cogsplat.codec.streams.records import Attribute
from cogsplat.codec.streams.stream_inputs import Inputs

from .codebooks import Codebook, ShapeCodebook, missing_codebook_error, read_shapes
from .stream_set import RefinementSet, StreamSet

F32 = NDArray[np.float32]


def decode_head(
    payload: memoryview,
    codebooks: Mapping[int, Codebook],
    out: Splats,
    where: str,
    refinement: memoryview | None = None,
) -> None:
    """Decode a chunk's head and refinement into the rows of `out`.

    Parameters
    ----------
    payload : memoryview
        Bytes of the head, its CRC already checked.
    codebooks : mapping of int to Codebook
        Codebooks by number, at least those that the segment needs.
    out : Splats
        Rows of the chunk, as views of a larger scene; shN is unchanged.
    where : str
        Name of the segment in messages.
    refinement : memoryview, optional
        Bytes of the chunk's refinement, its CRC already checked; without it values are coarse.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        A payload breaks SPEC 6, 7.2 or 7.4.
    """
    found = StreamSet(payload, where, len(out), "7.2")
    finer = RefinementSet(refinement, f"{where}, refined", len(out))
    if found.has(Attribute.SHAPE):
        scales = _read_shapes(found, codebooks, out)
    else:
        scales = _read_scales(found, finer, out)
        kinds.read(found.pop(Attribute.QUATS), out.quats, Inputs(scales=scales))
    _read(found, finer, Attribute.MEANS, out.means, scales)
    _read(found, finer, Attribute.OPACITIES, out.opacities[:, None], scales)
    _read(found, finer, Attribute.SH0, out.sh0, scales)
    found.require_empty()
    finer.require_empty()


def _read(
    found: StreamSet,
    finer: RefinementSet,
    attribute: Attribute,
    out: F32,
    scales: F32,
) -> None:
    """Decode an attribute into `out`, refined if the refinement is given.

    `scales` are the scales without refinement, which set the quantiser steps.
    """
    stream = found.pop(attribute)
    inputs = Inputs(scales=scales, refinement=finer.pop(stream))
    kinds.read(stream, out, inputs)


def _read_scales(found: StreamSet, finer: RefinementSet, out: Splats) -> F32:
    """Decode the scales into `out`; return the unrefined scales, which set the quantiser steps."""
    stream = found.pop(Attribute.SCALES)
    refinement = finer.pop(stream)
    if refinement is None:
        kinds.read(stream, out.scales)
        return out.scales
    coarse = np.empty_like(out.scales)
    kinds.read(stream, out.scales, Inputs(refinement=refinement, coarse=coarse))
    return coarse


def _read_shapes(found: StreamSet, codebooks: Mapping[int, Codebook], out: Splats) -> F32:
    """Decode scales and quats from a codebook and escape rows into `out`; return the scales."""
    stream = found.pop(Attribute.SHAPE)
    use = kinds.codebook_use(stream)
    escape = read_shapes(found, use.escape_rows, escape=True)
    book = codebooks.get(use.number)
    if not isinstance(book, ShapeCodebook):
        raise missing_codebook_error(stream, use.number, "shape")
    # Two arrays, one list of indices: rows of seven values would have to be copied apart.
    indices = codebook_index.read_indices(stream, len(book))
    codebook_index.gather(book.scales, escape.scales, indices, out.scales)
    codebook_index.gather(book.quats, escape.quats, indices, out.quats)
    factor = np.empty((len(out), 1), np.float32)
    kinds.read(found.pop(Attribute.SCALE_FACTOR), factor)
    np.add(out.scales, factor, out=out.scales)
    return out.scales
