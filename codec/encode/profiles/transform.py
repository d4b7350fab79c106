"""Profile `transform`: quantiser steps follow from the picture error of each value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode import colour_transform
from cogsplat.codec.encode.colour_transform import ColourBasis
from cogsplat.codec.encode.config import Ablation
from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.rate import allocation, refinement_split, segment_order
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.rate.head_coarseness import FINE, HeadCoarseness, head_coarseness
from cogsplat.codec.segments.codebooks import ColourCodebook as DecodedColourCodebook
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import records, scalar, sh0_transform
from cogsplat.codec.streams.records import Attribute, Stream

from . import shapes
from .chunk_streams import chunk_means
from .colour_codebook import ColourCodebook
from .means import quantise_means
from .refined import NO_REFINEMENT, Refined, choose_refinement_bits, squared_error_drop
from .shape_codebook import IndexedShapes, ShapeCodebook
from .shapes import PlainShapes, ShapeSource

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TransformPlan:
    """Parameters of the profile that all chunks of a scene share.

    Parameters
    ----------
    lagrangian : float
        λ, from which each quantiser step follows: ``cost · step² = λ``.
    costs_of : callable
        Returns the `Costs` of a range of rows: squared error of the picture per squared error of
        each stored value.
    basis : ColourBasis or None
        Basis of shN; None at SH degree 0.
    basis_payloads : tuple of bytes
        Payload of each SH band of the basis.
    ablation : Ablation
        Techniques that are switched off.
    coarseness : mapping of int to HeadCoarseness
        Coarseness of each coarse head, by the first row of its chunk; the other heads are fine.
    codebook : ColourCodebook, optional
        Codebook of shN of the profile `vq`, for some of the chunks.
    shapes : ShapeCodebook, optional
        Codebook of shapes of the profile `vq`, for some of the chunks.
    """

    lagrangian: float
    costs_of: Callable[[slice], Costs]
    basis: ColourBasis | None
    basis_payloads: tuple[bytes, ...]
    ablation: Ablation
    coarseness: Mapping[int, HeadCoarseness]
    codebook: ColourCodebook | None = None
    shapes: ShapeCodebook | None = None

    @property
    def codebooks(self) -> list[EncodedCodebook]:
        """Codebooks of the file, numbered by their places."""
        out = []
        if self.basis is not None:
            out.append(EncodedCodebook("colour", len(self.basis.rows), self.basis_payloads))
        if self.codebook is not None:
            rows, payloads = len(self.codebook.rows), self.codebook.payloads
            out.append(EncodedCodebook("colour", rows, payloads))
        if self.shapes is not None:
            out.append(EncodedCodebook("shape", len(self.shapes.rows), (self.shapes.payload,)))
        return out

    @property
    def shapes_number(self) -> int:
        """Number of the codebook of shapes, the last."""
        return len(self.codebooks) - 1

    def with_codebook(self, codebook: ColourCodebook, chunks: int) -> TransformPlan:
        """Return the plan with a codebook of shN, and without a basis that no chunk needs.

        Parameters
        ----------
        codebook : ColourCodebook
            Codebook and the chunks that use it.
        chunks : int
            Number of all chunks.
        """
        if len(codebook.chunks) < chunks:
            return replace(self, codebook=codebook)
        return replace(self, codebook=codebook, basis=None, basis_payloads=())

    def colours_of(self, run: slice) -> tuple[ColourBasis | ColourCodebook | None, int]:
        """Return the encoder of a chunk's shN, and the number of its codebook.

        Parameters
        ----------
        run : slice
            Row range of the chunk.
        """
        if self.codebook is not None and run.start in self.codebook.chunks:
            return self.codebook, 0 if self.basis is None else 1
        return self.basis, 0


def plan(
    sh_degree: int,
    coefficients_of: Callable[[slice], F32],
    costs_of: Callable[[slice], Costs],
    energy: F64,
    basis_spread: F64,
    lagrangian: float,
    chunks: Sequence[slice],
    ablation: Ablation,
    contribution: F64 | None = None,
    missing_all: float = segment_order.MISSING_ALL,
    given: EncodedCodebook | None = None,
) -> TransformPlan:
    """Fit the basis of shN and choose the coarseness of each head of an ordered scene.

    Parameters
    ----------
    sh_degree : int
        SH degree of the scene, which has at least one row.
    coefficients_of : callable
        Returns the SH coefficients of a range of rows (`colour_transform.fit`).
    costs_of : callable
        Returns the `Costs` of a range of rows. Costs of a whole scene take three times the memory
        of its splats, so they are computed chunk by chunk. Their energy is limited as `energy` is.
    energy : (N,) float64
        `Costs.energy` of each row, with no colour step beyond the coarsest.
    basis_spread : (K-1, K-1) float64
        `Scores.basis_spread`.
    lagrangian : float
        λ of the encode.
    chunks : sequence of slice
        Row ranges of the chunks.
    ablation : Ablation
        Techniques that are switched off.
    contribution : (N,) float64, optional
        Contribution of each row, which decides the coarseness of heads. None makes all heads fine,
        without refinements.
    missing_all : float
        Squared error of an empty picture (`head_coarseness`).
    given : EncodedCodebook, optional
        Basis of shN to use; None to fit one.
    """
    coarseness = {}
    if contribution is not None:
        coarseness = head_coarseness(contribution, lagrangian, chunks, missing_all)
    basis: ColourBasis | None = None
    if sh_degree:
        spread = basis_spread if ablation.view_metric else np.zeros_like(basis_spread)
        if given is None:
            principal = ablation.colour_basis
            fitted = colour_transform.fit(
                coefficients_of, energy, spread, lagrangian, chunks, principal=principal
            )
            payloads = tuple(records.pack([b], digits=ablation.digits) for b in fitted.streams())
            given = EncodedCodebook("colour", len(fitted.rows), payloads)
        stored = given.decode(sh_degree)
        assert isinstance(stored, DecodedColourCodebook)
        basis = colour_transform.given_basis(stored.shN, spread)
    payloads = () if given is None else given.payloads
    return TransformPlan(lagrangian, costs_of, basis, payloads, ablation, coarseness)


def encode_chunk(part: Splats, plan_: TransformPlan, run: slice, sort: bool) -> Payloads:
    """Encode a chunk into head, refinement and tail, with planes still uncompressed.

    Parameters
    ----------
    part : Splats
        Splats of the chunk.
    plan_ : TransformPlan
        Parameters that all chunks share.
    run : slice
        Row range of the chunk in the planned scene.
    sort : bool
        Sort the chunk by Morton code.
    """
    lagrangian, used = plan_.lagrangian, plan_.ablation
    coarseness = plan_.coarseness.get(run.start, FINE)
    source = ShapeSource.of(part, plan_.costs_of(run), lagrangian)
    costs = source.costs
    # Scales come first: the decoded scales decide the bits of means and rotations.
    stored: PlainShapes | IndexedShapes
    if plan_.shapes is not None and run.start in plan_.shapes.chunks:
        stored = plan_.shapes.quantise(source, lagrangian, plan_.shapes_number)
    else:
        stored = PlainShapes.of(source, lagrangian, used, coarseness.scales)
    if used.fine_means:
        inside, means, refined_means = choose_refinement_bits(
            lambda bits: quantise_means(
                part.means, stored.head_scales, costs.mean, lagrangian, bits, sort
            ),
            coarseness.means,
        )
    else:
        step = allocation.equal_step(lagrangian, costs.mean)
        inside, means, _ = chunk_means(part.means, step, sort)
        refined_means = NO_REFINEMENT
    # From here on in the order that the chunk is stored in.
    part, costs, scales = part.take(inside), costs.take(inside), stored.scales[inside]
    shape_streams, refined_scales = stored.write(inside)
    sh0 = part.sh0.astype(np.float64)
    tail: bytes | None = None
    colours, book = plan_.colours_of(run)
    if colours is not None:
        stream, missed = colours.encode(part.shN, costs.energy, lagrangian, book)
        if used.sh0_makes_up:
            # What shN lost, as its views see it on average.
            sh0 += np.einsum("nk,nkc->nc", costs.basis_mean, missed) / C0
        tail = records.pack_uncompressed([stream])
    before = source.scales[inside] if used.areas else scales
    logits = shapes.opacities_to_store(part.opacities, before, scales)
    opacities = refinement_split.split(
        Attribute.OPACITIES,
        logits,
        grids.fit(logits, allocation.equal_step(lagrangian, costs.opacity)),
        costs.opacity,
        coarseness.opacities,
    )
    opacity_drop = float(costs.opacity @ squared_error_drop(opacities, logits)[:, 0])
    sh0_stream, refined_colours = _sh0(sh0, costs.energy, lagrangian, coarseness.sh0)
    head = [
        *shape_streams,
        means,
        scalar.write(Attribute.OPACITIES, opacities.coarse, opacities.grid),
        sh0_stream,
    ]
    refined = [
        refined_scales,
        refined_means,
        Refined(opacities.digits, opacity_drop),
        refined_colours,
    ]
    streams = [part.stream for part in refined if part.stream is not None]
    return Payloads(
        records.pack_uncompressed(head),
        tail,
        stored.needs,
        (book,) if tail is not None else (),
        inside,
        records.pack_uncompressed(streams) if streams else None,
        sum(part.distortion_drop for part in refined),
    )


def _sh0(
    values: F64, energy: F64, lagrangian: float, most: tuple[int, ...]
) -> tuple[Stream, Refined]:
    """Quantise sh0 on the principal axes of its chunk (Karhunen-Loève transform)."""
    weights = energy / energy.sum()
    centred = values - weights @ values
    moments = np.einsum("n,ni,nj->ij", weights, centred, centred)
    _, vectors = np.linalg.eigh(moments)
    # Signs of eigenvectors are arbitrary: the largest entry is made positive.
    largest = vectors[np.abs(vectors).argmax(axis=0), np.arange(3)]
    axes = (vectors * np.where(largest < 0, -1, 1))[:, ::-1].T.astype(np.float32)
    axes = np.clip(axes, -1, 1)
    on_axes = np.linalg.solve(axes.T.astype(np.float64), values.T).T.astype(np.float32)
    step = allocation.equal_step(lagrangian, energy * rate_costs.SH0_COST * rate_costs.SH0_WEIGHT)
    parts = refinement_split.split(Attribute.SH0, on_axes, grids.fit(on_axes, step), energy, most)
    stream = sh0_transform.write(parts.coarse, axes, parts.grid)
    missed = squared_error_drop(parts, on_axes) @ np.square(axes.astype(np.float64)).sum(axis=1)
    return stream, Refined(parts.digits, float(rate_costs.SH0_COST * (energy @ missed)))
