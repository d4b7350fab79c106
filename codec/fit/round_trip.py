"""Encode-decode round trips of a scene in training, splat by splat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import PreparedScene
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.geometry import rotations
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients, with_values

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RoundTrip:
    """A scene in training after encoding and decoding.

    Parameters
    ----------
    decoded : Splats
        Decoded values in the row order of the scene in training. The axes of each splat are
        permuted to match its quaternion in training. Pruned splats have a logit of -inf.
    encoded : EncodedScene
        Encoded scene, without compensation and predicted quality.
    rows : sequence of (n,) int64
        Rows of the scene in training that each chunk holds, in the order of the chunk.
    """

    decoded: Splats
    encoded: EncodedScene
    rows: Sequence[NDArray[np.int64]]


def _align_axes(quats: F32, scales: F32, reference_quats: F32) -> tuple[F32, F32]:
    """Permute and flip the axes of Gaussians so that they match reference rotations.

    The codec permutes the axes of splats. Straight-through gradients need decoded values near the
    values in training.

    Parameters
    ----------
    quats, scales : (n, 4), (n, 3) float32
        Unit quaternions, wxyz, and log scales of the decoded Gaussians.
    reference_quats : (n, 4) float32
        Quaternions to match, wxyz, of any norm.

    Returns
    -------
    quats, scales : (n, 4), (n, 3) float32
        The same Gaussians; the quaternions have the norm and the sign of `reference_quats`.
    """
    norms = np.linalg.norm(reference_quats, axis=1, keepdims=True)
    reference = reference_quats / norms.astype(np.float64)
    inverse = reference * np.array([1.0, -1.0, -1.0, -1.0])
    relative = rotations.multiply(inverse, quats.astype(np.float64))
    nearest, permuted = rotations.largest_w(relative.astype(np.float32), scales)
    aligned = rotations.multiply(reference, nearest.astype(np.float64)) * norms
    return aligned.astype(np.float32), permuted


def round_trip(
    prepared: PreparedScene,
    splats: Splats,
    quality_db: float,
    codebooks: Sequence[EncodedCodebook] = (),
) -> RoundTrip:
    """Encode and decode a scene in training, with the order and scores of an earlier state.

    Parameters
    ----------
    prepared : PreparedScene
        Order and scores, computed from an earlier state of the scene. The scores decide the
        quantiser steps.
    splats : Splats
        Scene in training, in the row order of `prepared`.
    quality_db : float
        Nominal quality, dB.
    codebooks : sequence of EncodedCodebook
        Codebooks of the last encode, from which k-means of the profile ``vq`` starts.

    Returns
    -------
    RoundTrip
    """
    now = replace(prepared, source=splats, codebooks=codebooks)
    layout = now.lay_out(quality_db)
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
    aligned = _align_axes(
        rotations.unit(encoded.decoded.quats), encoded.decoded.scales, splats.quats[rows]
    )
    arrays["quats"][rows], arrays["scales"][rows] = aligned
    return RoundTrip(with_values(splats, arrays), encoded, chunk_rows)
