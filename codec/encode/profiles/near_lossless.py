"""Profile `near-lossless`: every attribute stays within a stated bound of the source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry import rotations
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import float32, quaternion, records, scalar
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.records import SH_BANDS, Attribute, Stream

from .chunk_streams import chunk_means

F32 = NDArray[np.float32]

# Steps this much below twice the bound leave room for float32 rounding in the decoder.
_SLACK: Final = 1 - 2.0**-8

# What float32 rounding may add to a decoded component of a unit quaternion.
_QUAT_ROUNDING: Final = 5e-7
_MIN_QUAT_BOUND: Final = 1e-6


@dataclass(frozen=True)
class NearLosslessBounds:
    """Error bounds between source and decoded scene, by attribute.

    Parameters
    ----------
    means : float
        Bound of means, in median standard deviations of the scene's splats.
    scales : float
        Bound of log scales; 0.002 is 0.2 % of a standard deviation.
    quats : float
        Bound per component of the unit quaternion, up to its sign; at least 1e-6.
    opacities : float
        Bound of logits; ±inf is kept exactly.
    sh0, shN : float
        Bound per SH coefficient.
    """

    means: float = 0.01
    scales: float = 0.002
    quats: float = 0.0005
    opacities: float = 0.004
    sh0: float = 0.0005
    shN: float = 0.001  # noqa: N815 - the field's name

    def __post_init__(self) -> None:
        require_finite(self)
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ValueError(f"bound {name} {getattr(self, name)}, expected more than 0")
        if self.quats < _MIN_QUAT_BOUND:
            raise ValueError(f"bound quats {self.quats}, expected at least {_MIN_QUAT_BOUND}")


def means_bound_of(scales: F32, bounds: NearLosslessBounds) -> float:
    """Convert the error bound of means from median standard deviations to scene units.

    Parameters
    ----------
    scales : (N, 3) float32
        Log scales of the scene.
    bounds : NearLosslessBounds
        Error bounds.
    """
    if len(scales) == 0:
        return bounds.means
    return float(bounds.means * np.exp(np.median(scales.astype(np.float64))))


def encode_chunk(
    splats: Splats, means_bound: float, bounds: NearLosslessBounds, sort: bool
) -> Payloads:
    """Encode a chunk into head and tail within error bounds, with planes still uncompressed.

    Parameters
    ----------
    splats : Splats
        Splats of the chunk.
    means_bound : float
        Error bound of means, scene units.
    bounds : NearLosslessBounds
        Error bounds of the other attributes.
    sort : bool
        Sort the chunk by Morton code.
    """
    rows, means = _means(splats.means, means_bound, sort)
    splats = splats.take(rows)
    head = [
        _bounded(Attribute.SCALES, splats.scales, bounds.scales),
        quaternion.write(rotations.unit(splats.quats), _quat_step(bounds.quats)),
        means,
        _opacities(splats.opacities[:, None], bounds.opacities),
        _bounded(Attribute.SH0, splats.sh0, bounds.sh0),
    ]
    tail: list[Stream] = []
    for band, attribute in enumerate(SH_BANDS[: splats.sh_degree], start=1):
        first, last = band * band - 1, (band + 1) * (band + 1) - 1
        values = np.ascontiguousarray(splats.shN[:, first:last].reshape(len(splats), -1))
        tail.append(_bounded(attribute, values, bounds.shN))
    tail_payload = records.pack_uncompressed(tail) if tail else None
    return Payloads(records.pack_uncompressed(head), tail_payload, (), (), rows)


def _quat_step(bound: float) -> float:
    """Return the quantiser step that keeps quaternion components within a bound."""
    # The component left out is at least 1/2, so its error is up to three times the others' to the
    # first order; 6·bound covers the second.
    return 2 * (bound - _QUAT_ROUNDING) / (3 + 6 * bound)


def _means(means: F32, bound: float, sort: bool) -> tuple[NDArray[np.int64], Stream]:
    """Quantise means within a bound; store float32 where no grid is fine enough."""
    # The bound of scales below those of float64 is 0.
    if bound > 0:
        rows, stream, decoded = chunk_means(means, 2 * bound * _SLACK, sort)
        if _largest_difference(decoded, means[rows]) <= bound:
            return rows, stream
    # Coordinates too large for the bound on any grid: as they are.
    rows = np.arange(len(means), dtype=np.int64)
    return rows, float32.write(Attribute.MEANS, means)


def _bounded(attribute: Attribute, values: F32, bound: float) -> Stream:
    """Quantise values within a bound; store float32 where no grid is fine enough."""
    grid = grids.fit(values, 2 * bound * _SLACK)
    if _error(values, grid) <= bound:
        return scalar.write(attribute, values, grid)
    return float32.write(attribute, values)


def _opacities(values: F32, bound: float) -> Stream:
    """Quantise opacities within a bound, with codes for infinite logits."""
    finite = np.isfinite(values[:, 0])
    if not finite.all():
        inner = values[finite] if finite.any() else np.zeros((1, 1), np.float32)
        grid = grids.fit(inner, 2 * bound * _SLACK)
        # Two codes more, and all of them must fit three bytes.
        fits = int(grid.levels[0]) <= grids.MAX_LEVELS - 2
        if fits and _error(inner, grid) <= bound:
            return scalar.write_with_infinities(Attribute.OPACITIES, values, grid)
        return float32.write(Attribute.OPACITIES, values)
    return _bounded(Attribute.OPACITIES, values, bound)


def _error(values: F32, grid: grids.Grid) -> float:
    """Return the largest quantisation error of an array."""
    return _largest_difference(grid.dequantise(grid.quantise(values)), values)


def _largest_difference(decoded: F32, values: F32) -> float:
    """Return the largest absolute difference between two arrays."""
    return float(np.abs(decoded.astype(np.float64) - values).max(initial=0))
