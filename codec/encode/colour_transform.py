"""Basis of shN: a Karhunen-Loève transform in the metric of the scoring views."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.rate import allocation
from cogsplat.codec.rate.refinement_split import entropy_bits
from cogsplat.codec.rate.sparse_codes import choose_codes
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import scalar, shn_transform
from cogsplat.codec.streams.records import SH_BANDS, Stream

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Weight of the uniform distribution over all directions in the metric; the remainder is that of the
# scoring views. A lower weight lets colours drift in views off the capture path.
_EVEN_SHARE: Final = 0.1
_EVEN: Final = 1 / (4 * np.pi)  # mean of Y² over the sphere

# Coordinates below this number of steps become zero; 0.5 is plain rounding. On trained scenes rate
# falls faster than error rises up to about this value.
_DEAD_ZONE: Final = 0.6
# Steps by which non-zero coordinates are decoded closer to zero: small values are more frequent
# within a step.
_SHRINK: Final = 0.05

# Largest ratio of a chunk's largest coordinate to its step: codes are three bytes, signed
# (SPEC 6.14). Step of a chunk whose coordinates are all zero.
_MOST_STEPS: Final = 1 << 22
_FINEST_STEP: Final = 2.0**-100

_ROW_LEVELS: Final = 256


@dataclass(frozen=True, eq=False)
class ColourBasis:
    """Basis of shN: B rows of SH coefficients, most visible first.

    Parameters
    ----------
    rows : (B, 3·(K-1)) float32
        Basis rows, flattened by SH index, then by channel.
    metric : (3·(K-1), 3·(K-1)) float64
        Quadratic form M of the views: coefficient errors e give a squared colour error of eᵀ·M·e.
    """

    rows: F32
    metric: F64

    def streams(self) -> list[Stream]:
        """Return the rows as one scalar stream per SH band."""
        span = np.ptp(self.rows.astype(np.float64), axis=0)
        return band_streams(self.rows, np.maximum(span, 1e-6) / (_ROW_LEVELS - 1))

    def error(self, missed: F64, energy: F64) -> float:
        """Return the squared picture error of (n, K-1, 3) coefficient errors.

        Parameters
        ----------
        missed : (n, K-1, 3) float64
            Source minus decoded.
        energy : (n,) float64
            Energy of each splat.
        """
        flat = missed.reshape(len(missed), -1)
        return float(allocation.shn_cost(energy) @ ((flat @ self.metric) * flat).sum(axis=1))

    @property
    def projection(self) -> F64:
        """Matrix from flattened SH coefficients to basis coordinates, (3(K-1), B)."""
        rows: F64 = self.rows.astype(np.float64)
        weighted: F64 = self.metric @ rows.T
        return np.linalg.solve(rows @ weighted, weighted.T).T.astype(np.float64)

    def coordinates(self, coefficients: F32) -> F64:
        """Return the coordinates, (n, B), that approximate coefficients best.

        Parameters
        ----------
        coefficients : (n, K-1, 3) float32
            SH coefficients above DC.
        """
        found: F64 = _flat(coefficients) @ self.projection
        return found

    def encode(
        self, coefficients: F32, energy: F64, lagrangian: float, codebook: int
    ) -> tuple[Stream, F64]:
        """Return the shN stream of a chunk and its quantisation error.

        Parameters
        ----------
        coefficients : (n, K-1, 3) float32
            Coefficients of the chunk's splats.
        energy : (n,) float64
            Energy of each splat.
        lagrangian : float
            λ of the encode.
        codebook : int
            Number of the basis in the file.

        Returns
        -------
        stream : Stream
            Coded coordinates.
        missed : (n, K-1, 3) float64
            Source minus decoded.
        """
        coordinates = self.coordinates(coefficients)
        step = _step(coordinates, energy, lagrangian)
        positions = coordinates / step
        codes = choose_codes(
            positions,
            step**2 * allocation.shn_cost(energy),
            allocation.bit_price(lagrangian),
            _SHRINK,
            _round(positions),
        )
        stream = shn_transform.write(codes, codebook, step, _SHRINK)
        values = np.sign(codes) * np.maximum(np.abs(codes) - _SHRINK, 0) * step
        decoded = (values @ self.rows.astype(np.float64)).reshape(coefficients.shape)
        return stream, coefficients - decoded


def band_streams(rows: F32, steps: F64) -> list[Stream]:
    """Return the rows of a colour codebook as one scalar stream per SH band.

    Parameters
    ----------
    rows : (C, 3·(K-1)) float32
        Rows, flattened by SH index, then by channel.
    steps : (3·(K-1),) float64
        Quantiser step of each column.
    """
    out: list[Stream] = []
    for band, attribute in enumerate(SH_BANDS, start=1):
        first, last = 3 * (band * band - 1), 3 * ((band + 1) * (band + 1) - 1)
        if rows.shape[1] >= last:
            values = np.ascontiguousarray(rows[:, first:last])
            out.append(scalar.write(attribute, values, grids.fit(values, steps[first:last])))
    return out


def _flat(coefficients: F32) -> F64:
    """Return (n, K-1, 3) coefficients reshaped to (n, 3(K-1))."""
    flat: F64 = coefficients.reshape(-1, math.prod(coefficients.shape[1:])).astype(np.float64)
    return flat


def _step(coordinates: F64, energy: F64, lagrangian: float) -> float:
    """Return the step of a chunk from its coordinates, (n, B), and its splats' energies, (n,)."""
    largest = float(np.abs(coordinates).max(initial=0))
    return max(allocation.shn_step(lagrangian, energy), largest / _MOST_STEPS, _FINEST_STEP)


