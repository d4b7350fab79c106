"""Statistics of a scene: ranges, moments, histograms, and how densely splats cover it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Extra, Splats, sh_coefficients

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

BINS: Final = 24
"""Bins of a histogram: one character each fits beside its numbers in a terminal."""

# Values beyond these quantiles fall into the outermost bins: one far splat would otherwise put all
# others into one bin.
_HISTOGRAM_QUANTILES: Final = (0.005, 0.5, 0.995)

# Values that are widened to float64 at a time: 8 MiB.
_BLOCK: Final = 1 << 20

# Box of a scene for `fill_ratio`, as PlayCanvas' splat-transform takes it (type `LodStats` of its
# API reference), so that the figures compare.
_BOX_QUANTILES: Final = (0.01, 0.99)


@dataclass(frozen=True, eq=False)
class ValueStatistics:
    """Statistics of one row of numbers; figures are of its finite values.

    Parameters
    ----------
    count : int
        Values, those that are not finite included.
    num_nan, num_infinite : int
        Of these, NaN and ±inf.
    least, largest, mean, std, median : float or None
        None where no value is finite. `std` divides by the count.
    edges : (B+1,) float64
        Edges of the bins, equally wide between the quantiles 0.5 % and 99.5 %. Without finite
        values, both empty.
    histogram : (B,) int64
        Finite values by bin; those beyond the edges are counted in the outermost bins.
    """

    count: int
    num_nan: int
    num_infinite: int
    least: float | None
    largest: float | None
    mean: float | None
    std: float | None
    median: float | None
    edges: F64
    histogram: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SceneStatistics:
    """Statistics of a scene.

    Parameters
    ----------
    splats, sh_degree : int
    nbytes : int
        Memory of the arrays, bytes.
    num_invalid : int
        Rows that cannot be drawn (`Splats.invalid_rows`).
    opaque_share : float or None
        Share of the splats with an opacity above 0.5; None without splats.
    fill_ratio : float or None
        See `fill_ratio` returns it.
    values : dict of str to ValueStatistics
        By name, in this order: ``means.x`` to ``means.z``, ``scales.0`` to ``scales.2``,
        ``quats.w`` to ``quats.z``, ``opacities``, ``sh0.r`` to ``sh0.b``, ``shN.1`` to the degree
        (all coefficients and channels of a band), and derived from them ``opacities_unit``,
        ``scales_linear.max`` (scene units) and ``elongation`` (natural logarithm of the largest
        scale by the middle one); then extra attributes as float32, ``extras.NAME``, or
        ``extras.NAME.0`` and on.
    """

    splats: int
    sh_degree: int
    nbytes: int
    num_invalid: int
    opaque_share: float | None
    fill_ratio: float | None
    values: dict[str, ValueStatistics]


def statistics(splats: Splats, progress: Progress = silent) -> SceneStatistics:
    """Return the statistics of a scene, non-finite values counted apart.

    Parameters
    ----------
    splats : Splats
        Any scene; rows that cannot be drawn are counted, not refused.
    progress : Progress
        Stage ``statistics``, a step for each row of numbers.
    """
    rows = _rows(splats)
    # exp overflows to inf and inf - inf is NaN: both are what is counted here.
    with np.errstate(over="ignore", invalid="ignore"):
        ordered = np.sort(splats.scales, axis=1)
        opacities_unit = 1.0 / (1.0 + np.exp(-splats.opacities.astype(np.float64)))
        rows["opacities_unit"] = opacities_unit.astype(np.float32)
        rows["scales_linear.max"] = np.exp(ordered[:, 2])
        rows["elongation"] = ordered[:, 2] - ordered[:, 1]
        for name, column in _extra_columns(splats):
            rows[name] = column.astype(np.float32)
    values = {}
    for done, (name, row) in enumerate(rows.items()):
        progress("statistics", done, len(rows))
        values[name] = describe(row)
    progress("statistics", len(rows), len(rows))
    return SceneStatistics(
        splats=len(splats),
        sh_degree=splats.sh_degree,
        nbytes=splats.nbytes,
        num_invalid=int(splats.invalid_rows().sum()),
        opaque_share=float((splats.opacities > 0).mean()) if len(splats) else None,
        fill_ratio=fill_ratio(splats),
        values=values,
    )


def _rows(splats: Splats) -> dict[str, F32]:
    rows: dict[str, F32] = {}
    for name, parts in (("means", "xyz"), ("scales", "012"), ("quats", "wxyz")):
        for column, part in enumerate(parts):
            rows[f"{name}.{part}"] = getattr(splats, name)[:, column]
    rows["opacities"] = splats.opacities
    for column, part in enumerate("rgb"):
        rows[f"sh0.{part}"] = splats.sh0[:, column]
    for band in range(1, splats.sh_degree + 1):
        first, last = sh_coefficients(band - 1) - 1, sh_coefficients(band) - 1
        rows[f"shN.{band}"] = splats.shN[:, first:last].reshape(-1)
    return rows


def _extra_columns(splats: Splats) -> Iterator[tuple[str, Extra]]:
    for name, values in splats.extras.items():
        if values.ndim == 1:
            yield f"extras.{name}", values
        else:
            for column in range(values.shape[1]):
                yield f"extras.{name}.{column}", values[:, column]


def describe(values: F32) -> ValueStatistics:
    """Return the statistics of some numbers.

    Parameters
    ----------
    values : (M,) float32
        NaN and ±inf are counted and left out of the rest.
    """
    finite = values[np.isfinite(values)]
    num_nan = int(np.isnan(values).sum())
    num_infinite = values.size - finite.size - num_nan
    if not finite.size:
        nothing = np.zeros(0, np.int64)
        return ValueStatistics(
            values.size, num_nan, num_infinite, *(None,) * 5, np.zeros(0), nothing
        )
    # In float64, where neither a sum nor a square of float32 values overflows.
    mean = float(finite.mean(dtype=np.float64))
    square = sum(float(np.square(part - mean).sum()) for part in _wide(finite))
    low, median, high = (float(v) for v in np.quantile(finite, _HISTOGRAM_QUANTILES))
    edges = np.linspace(low, high, BINS + 1)
    # Of width zero, all values are in the first bin.
    width = (high - low) / BINS
    histogram = np.zeros(BINS, np.int64)
    for part in _wide(finite):
        bins = np.clip((part - low) / width, 0, BINS - 1) if width > 0 else np.zeros(len(part))
        histogram += np.bincount(bins.astype(np.int64), minlength=BINS)
    return ValueStatistics(
        count=values.size,
        num_nan=num_nan,
        num_infinite=num_infinite,
        least=float(finite.min()),
        largest=float(finite.max()),
        mean=mean,
        std=math.sqrt(square / finite.size),
        median=median,
        edges=edges,
        histogram=histogram,
    )


def _wide(values: F32) -> Iterator[F64]:
    """Yield the values as float64 in blocks, so that shN of a large scene is not copied whole."""
    for start in range(0, len(values), _BLOCK):
        yield values[start : start + _BLOCK].astype(np.float64)


def fill_ratio(splats: Splats) -> float | None:
    """Return an estimate of how many splats a ray through the scene crosses.

    The areas of the splats' 1σ ellipses over their two largest scales, summed, divided by the mean
    face area of the box between the 1 % and 99 % quantiles of the means, or by the median ellipse
    where that is larger. Trained scenes have ones to hundreds; far more overwhelms a renderer.

    Returns
    -------
    float or None
        inf where a scale is infinite; None where no row has finite means and scales that are not
        NaN, or all ellipses vanish.

    Notes
    -----
    Defined as ``fillRatio`` of PlayCanvas' splat-transform (type ``LodStats`` of its API
    reference).
    """
    usable = np.isfinite(splats.means).all(axis=1) & ~np.isnan(splats.scales).any(axis=1)
    if not usable.any():
        return None
    low, high = np.quantile(splats.means[usable].astype(np.float64), _BOX_QUANTILES, axis=0)
    x, y, z = high - low
    with np.errstate(over="ignore"):
        ordered = np.sort(splats.scales[usable].astype(np.float64), axis=1)
        areas = math.pi * np.exp(ordered[:, 1] + ordered[:, 2])
    if np.isinf(areas).any():
        return math.inf
    section = max(float(x * y + y * z + z * x) / 3, float(np.median(areas)))
    return float(areas.sum()) / section if section > 0 else None
