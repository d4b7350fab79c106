"""Encode-decode round trips of a scene in training, splat by splat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.encoded import EncodedCodebook, EncodedScene
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import PreparedScene
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.geometry import rotations
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients, with_values

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RoundTrip:
    """A scene as it was stored.

    Parameters
    ----------
    decoded : Splats
        Row by row those that were stored, and turned as these are. Splats that were not worth their
        bytes have a logit of minus infinity.
    encoded : EncodedScene
        Without compensation and without predicted quality.
    rows : sequence of (n,) int64
        Which of them each chunk holds, in its order.
    """

    decoded: Splats
    encoded: EncodedScene
    rows: Sequence[NDArray[np.int64]]


def _facing(quats: F32, scales: F32, as_quats: F32) -> tuple[F32, F32]:
    """Permute and flip the axes of Gaussians so that they are turned as others are.

    Parameters
    ----------
    quats, scales : (n, 4), (n, 3) float32
        Unit wxyz and log.
    as_quats : (n, 4) float32
        What they should come nearest to, of any length.

    Returns
    -------
    quats, scales : (n, 4), (n, 3) float32
        The same Gaussians; the quaternions have the length and the sign of `as_quats`.
    """
    lengths = np.linalg.norm(as_quats, axis=1, keepdims=True)
    reference = as_quats / lengths.astype(np.float64)
    inverse = reference * np.array([1.0, -1.0, -1.0, -1.0])
    between = rotations.multiply(inverse, quats.astype(np.float64))
    nearest, permuted = rotations.largest_w(between.astype(np.float32), scales)
    turned = rotations.multiply(reference, nearest.astype(np.float64)) * lengths
    return turned.astype(np.float32), permuted


def round_trip(
    prepared: PreparedScene,
    splats: Splats,
    quality_db: float,
    codebooks: Sequence[EncodedCodebook] = (),
) -> RoundTrip:
    """Encode a scene in the order and with the quantiser steps of an earlier state of it.

    Parameters
    ----------
    prepared : PreparedScene
        Of the same splats before they were trained further: its order, and the steps that follow
        from its scores, stay.
    splats : Splats
        N of them, row by row those of `prepared`.
    quality_db : float
        Nominal quality, dB.
    codebooks : sequence of EncodedCodebook
        Of the encode before, which those of the profile ``vq`` go on from.
    """
    now = replace(prepared, source=splats, codebooks=codebooks)
    layout = now.laid_out(quality_db)
    encoded = encode_chunks(now, quality_db, executor=LocalThreads(prepared.config.threads))
    chunk_rows = [
        layout.rows[run][chunk.payloads.order]
        for run, chunk in zip(layout.slices, encoded.chunks, strict=True)
    ]
    rows = np.concatenate(chunk_rows)
    arrays = {name: getattr(splats, name).copy() for name in Gradients.names()}
    arrays["opacities"].fill(-np.inf)
    for name in ("means", "opacities", "sh0", "shN"):
        arrays[name][rows] = getattr(encoded.decoded, name)
    turned = _facing(
        rotations.unit(encoded.decoded.quats), encoded.decoded.scales, splats.quats[rows]
    )
    arrays["quats"][rows], arrays["scales"][rows] = turned
    return RoundTrip(with_values(splats, arrays), encoded, chunk_rows)
