"""Codebook of shN of the profile `vq`; indices have the least error plus price of the bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import entropy_kmeans
from cogsplat.codec.clustering.entropy_kmeans import RatedRows
from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.colour_transform import ColourBasis, band_streams
from cogsplat.codec.rate import allocation
from cogsplat.codec.segments.codebooks import decode_colour_codebook
from cogsplat.codec.streams import codebook_index, records
from cogsplat.codec.streams.records import Attribute, Stream

from .refined import entropy_bits

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Rows at the start of training; a row that saves fewer bits than it takes is dropped.
_SPLATS_PER_ROW: Final = 128
_MOST_ROWS: Final = 512

# Bits of a coefficient of a row in the file: 5 to 8 in trained scenes.
_BITS_PER_COEFFICIENT: Final = 6.0

# Error that a bit is worth where a codebook is chosen, relative to other values. Rows are off in
# the same way for all splats of a surface, and such errors add up in a pixel. Bytes at equal
# held-out PSNR against the basis alone, at 34, 37 and 40 dB nominal: a captured room takes 4.8, 2.7
# and 2.1 % more at 1, and 2.5, 1.5 and 0.5 % less at 1/3; a house 0.8, 1.9 and 0 % less at 1/3.
_INDEX_PRICE: Final = 1 / 3

# Share of the iterations before the chunks are chosen that use the codebook.
_FIRST_SHARE: Final = 1 / 3


@dataclass(frozen=True, eq=False)
class ColourCodebook:
    """Codebook of shN, and the chunks in which it costs less than the basis.

    Parameters
    ----------
    payloads : tuple of bytes
        Payload of each SH band.
    rows : (C, K-1, 3) float32
        Decoded rows.
    search_rows : RatedRows
        Coordinates of the rows on `basis`, and the bits of their indices.
    basis : ColourBasis
        Basis of shN, whose metric measures errors.
    chunks : frozenset of int
        First rows of the chunks that use the codebook.
    """

    payloads: tuple[bytes, ...]
    rows: F32
    search_rows: RatedRows
    basis: ColourBasis
    chunks: frozenset[int] = frozenset()

    def encode(
        self, coefficients: F32, energy: F64, lagrangian: float, codebook: int
    ) -> tuple[Stream, F64]:
        """Return the shN stream of a chunk, and the source minus the decoded coefficients.

        Parameters
        ----------
        coefficients, energy, lagrangian, codebook
            As in `ColourBasis.encode`.
        """
        coordinates = self.basis.coordinates(coefficients).astype(np.float32)
        price = _price(lagrangian)
        labels, _, _ = self.search_rows.assign(coordinates, allocation.shn_cost(energy), price)
        indices = labels.astype(np.uint32)
        stream = codebook_index.write(Attribute.SHN, indices, codebook, len(self.rows))
        missed = coefficients.astype(np.float64) - self.rows[labels]
        return stream, missed


def fit(
    basis: ColourBasis,
    coefficients_of: Callable[[slice], F32],
    energy: F64,
    lagrangian: float,
    chunks: Sequence[slice],
    training: TrainingConfig,
    start: F32 | None = None,
) -> ColourCodebook | None:
    """Train a codebook of shN and choose its chunks; None if it saves less than its rows.

    Parameters
    ----------
    basis : ColourBasis
        Basis of the scene, in which the other chunks are stored.
    coefficients_of : callable
        Returns the coefficients of a range of rows, (n, K-1, 3) float32.
    energy : (N,) float64
        Positive energy of each splat.
    lagrangian : float
        λ of the encode.
    chunks : sequence of slice
        Row ranges of the chunks, at least one.
    training : TrainingConfig
        Iterations and training vectors at most.
    start : (c, K-1, 3) float32, optional
        Rows of an earlier codebook to start from.

    Notes
    -----
    Splats that many pictures show get finer coordinates on the basis than any codebook has. Most of
    the others need few values, which one index holds. Each chunk takes the cheaper of both. Chunks
    hold splats of similar contribution.
    """
    price = _price(lagrangian)

    def cost(coder: ColourBasis | ColourCodebook, run: slice) -> float:
        """Return error plus price of the bits of a chunk."""
        stream, missed = coder.encode(coefficients_of(run), energy[run], lagrangian, 0)
        return basis.error(missed, energy[run]) + price * entropy_bits(stream)

    on_basis = np.array([cost(basis, run) for run in chunks])
    saved = np.ones(len(chunks))
    rows = None if start is None else basis.coordinates(start).astype(np.float32)
    first = max(1, round(_FIRST_SHARE * training.iterations))
    for iterations in (first, max(1, training.iterations - first)):
        own = [run for run, gain in zip(chunks, saved, strict=True) if gain > 0]
        if not own:
            return None
        found = _train(
            basis,
            coefficients_of,
            energy,
            lagrangian,
            own,
            replace(training, iterations=iterations),
            rows,
        )
        saved = on_basis - [cost(found, run) for run in chunks]
        rows = found.search_rows.rows
    used = frozenset(run.start for run, gain in zip(chunks, saved, strict=True) if gain > 0)
    taken = 8 * price * sum(len(payload) for payload in found.payloads)
    if len(used) == len(chunks):
        # Nothing needs the basis then.
        taken -= price * sum(entropy_bits(stream) for stream in basis.streams())
    return replace(found, chunks=used) if saved[saved > 0].sum() > taken else None


def _price(lagrangian: float) -> float:
    """Return the error that a bit is worth where a codebook is chosen."""
    return _INDEX_PRICE * allocation.bit_price(lagrangian)


def _train(
    basis: ColourBasis,
    coefficients_of: Callable[[slice], F32],
    energy: F64,
    lagrangian: float,
    chunks: Sequence[slice],
    training: TrainingConfig,
    start: F32 | None,
) -> ColourCodebook:
    """Train a codebook on the splats of some chunks; `start` are coordinates of initial rows."""
    count = sum(run.stop - run.start for run in chunks)
    share = min(1.0, training.samples / count)
    rng = np.random.default_rng(training.seed)
    vectors, weights = [], []
    for run in chunks:
        taken = np.flatnonzero(rng.random(run.stop - run.start) < share)
        vectors.append(basis.coordinates(coefficients_of(run)[taken]).astype(np.float32))
        weights.append(allocation.shn_cost(energy[run][taken]))
    sample, costs = np.concatenate(vectors), np.concatenate(weights)
    price = _price(lagrangian)
    trained = entropy_kmeans.train(
        sample,
        costs,
        min(max(count // _SPLATS_PER_ROW, 1), _MOST_ROWS),
        price,
        # A sample saves its share of the bits only.
        share * _BITS_PER_COEFFICIENT * basis.rows.shape[1],
        training,
        start,
    )
    labels, _, _ = trained.assign(sample, costs, price)
    mass = np.bincount(labels, costs / share, minlength=len(trained.rows))
    mean = np.maximum(mass, costs.min(initial=np.inf)).mean() if len(costs) else 1.0
    step = np.sqrt(lagrangian / (mean * np.diagonal(basis.metric)))
    coefficients = (trained.rows.astype(np.float64) @ basis.rows).astype(np.float32)
    payloads = tuple(records.pack([band]) for band in band_streams(coefficients, step))
    views = {band: memoryview(payload) for band, payload in enumerate(payloads, start=1)}
    rows = decode_colour_codebook(views, len(coefficients), len(payloads), "codebook").shN
    search_rows = RatedRows(basis.coordinates(rows).astype(np.float32), trained.bits)
    return ColourCodebook(payloads, rows, search_rows, basis)
