"""Bit slopes: by how many bits a stored scene grows where one of its values moves."""

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
from cogsplat.codec.streams.records import INFINITIES, Attribute, Kind, StoredStream

from .differentiable_rendering import Gradients

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ERROR_PER_BIT: Final = float(np.log(2.0)) / 6.0
"""Squared error that a bit is worth, in units of λ: what one more bit of any value removes.

An error that costs λ/12, of a step Δ with ``cost · Δ² = λ``, falls by 2·ln 2 times itself with each
bit (uniform quantisation; Gish and Pierce 1968)."""

# Counted beside every code, so that codes which no value has are dear and not infinitely so
# (Krichevsky and Trofimov 1981).
_PRIOR: Final = 0.5
# Factor of the width over which counts are averaged (Silverman 1986, section 3.4.2), and the codes
# below which it is none: where few codes are in use, each has a number of bits of its own.
_SILVERMAN: Final = 0.9
_LEAST_WIDTH: Final = 0.5


def bits_per_step(positions: F64) -> F64:
    """Return the bits that each value takes more if it moves by one step.

    Each code takes ``-log2`` of its share of all; between two codes the bits run straight.

    Parameters
    ----------
    positions : (n, c) float64
        Values in steps, before they are rounded; each column has codes of its own.

    Returns
    -------
    (n, c) float64
    """
    slopes = np.empty_like(positions)
    for column, values in enumerate(positions.T):
        codes = np.rint(values).astype(np.int64)
        first = int(codes.min()) - 1
        counts = np.bincount(codes - first, minlength=int(codes.max()) - first + 2)
        bits = -np.log2(_smoothed(counts.astype(np.float64), values) + _PRIOR)
        below = np.floor(values).astype(np.int64) - first
        below = np.clip(below, 0, len(bits) - 2)
        slopes[:, column] = bits[below + 1] - bits[below]
    return slopes


def _smoothed(counts: F64, values: F64) -> F64:
    """Average the counts of neighbouring codes as far as so many values tell them apart."""
    quartiles = np.quantile(values, (0.25, 0.75))
    spread = min(float(values.std()), float(quartiles[1] - quartiles[0]) / 1.34)
    width = _SILVERMAN * spread * len(values) ** -0.2
    if width < _LEAST_WIDTH:
        return counts
    reach = int(np.ceil(3 * width))
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / width))
    padded: F64 = np.convolve(counts, weights / weights.sum(), mode="full")
    return padded[reach : reach + len(counts)]


@dataclass(frozen=True, eq=False)
class _Streams:
    """The streams of a chunk by what they store, and those that refine them."""

    stored: dict[Attribute, StoredStream]
    finer: dict[Attribute, StoredStream]

    @classmethod
    def of(cls, payloads: Payloads, rows: int) -> _Streams:
        """Return those of the payloads of a chunk."""
        parts = [(payloads.head, "head"), (payloads.tail or b"", "tail")]
        stored = [
            stream
            for payload, where in parts
            if payload
            for stream in records.unpack(memoryview(payload), where, rows)
        ]
        refined = memoryview(payloads.refinement or b"")
        finer = records.unpack(refined, "refinement", rows) if refined else []
        return cls({s.attribute: s for s in stored}, {s.attribute: s for s in finer})

    def of_kind(self, attribute: Attribute, kind: Kind) -> StoredStream | None:
        """Return what stores an attribute, None where that is of another kind."""
        stream = self.stored.get(attribute)
        return stream if stream is not None and stream.kind is kind else None

    def finest(self, attribute: Attribute, grid: Grid) -> Grid:
        """Return the grid that an attribute lies on once it is refined."""
        digits = self.finer.get(attribute)
        if digits is None:
            return grid
        return refinement_digits.parse(digits, grid.components)[0]


