"""From segment payloads to rows: chunk heads, chunk tails and codebooks (SPEC 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import colour_streams, fine_means, shape_streams
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import refinement as refinement_streams
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Kind, StoredStream

from .codebooks import (
    Codebook,
    ShapeCodebook,
)
from .rows import gather, no_codebook
from .stream_set import RefinementSet, StreamSet

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

# Coarse values that nobody asks for.
_NOBODY: Final = np.empty((0, 3), np.float32)


def decode_head(
    payload: memoryview,
    codebooks: Mapping[int, Codebook],
    out: Splats,
    where: str,
    refinement: memoryview | None = None,
) -> None:
    """Write a chunk head's means, opacities, sh0, scales and quats into the rows of `out`.

    Parameters
    ----------
    payload : memoryview
        The segment's bytes, its CRC already checked.
    codebooks : mapping of int to Codebook
        At least those the segment needs.
    out : Splats
        The chunk's rows, as views of a larger scene; shN is left alone.
    where : str
        Names the segment in messages.
    refinement : memoryview, optional
        Bytes of the chunk's refinement, likewise checked; without it the head's coarse values.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        A payload breaks SPEC 6, 7.2 or 7.4.
    """
    found = StreamSet(payload, where, len(out), "7.2")
    finer = RefinementSet(refinement, f"{where}, refined", len(out))
    # What the halvings of the head's own codes follow from.
    scales = out.scales
    if found.has(Attribute.SHAPE):
        _read_shapes(found, codebooks, out)
    else:
        scales = _read_scales(found.take(Attribute.SCALES), finer.take(Attribute.SCALES), out)
        _read_quats(found.take(Attribute.QUATS), finer, scales, out)
    _read_means(found.take(Attribute.MEANS), finer, scales, out)
    _read_opacities(found.take(Attribute.OPACITIES), finer.take(Attribute.OPACITIES), out)
    _read_sh0(found.take(Attribute.SH0), finer.take(Attribute.SH0), out.sh0)
    found.finish()
    finer.finish()


def _read_shapes(found: StreamSet, codebooks: Mapping[int, Codebook], out: Splats) -> None:
    shape = found.take(Attribute.SHAPE)
    kept = ShapeCodebook(
        np.empty((shape.kept, 3), np.float32), np.empty((shape.kept, 4), np.float32)
    )
    if shape.kept:
        found.take_kept(Attribute.SCALES, shape.kept).read_numbers(kept.scales)
        found.take_kept(Attribute.QUATS, shape.kept).read_quats(kept.quats)
    book = codebooks.get(shape.codebook)
    if not isinstance(book, ShapeCodebook):
        raise no_codebook(shape, shape.codebook, "shape")
    indices = shape.read_indices(len(book))
    gather(book.scales, kept.scales, indices, out.scales)
    gather(book.quats, kept.quats, indices, out.quats)
    factor = np.empty((len(out), 1), np.float32)
    found.take(Attribute.SCALE_FACTOR).read_numbers(factor)
    np.add(out.scales, factor, out=out.scales)


def _read_scales(stream: StoredStream, finer: StoredStream | None, out: Splats) -> F32:
    """Read scales into `out`; return those of the head alone."""
    coarse = out.scales if finer is None else np.empty_like(out.scales)
    if stream.kind == Kind.LADDER:
        shape_streams.read_ladder(stream, out.scales, finer, coarse)
    elif finer is None:
        stream.read_numbers(out.scales)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 3), finer, out.scales, coarse)
    return coarse


def _grid(stream: StoredStream, components: int) -> Grid:
    """Return the grid of a scalar stream that is to be refined."""
    stream.require_kind(Kind.SCALAR)
    params = stream.require_params(components * grids.ENTRY_BYTES)
    return grids.unpack(params, components, stream.where)


def _read_quats(stream: StoredStream, finer: RefinementSet, scales: F32, out: Splats) -> None:
    if stream.kind == Kind.TURN:
        shape_streams.read_turns(stream, scales, out.quats, finer.finer(Attribute.QUATS, out))
    else:
        stream.read_quats(out.quats)


def _read_means(stream: StoredStream, finer: RefinementSet, scales: F32, out: Splats) -> None:
    if stream.kind == Kind.FINE:
        fine_means.read_fine_means(stream, scales, out.means, finer.finer(Attribute.MEANS, out))
    else:
        stream.read_means(out.means)


def _read_opacities(stream: StoredStream, finer: StoredStream | None, out: Splats) -> None:
    column = out.opacities[:, None]
    if finer is None:
        stream.read_numbers(column)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 1), finer, column, _NOBODY)


def _read_sh0(stream: StoredStream, finer: StoredStream | None, out: F32) -> None:
    if stream.kind == Kind.BASIS:
        colour_streams.read_sh0(stream, out, finer)
    elif finer is None:
        stream.read_numbers(out)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 3), finer, out, _NOBODY)