def _round(values: F64) -> I64:
    """Round to integers, with small values set to zero."""
    codes = np.rint(values)
    codes[np.abs(values) < _DEAD_ZONE] = 0
    return codes.astype(np.int64)


def fit(
    coefficients_of: Callable[[slice], F32],
    energy: F64,
    basis_spread: F64,
    lagrangian: float,
    chunks: Sequence[slice],
    *,
    principal: bool = True,
) -> ColourBasis:
    """Return the basis of a scene: a Karhunen-Loève transform in the metric of its views.

    Parameters
    ----------
    coefficients_of : callable
        Returns the coefficients of a range of rows, (n, K-1, 3) float32. Called chunk by chunk,
        because the coefficients of all rows are most of a scene.
    energy : (N,) float64
        Positive energy of each splat.
    basis_spread : (K-1, K-1) float64
        `Scores.basis_spread`, which excludes errors that sh0 corrects.
    lagrangian : float
        λ of the encode.
    chunks : sequence of slice
        Row ranges of the chunks, at least one; their steps decide the number of basis rows.
    principal : bool
        Use principal axes; otherwise single coefficients, by descending energy in quantiser steps.
    """
    directions = _directions(basis_spread, coefficients_of(slice(0, 0)).shape[1])
    metric = _metric(directions)
    values, vectors = np.linalg.eigh(directions)
    root = np.kron((vectors * np.sqrt(values)) @ vectors.T, np.eye(3))
    inverse = np.kron((vectors / np.sqrt(values)) @ vectors.T, np.eye(3))
    moments = np.zeros(metric.shape)
    # Each chunk in units of its own step: the rate depends on the number of levels.
    for run in chunks:
        part = _flat(coefficients_of(run))
        moments += (part.T @ part) / allocation.shn_step(lagrangian, energy[run]) ** 2
    moments = root @ moments @ root.T
    if principal:
        _, axes = np.linalg.eigh(moments)
        rows = (axes[:, ::-1].T @ inverse).astype(np.float32)
    else:
        # Scaled to cost one each, as principal axes do: all share one step.
        lengths = np.sqrt(np.diagonal(metric))
        levels = np.diagonal(inverse @ moments @ inverse) * lengths**2
        order = np.argsort(-levels, kind="stable")
        rows = (np.eye(len(metric)) / lengths)[order].astype(np.float32)
    basis = ColourBasis(np.ascontiguousarray(rows), metric)
    count = _rows_that_pay(basis, coefficients_of, energy, lagrangian, chunks)
    return replace(basis, rows=basis.rows[:count])


def given_basis(rows: F32, basis_spread: F64) -> ColourBasis:
    """Return a basis of another scene, with the metric of the views of this one.

    Parameters
    ----------
    rows : (B, K-1, 3) float32
        Basis rows as a decoder reads them.
    basis_spread : (K-1, K-1) float64
        `Scores.basis_spread` of this scene.
    """
    return ColourBasis(
        rows.reshape(len(rows), -1), _metric(_directions(basis_spread, rows.shape[1]))
    )


def _directions(basis_spread: F64, count: int) -> F64:
    """Return the quadratic form of the views for `count` coefficients of one channel."""
    spread = basis_spread[:count, :count]
    even = _EVEN_SHARE if spread.any() else 1.0
    directions: F64 = (1 - even) * spread + even * _EVEN * np.eye(count)
    return directions


def _metric(directions: F64) -> F64:
    """Return the quadratic form for the coefficients of three channels."""
    metric: F64 = np.kron(directions, np.eye(3)).astype(np.float64)
    return metric


def _rows_that_pay(
    basis: ColourBasis,
    coefficients_of: Callable[[slice], F32],
    energy: F64,
    lagrangian: float,
    chunks: Sequence[slice],
) -> int:
    """Return the number of rows of a full basis that are worth their bytes, at least one.

    Parameters
    ----------
    basis : ColourBasis
        All rows, most visible first.
    coefficients_of, energy, lagrangian, chunks
        As in `fit`.
    """
    price = allocation.bit_price(lagrangian)
    gains = np.full(len(basis.rows), -price * basis.rows.shape[1] * np.log2(_ROW_LEVELS))
    for run in chunks:
        coordinates = basis.coordinates(coefficients_of(run))
        step = _step(coordinates, energy[run], lagrangian)
        codes = _round(coordinates / step)
        missed = np.square(coordinates - step * codes)
        removed = allocation.shn_cost(energy[run]) @ (np.square(coordinates) - missed)
        counts = [np.unique(column, return_counts=True)[1] for column in codes.T]
        bits = np.array([entropy_bits(column) for column in counts])
        gains += np.maximum(removed - price * bits, 0.0)
        # Mostly the first chunk pays for all rows.
        if (gains > 0).all():
            break
    return int(np.argmax(np.cumsum(gains))) + 1
