"""Rate gradients: by how many bits an encoded scene grows when one of its values moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.segments.codebooks import ColourCodebook
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import (
    records,
    refinement_digits,
    scalar,
    scale_differences,
    sh0_transform,
    shn_transform,
)
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute, Kind, StoredStream

from .differentiable_rendering import Gradients

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ERROR_PER_BIT: Final = float(np.log(2.0)) / 6.0
"""Squared error that one more bit of any value removes, in units of λ.

A uniform quantiser with step Δ has the mean squared error λ/12 where ``cost · Δ² = λ``. One bit
more reduces it by 2·ln 2 times itself (Gish and Pierce 1968)."""

# Added to the count of every code, so that unused codes have a finite cost (Krichevsky and Trofimov
# 1981).
_PRIOR_COUNT: Final = 0.5
# Factor of Silverman's kernel width (1986, section 3.4.2) for smoothing counts, and the width in
# codes below which counts are not smoothed: with few codes in use, each has a cost of its own.
_SILVERMAN_FACTOR: Final = 0.9
_MIN_WIDTH: Final = 0.5


def bits_per_step(positions: F64) -> F64:
    """Return the additional bits of each value if it moves up by one quantiser step.

    A code costs ``-log2`` of its relative frequency. The cost is linear between two codes.

    Parameters
    ----------
    positions : (n, c) float64
        Values in quantiser steps, before rounding. Each column has its own code frequencies.

    Returns
    -------
    (n, c) float64
        Bits per step.
    """
    slopes = np.empty_like(positions)
    for column, values in enumerate(positions.T):
        codes = np.rint(values).astype(np.int64)
        first = int(codes.min()) - 1
        counts = np.bincount(codes - first, minlength=int(codes.max()) - first + 2)
        bits = -np.log2(_smooth_counts(counts.astype(np.float64), values) + _PRIOR_COUNT)
        below = np.floor(values).astype(np.int64) - first
        below = np.clip(below, 0, len(bits) - 2)
        slopes[:, column] = bits[below + 1] - bits[below]
    return slopes


def _smooth_counts(counts: F64, values: F64) -> F64:
    """Smooth a histogram of codes with a Gaussian kernel of Silverman's width.

    Parameters
    ----------
    counts : (k,) float64
        Number of values at each code.
    values : (n,) float64
        Values before rounding, in steps; their spread sets the width of the kernel.
    """
    quartiles = np.quantile(values, (0.25, 0.75))
    spread = min(float(values.std()), float(quartiles[1] - quartiles[0]) / 1.34)
    width = _SILVERMAN_FACTOR * spread * len(values) ** -0.2
    if width < _MIN_WIDTH:
        return counts
    reach = int(np.ceil(3 * width))
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / width))
    padded: F64 = np.convolve(counts, weights / weights.sum(), mode="full")
    return padded[reach : reach + len(counts)]


@dataclass(frozen=True, eq=False)
class _Streams:
    """Streams of a chunk by attribute: head and tail without escape rows, and refinements."""

    main: dict[Attribute, StoredStream]
    refinements: dict[Attribute, StoredStream]

    @classmethod
    def of(cls, payloads: Payloads, rows: int) -> _Streams:
        """Parse the payloads of a chunk with `rows` splats."""
        parts = [(payloads.head, "head"), (payloads.tail or b"", "tail")]
        main = [
            stream
            for payload, where in parts
            if payload
            for stream in records.unpack(memoryview(payload), where, rows)
            if not stream.flags & ESCAPE
        ]
        payload = memoryview(payloads.refinement or b"")
        refinements = records.unpack(payload, "refinement", rows) if payload else []
        return cls({s.attribute: s for s in main}, {s.attribute: s for s in refinements})

    def of_kind(self, attribute: Attribute, kind: Kind) -> StoredStream | None:
        """Return the stream of an attribute if it has a given kind, else None."""
        stream = self.main.get(attribute)
        return stream if stream is not None and stream.kind is kind else None

    def finest(self, attribute: Attribute, grid: Grid) -> Grid:
        """Return the quantiser grid of an attribute after refinement.

        Parameters
        ----------
        attribute : Attribute
            Attribute of the grid.
        grid : Grid
            Quantiser grid of the attribute's stream in the head or tail.
        """
        digits = self.refinements.get(attribute)
        if digits is None:
            return grid
        return refinement_digits.parse(digits, grid.components)[0]


def rate_gradients(encoded: EncodedScene, splats: Splats, rows: Sequence[I64]) -> Gradients:
    """Return the gradient of the encoded size w.r.t. all values of a scene, in bits.

    It covers values that are entropy-coded on a grid of their chunk: opacities, differences of
    scales, and SH coefficients on the axes of the chunk or the scene. It is 0 for means and
    rotations, whose bits depend on the shape of the splat alone, and for what a codebook holds.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene.
    splats : Splats
        Scene in training that was encoded.
    rows : sequence of (n,) int64
        Rows of `splats` that each chunk holds.

    Returns
    -------
    Gradients
        Bits per unit of each value; 0 for splats that no chunk holds.
    """
    gradients = Gradients.zeros(splats)
    bases = {
        number: book.decode(splats.sh_degree)
        for number, book in enumerate(encoded.codebooks)
        if book.attribute == "colour"
    }
    for chunk, chunk_rows in zip(encoded.chunks, rows, strict=True):
        streams = _Streams.of(chunk.payloads, chunk.splats)
        gradients.opacities[chunk_rows] = _opacity_gradients(streams, splats.opacities[chunk_rows])
        gradients.scales[chunk_rows] = _scale_gradients(streams, splats.scales[chunk_rows])
        gradients.sh0[chunk_rows] = _sh0_gradients(streams, splats.sh0[chunk_rows])
        tail = streams.of_kind(Attribute.SHN, Kind.BASIS)
        if tail is not None:
            book = bases[shn_transform.codebook_use(tail).number]
            if isinstance(book, ColourCodebook):
                basis = book.shN.reshape(len(book), -1)
                gradients.shN[chunk_rows] = _shn_gradients(tail, basis, splats.shN[chunk_rows])
    return gradients


def _opacity_gradients(streams: _Streams, logits: F32) -> F32 | float:
    """Return the gradient of a chunk's size w.r.t. opacity logits, (n,), bits."""
    stream = streams.of_kind(Attribute.OPACITIES, Kind.SCALAR)
    if stream is None or stream.flags & INFINITIES:
        return 0.0
    grid = streams.finest(Attribute.OPACITIES, scalar.parse(stream, 1))
    return _grid_gradients(logits[:, None], grid)[:, 0]


