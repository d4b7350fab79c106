"""Table of stream kinds: allowed kinds of each attribute and their readers (SPEC 6.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import (
    codebook_index,
    float32,
    opacity_differences,
    quaternion,
    scalar,
    scale_differences,
    sh0_transform,
    shn_transform,
    sorted_means,
    swing_twist,
)
from .codebook_index import CodebookUse
from .records import INFINITIES, Attribute, Kind, StoredStream
from .stream_inputs import NO_INPUTS, Inputs

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class StreamCodec:
    """Reader and properties of one kind of stream of one attribute.

    Parameters
    ----------
    read : callable
        Writes the (rows, c) float32 values of a stream.
    refined_by : Kind or None
        Kind of the stream in the refinement that refines this one; None if it cannot be refined.
    levels_only : bool
        Whether the kind is allowed only for opacities of later levels (SPEC 7.5); its reader adds
        to `out`.
    codebook : callable or None
        Returns the codebook and the number of escape rows that a stream refers to; None if the
        kind refers to no codebook.
    """

    read: Callable[[StoredStream, F32, Inputs], None]
    refined_by: Kind | None = None
    levels_only: bool = False
    codebook: Callable[[StoredStream], CodebookUse] | None = None


_PLAIN: Final = {Kind.SCALAR: StreamCodec(scalar.read), Kind.FLOAT: StreamCodec(float32.read)}
_REFINABLE: Final = {
    Kind.SCALAR: StreamCodec(scalar.read, refined_by=Kind.DIGITS),
    Kind.FLOAT: StreamCodec(float32.read),
}
_INDEX: Final = {Kind.VQ: StreamCodec(codebook_index.read, codebook=codebook_index.parse)}

KINDS: Final[Mapping[Attribute, Mapping[Kind, StreamCodec]]] = {
    Attribute.MEANS: {
        **_PLAIN,
        Kind.SORTED: StreamCodec(sorted_means.read, refined_by=Kind.BITS),
    },
    Attribute.OPACITIES: {
        **_REFINABLE,
        Kind.DIFFERENCES: StreamCodec(opacity_differences.read, levels_only=True),
    },
    Attribute.SH0: {
        **_REFINABLE,
        Kind.BASIS: StreamCodec(sh0_transform.read, refined_by=Kind.DIGITS),
    },
    Attribute.SCALES: {
        **_REFINABLE,
        Kind.DIFFERENCES: StreamCodec(scale_differences.read, refined_by=Kind.DIGITS),
    },
    Attribute.QUATS: {
        Kind.QUAT: StreamCodec(quaternion.read),
        Kind.SWING_TWIST: StreamCodec(swing_twist.read),
    },
    Attribute.SCALE_FACTOR: _PLAIN,
    Attribute.SHAPE: _INDEX,
    Attribute.SHN: {
        **_INDEX,
        Kind.BASIS: StreamCodec(shn_transform.read, codebook=shn_transform.codebook_use),
    },
    Attribute.SH1: _PLAIN,
    Attribute.SH2: _PLAIN,
    Attribute.SH3: _PLAIN,
}
"""Streams allowed in heads, tails and codebooks; `refined_by` names those of refinements."""


def codec_of(stream: StoredStream) -> StreamCodec:
    """Return the codec of a stream.

    Raises
    ------
    FormatError
        ``stream-kind``: the attribute is not stored in this kind.
    """
    found = KINDS[stream.attribute].get(stream.kind)
    if found is None:
        names = ", ".join(kind.name.lower() for kind in KINDS[stream.attribute])
        raise FormatError(
            "stream-kind",
            f"{stream.where}: kind {stream.kind.name.lower()}, expected one of {names}",
            clause="6.2",
        )
    return found


def refinement_kind(stream: StoredStream) -> Kind | None:
    """Return the kind of stream that refines a head's stream; None if it cannot be refined.

    Streams with infinities cannot be refined.

    Raises
    ------
    FormatError
        ``stream-kind``: the stream has a kind that is not allowed for its attribute.
    """
    return None if stream.flags & INFINITIES else codec_of(stream).refined_by


def codebook_use(stream: StoredStream) -> CodebookUse:
    """Return the codebook number and the count of escape rows of a stream of shape or shN.

    Escape rows are vectors that a chunk stores itself because no codebook row is close enough.

    Raises
    ------
    FormatError
        ``stream-kind``, ``stream-params``, ``stream-rows``.
    ValueError
        The kind refers to no codebook.
    """
    codebook = codec_of(stream).codebook
    if codebook is None:
        raise ValueError(f"{stream.where}: {stream.label} refers to no codebook")
    return codebook(stream)


def read(stream: StoredStream, out: F32, inputs: Inputs = NO_INPUTS) -> None:
    """Decode the values of a stream into `out`.

    Parameters
    ----------
    stream : StoredStream
        Stream to decode.
    out : (rows, c) float32
        Decoded values; may be a strided view.
    inputs : Inputs
        Other decoded values that the stream's kind depends on.

    Raises
    ------
    FormatError
        The stream breaks its clause of SPEC 6.
    """
    codec_of(stream).read(stream, out, inputs)
