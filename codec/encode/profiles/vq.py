"""Profile `vq`: shape and colour codebooks, escape rows in the chunk (Niedermayr et al.)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import kmeans
from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.geometry import covariance, rotations
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate.costs import limit_colour_steps
from cogsplat.codec.rate.energy_costs import SHN_COST, EnergyCosts
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import codebook_index, kinds, quaternion, records, scalar
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.records import SH_BANDS, Attribute, Stream

from .chunk_streams import chunk_means, chunk_opacities

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U32 = NDArray[np.uint32]

# Extra bits of an escape row compared with a codebook index.
_ESCAPE_SHAPE_BITS: Final = 26.0
_ESCAPE_COLOUR_BITS_PER_VALUE: Final = 1.6

# Squared error of the picture per energy and squared distance of shape vectors, as the costs of
# `allocation`: measured with codebooks of 1024 and 4096 rows on trained scenes.
_SHAPE_COST: Final = 0.25

_SPLATS_PER_SHAPE_ROW: Final = 16
_SPLATS_PER_COLOUR_ROW: Final = 32
MAX_ROWS: Final = 4096  # Niedermayr et al., section 3.2


@dataclass(frozen=True, eq=False)
class VqPlan:
    """Trained codebooks, and the codebook row of each splat.

    Parameters
    ----------
    costs : EnergyCosts
        Costs of each splat.
    quats : (N, 4) float32
        Unit quaternions, with axes renamed so that w is the largest component.
    scales : (N, 3) float32
        Log scales of the renamed axes.
    factors : (N,) float32
        Log of the size factor, which the shape vectors leave out.
    shape_payload : bytes
        Payload of the shape codebook.
    shape_rows : int
        Rows of the shape codebook.
    shape_indices : (N,) uint32
        Row of the shape codebook.
    shape_escape : (N,) bool
        Mask of splats stored as escape rows in the chunk.
    colour_payloads : tuple of bytes
        Payload of each SH band; empty without a colour codebook.
    colour_rows : int
        Rows of the colour codebook.
    colour_indices : (N,) uint32
        Row of the colour codebook.
    colour_escape : (N,) bool
        Mask of splats whose colour is an escape row.
    """

    costs: EnergyCosts
    quats: F32
    scales: F32
    factors: F32
    shape_payload: bytes
    shape_rows: int
    shape_indices: U32
    shape_escape: NDArray[np.bool_]
    colour_payloads: tuple[bytes, ...]
    colour_rows: int
    colour_indices: U32
    colour_escape: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class VqStart:
    """Initial codebooks of a training, from an earlier encode of nearly the same scene.

    Parameters
    ----------
    shapes : (C, 6) float32 or None
        Shape vectors (`covariance.shape_vectors`).
    colours : (D, 3·(K-1)) float32 or None
        SH coefficients above DC.
    """

    shapes: F32 | None = None
    colours: F32 | None = None


MAX_COEFFICIENT: Final = 1e4
"""Limit of SH coefficients, either sign. One such splat saturates a pixel at the least alpha; an
outlier would coarsen the steps of all values on its grid."""

MAX_LOG_SCALE: Final = 40.0
"""Limit of log scales, either sign: deviations of 4e-18 and 2e17 scene units."""

SHAPE_CODEBOOK: Final = 0
COLOUR_CODEBOOK: Final = 1


def codebook_rows(splats: int, per_row: int) -> int:
    """Return the number of codebook rows: a power of two in proportion to the scene.

    Parameters
    ----------
    splats : int
        Number of splats.
    per_row : int
        Splats per row at least.
    """
    wanted = max(splats // per_row, 1)
    return min(1 << (wanted.bit_length() - 1), MAX_ROWS)


def clip_coefficients(values: F32) -> F32:
    """Clip SH coefficients to ±`MAX_COEFFICIENT`.

    Parameters
    ----------
    values : float32 array
        Coefficients; returned without a copy if all are within the limit.
    """
    return _clip(values, MAX_COEFFICIENT)


def clip_outliers(splats: Splats) -> Splats:
    """Clip the scales of a scene to ±`MAX_LOG_SCALE` and its SH to ±`MAX_COEFFICIENT`.

    Parameters
    ----------
    splats : Splats
        Scene to clip.
    """
    return replace(
        splats,
        scales=_clip(splats.scales, MAX_LOG_SCALE),
        sh0=clip_coefficients(splats.sh0),
        shN=clip_coefficients(splats.shN),
    )


def _clip(values: F32, limit: float) -> F32:
    """Clip values to a limit of either sign, without a copy where none exceeds it."""
    # Check first: hardly any scene has outliers, and a copy of shN is large.
    if -float(values.min(initial=0)) > limit or float(values.max(initial=0)) > limit:
        return np.clip(values, -limit, limit)
    return values


def plan(
    splats: Splats,
    energy: F64,
    lagrangian: float,
    *,
    training: TrainingConfig,
    threads: int,
    progress: Progress,
    start: VqStart | None = None,
) -> VqPlan:
    """Train the codebooks of a scene and assign its splats.

    Parameters
    ----------
    splats : Splats
        Valid rows, at least one, after `clip_outliers`.
    energy : (N,) float64
        Positive energy of each splat.
    lagrangian : float
        λ of `allocation.lagrangian`.
    training : TrainingConfig
        k-means settings.
    threads : int
        Number of threads, 0 for all cores.
    progress : Progress
        Called with ``codebooks``.
    start : VqStart, optional
        Initial codebooks.
    """
    progress("codebooks", 0, 2)
    start = start or VqStart()
    costs = EnergyCosts(lagrangian, energy)
    quats, scales = rotations.largest_w(rotations.unit(splats.quats), splats.scales)
    factors = covariance.scale_factor(scales)
    vectors = covariance.shape_vectors(quats, scales)
    rows = kmeans.train(
        vectors,
        energy,
        codebook_rows(len(splats), _SPLATS_PER_SHAPE_ROW),
        training,
        start=start.shapes,
    )
    indices, _ = kmeans.nearest(vectors, rows, threads)
    payload, rows = _store_shapes(rows, indices, costs)
    indices, errors = kmeans.nearest(vectors, rows, threads)
    # At equal λ, the bits that remove an error cost dD/dR = 2·ln2·λ/12 each.
    per_bit = 2 * np.log(2) * lagrangian / 12
    escape = energy * errors * _SHAPE_COST > _ESCAPE_SHAPE_BITS * per_bit
    progress("codebooks", 1, 2)
    colour_payloads: tuple[bytes, ...] = ()
    colour_rows, colour_indices = 0, np.zeros(len(splats), np.uint32)
    colour_escape = np.zeros(len(splats), np.bool_)
    if splats.sh_degree:
        coefficients = splats.shN.reshape(len(splats), -1)
        values = kmeans.train(
            coefficients,
            energy,
            codebook_rows(len(splats), _SPLATS_PER_COLOUR_ROW),
            training,
            start=start.colours,
        )
        colour_indices, _ = kmeans.nearest(coefficients, values, threads)
        colour_payloads, values = _store_colours(values, colour_indices, costs)
        colour_indices, colour_errors = kmeans.nearest(coefficients, values, threads)
        colour_rows = len(values)
        bits = _ESCAPE_COLOUR_BITS_PER_VALUE * coefficients.shape[1]
        colour_escape = energy * colour_errors * SHN_COST > bits * per_bit
    progress("codebooks", 2, 2)
    return VqPlan(
        costs=EnergyCosts(lagrangian, limit_colour_steps(energy, lagrangian)),
        quats=quats,
        scales=scales,
        factors=factors,
        shape_payload=payload,
        shape_rows=len(rows),
        shape_indices=indices,
        shape_escape=escape,
        colour_payloads=colour_payloads,
        colour_rows=colour_rows,
        colour_indices=colour_indices,
        colour_escape=colour_escape,
    )


def encode_chunk(splats: Splats, plan_: VqPlan, rows: NDArray[np.int64], morton: bool) -> Payloads:
    """Encode a chunk into head and tail, with planes still uncompressed.

    Parameters
    ----------
    splats : Splats
        Whole planned scene.
    plan_ : VqPlan
        Codebooks and rows.
    rows : (n,) int64
        Rows of the chunk.
    morton : bool
        Sort the chunk by Morton code.
    """
    costs = plan_.costs.take(rows)
    step = costs.mean_step(plan_.scales[rows])
    inside, means, _ = chunk_means(splats.means[rows], step, morton)
    rows, costs = rows[inside], costs.take(inside)
    factors = plan_.factors[rows][:, None]
    factor_step = costs.step(Attribute.SCALE_FACTOR)
    sh0_step = costs.step(Attribute.SH0)
    head: list[Stream] = []
    escape = plan_.shape_escape[rows]
    if escape.any():
        own = costs.take(escape)
        scales = plan_.scales[rows[escape]] - factors[escape]
        scale_step = own.step(Attribute.SCALES)
        head.append(
            scalar.write(Attribute.SCALES, scales, grids.fit(scales, scale_step), escape=True)
        )
        quat_step = own.step(Attribute.QUATS)
        head.append(quaternion.write(plan_.quats[rows[escape]], quat_step, escape=True))
    indices = plan_.shape_indices[rows]
    head += [
        _indices(Attribute.SHAPE, SHAPE_CODEBOOK, plan_.shape_rows, indices, escape),
        scalar.write(Attribute.SCALE_FACTOR, factors, grids.fit(factors, factor_step)),
        means,
        chunk_opacities(splats.opacities[rows], costs.step(Attribute.OPACITIES)),
        scalar.write(Attribute.SH0, splats.sh0[rows], grids.fit(splats.sh0[rows], sh0_step)),
    ]
    if not plan_.colour_rows:
        return Payloads(records.pack_uncompressed(head), None, (SHAPE_CODEBOOK,), (), inside)
    escape = plan_.colour_escape[rows]
    tail: list[Stream] = []
    if escape.any():
        sh_step = costs.take(escape).step(Attribute.SHN)
        tail += _bands(splats.shN[rows[escape]], sh_step, escape=True)
    indices = plan_.colour_indices[rows]
    tail.append(_indices(Attribute.SHN, COLOUR_CODEBOOK, plan_.colour_rows, indices, escape))
    needs = (COLOUR_CODEBOOK,)
    return Payloads(
        records.pack_uncompressed(head),
        records.pack_uncompressed(tail),
        (SHAPE_CODEBOOK,),
        needs,
        inside,
    )


def _indices(
    attribute: Attribute, book: int, size: int, indices: U32, escape: NDArray[np.bool_]
) -> Stream:
    """Return the stream of codebook indices of a chunk.

    `book` is the number of the codebook in the file, and `size` its number of rows. Escape rows
    are numbered from `size` on.
    """
    count = int(escape.sum())
    indices = indices.copy()
    indices[escape] = size + np.arange(count, dtype=np.uint32)
    return codebook_index.write(attribute, indices, book, size, count)


def _bands(coefficients: F32, step: float, *, escape: bool = False) -> list[Stream]:
    """Quantise (n, K-1, 3) SH coefficients into one stream per band.

    With `escape` the streams hold the splats that use no codebook row.
    """
    out: list[Stream] = []
    for band, attribute in enumerate(SH_BANDS, start=1):
        first, last = band * band - 1, (band + 1) * (band + 1) - 1
        if coefficients.shape[1] >= last:
            values = np.ascontiguousarray(
                coefficients[:, first:last].reshape(len(coefficients), -1)
            )
            out.append(scalar.write(attribute, values, grids.fit(values, step), escape=escape))
    return out


def _row_costs(costs: EnergyCosts, indices: U32, rows: int) -> EnergyCosts:
    """Return the costs of codebook rows: the sum over the splats that use a row."""
    weight = np.bincount(indices, weights=costs.energy, minlength=rows)
    return replace(costs, energy=np.maximum(weight, costs.energy.min()))


def _store_shapes(rows: F32, indices: U32, costs: EnergyCosts) -> tuple[bytes, F32]:
    """Return a shape codebook's payload and the shape vectors of its decoded rows."""
    quats, scales = covariance.quats_and_scales(rows)
    # Similar rows together: their planes compress.
    order = np.lexsort((quats[:, 2], quats[:, 1], np.rint(scales.min(axis=1))))
    quats, scales = quats[order], scales[order]
    place = np.argsort(order).astype(np.uint32)
    row_costs = _row_costs(costs, place[indices], len(rows))
    grid = grids.fit(scales, row_costs.step(Attribute.SCALES))
    body = [
        scalar.write(Attribute.SCALES, scales, grid),
        quaternion.write(quats, row_costs.step(Attribute.QUATS)),
    ]
    payload = records.pack(body)
    stored = records.unpack(memoryview(payload), "shape codebook", len(rows))
    kinds.read(stored[0], scales)
    kinds.read(stored[1], quats)
    return payload, covariance.shape_vectors(quats, scales)


def _store_colours(rows: F32, indices: U32, costs: EnergyCosts) -> tuple[tuple[bytes, ...], F32]:
    """Return a colour codebook's payloads by band and its decoded rows."""
    used = np.bincount(indices, weights=costs.energy, minlength=len(rows))
    order = np.argsort(-used, kind="stable")
    rows = np.ascontiguousarray(rows[order])
    place = np.argsort(order).astype(np.uint32)
    step = _row_costs(costs, place[indices], len(rows)).step(Attribute.SHN)
    bands = _bands(rows.reshape(len(rows), -1, 3), step)
    payloads = tuple(records.pack([band]) for band in bands)
    decoded: list[F32] = []
    for payload, band in zip(payloads, bands, strict=True):
        values = np.empty((len(rows), records.COMPONENTS[band.attribute]), np.float32)
        kinds.read(records.unpack(memoryview(payload), "colour codebook", len(rows))[0], values)
        decoded.append(values)
    return payloads, np.ascontiguousarray(np.concatenate(decoded, axis=1))