def _scale_gradients(streams: _Streams, scales: F32) -> F32 | float:
    """Return the gradient of a chunk's size w.r.t. log scales, (n, 3), bits."""
    stream = streams.of_kind(Attribute.SCALES, Kind.DIFFERENCES)
    if stream is None:
        return 0.0
    grid = streams.finest(Attribute.SCALES, scalar.parse(stream, 3))
    order = np.argsort(scales, axis=1, kind="stable")[:, [1, 0, 2]]
    sorted_scales = np.take_along_axis(scales, order, axis=1)
    by = _grid_gradients(scale_differences.differences_of(sorted_scales), grid)
    by_sorted = np.stack([by[:, 2] - by[:, 1], -by[:, 2], by[:, 0] + by[:, 1]], axis=1)
    gradients = np.empty_like(scales)
    np.put_along_axis(gradients, order, by_sorted, axis=1)
    return gradients


def _sh0_gradients(streams: _Streams, values: F32) -> F32 | float:
    """Return the gradient of a chunk's size w.r.t. DC coefficients, (n, 3), bits."""
    plain = streams.of_kind(Attribute.SH0, Kind.SCALAR)
    if plain is not None:
        return _grid_gradients(values, streams.finest(Attribute.SH0, scalar.parse(plain, 3)))
    stream = streams.of_kind(Attribute.SH0, Kind.BASIS)
    if stream is None:
        return 0.0
    grid, axes = sh0_transform.parse(stream)
    # Values are coordinates times axes, so coordinates are values times the inverse.
    inverse = np.linalg.pinv(axes.astype(np.float64)).astype(np.float32)
    by_coordinates = _grid_gradients(values @ inverse, streams.finest(Attribute.SH0, grid))
    return by_coordinates @ inverse.T


def _shn_gradients(stream: StoredStream, basis: F32, values: F32) -> F32:
    """Return the gradient of a chunk's size w.r.t. higher SH coefficients, (n, K-1, 3), bits."""
    found = shn_transform.parse(stream, basis)
    rows = basis[: found.width].astype(np.float64)
    # The pseudo-inverse weighs all directions equally; the encoder weighs them by visibility.
    inverse = np.linalg.pinv(rows)
    positions = values.reshape(len(values), -1) @ inverse / found.step
    by_coefficients = (bits_per_step(positions) / found.step) @ inverse.T
    gradients: F32 = by_coefficients.reshape(values.shape).astype(np.float32)
    return gradients


def _grid_gradients(values: F32, grid: Grid) -> F32:
    """Return the gradient of the size of (n, c) values that are coded on a grid, bits per unit."""
    step = np.where(grid.step > 0, grid.step, np.float32(1)).astype(np.float64)
    positions = (values.astype(np.float64) - grid.minimum) / step
    slopes = np.where(grid.step > 0, bits_per_step(positions) / step, 0.0)
    gradients: F32 = slopes.astype(np.float32)
    return gradients