def rate_gradients(encoded: EncodedScene, splats: Splats, rows: Sequence[I64]) -> Gradients:
    """Return by how many bits a stored scene grows where one of its values moves.

    What is entropy-coded on a grid of its chunk counts: opacities, the differences of scales, and
    SH on the axes of the chunk and of the scene. Of means and rotations the number of bits follows
    from the shape of the splat, and not from their values.

    Parameters
    ----------
    encoded : EncodedScene
    splats : Splats
        The scene as it is trained, of which `encoded` was made.
    rows : sequence of (n,) int64
        The rows of `splats` that each chunk stores.

    Returns
    -------
    Gradients
        Bits by every value of `splats`, in their units; 0 for splats that no chunk stores.
    """
    slopes = Gradients.zeros(splats)
    bases = {
        number: book.decoded(splats.sh_degree)
        for number, book in enumerate(encoded.codebooks)
        if book.attribute == "colour"
    }
    for chunk, own in zip(encoded.chunks, rows, strict=True):
        streams = _Streams.of(chunk.payloads, chunk.splats)
        slopes.opacities[own] = _of_opacities(streams, splats.opacities[own])
        slopes.scales[own] = _of_scales(streams, splats.scales[own])
        slopes.sh0[own] = _of_sh0(streams, splats.sh0[own])
        tail = streams.of_kind(Attribute.SHN, Kind.BASIS)
        if tail is not None:
            book = bases[shn_transform.codebook_use(tail).number]
            if isinstance(book, ColourCodebook):
                basis = book.shN.reshape(len(book), -1)
                slopes.shN[own] = _of_sh_n(tail, basis, splats.shN[own])
    return slopes


def _of_opacities(streams: _Streams, logits: F32) -> F32 | float:
    stream = streams.of_kind(Attribute.OPACITIES, Kind.SCALAR)
    if stream is None or stream.flags & INFINITIES:
        return 0.0
    grid = streams.finest(Attribute.OPACITIES, scalar.parse(stream, 1))
    return _on_grid(logits[:, None], grid)[:, 0]


def _of_scales(streams: _Streams, scales: F32) -> F32 | float:
    stream = streams.of_kind(Attribute.SCALES, Kind.DIFFERENCES)
    if stream is None:
        return 0.0
    grid = streams.finest(Attribute.SCALES, scalar.parse(stream, 3))
    order = np.argsort(scales, axis=1, kind="stable")[:, [1, 0, 2]]
    sorted_scales = np.take_along_axis(scales, order, axis=1)
    by = _on_grid(scale_differences.differences_of(sorted_scales), grid)
    by_sorted = np.stack([by[:, 2] - by[:, 1], -by[:, 2], by[:, 0] + by[:, 1]], axis=1)
    slopes = np.empty_like(scales)
    np.put_along_axis(slopes, order, by_sorted, axis=1)
    return slopes


def _of_sh0(streams: _Streams, values: F32) -> F32 | float:
    plain = streams.of_kind(Attribute.SH0, Kind.SCALAR)
    if plain is not None:
        return _on_grid(values, streams.finest(Attribute.SH0, scalar.parse(plain, 3)))
    stream = streams.of_kind(Attribute.SH0, Kind.BASIS)
    if stream is None:
        return 0.0
    grid, axes = sh0_transform.parse(stream)
    # Coordinates times axes are colours: coordinates are colours times the inverse.
    inverse = np.linalg.pinv(axes.astype(np.float64)).astype(np.float32)
    by_coordinates = _on_grid(values @ inverse, streams.finest(Attribute.SH0, grid))
    return by_coordinates @ inverse.T


def _of_sh_n(stream: StoredStream, basis: F32, values: F32) -> F32:
    found = shn_transform.parse(stream, basis)
    rows = basis[: found.width].astype(np.float64)
    # As near as colours that are even in all directions ask for; the encoder weighs directions.
    inverse = np.linalg.pinv(rows)
    positions = values.reshape(len(values), -1) @ inverse / found.step
    by_coefficients = (bits_per_step(positions) / found.step) @ inverse.T
    slopes: F32 = by_coefficients.reshape(values.shape).astype(np.float32)
    return slopes


def _on_grid(values: F32, grid: Grid) -> F32:
    """Return the bits by (n, c) values that lie on a grid of the chunk's own."""
    step = np.where(grid.step > 0, grid.step, np.float32(1)).astype(np.float64)
    positions = (values.astype(np.float64) - grid.minimum) / step
    slopes: F32 = np.where(grid.step > 0, bits_per_step(positions) / step, 0.0).astype(np.float32)
    return slopes
