"""Statistics of a scene: ranges, moments, histograms, and the density of its splats."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Extra, Splats, sh_coefficients
from cogsplat.codec.trained_arrays import opacities_from_logits

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

BINS: Final = 24
"""Bins of a histogram; with one character per bin, it fits a terminal's line."""

# Low edge, median and high edge of histograms. Values beyond the edges fall into the outermost
# bins: without this, one distant splat would move all other splats into one bin.
_HISTOGRAM_QUANTILES: Final = (0.005, 0.5, 0.995)

# Values converted to float64 at a time: 8 MiB.
_BLOCK: Final = 1 << 20

# Quantiles of the bounding box for `fill_ratio`, as in PlayCanvas' splat-transform (type `LodStats`
# of its API reference), so that the figures are comparable.
_BOX_QUANTILES: Final = (0.01, 0.99)


@dataclass(frozen=True, eq=False)
class ValueStatistics:
    """Statistics of one attribute's values; NaN and ±inf are only counted.

    Parameters
    ----------
    count : int
        Number of values, including NaN and ±inf.
    num_nan, num_infinite : int
        Number of NaN values, and of ±inf.
    least, largest, mean, std, median : float or None
        Statistics of the finite values; None if there are none. `std` is of the population.
    edges : (B+1,) float64
        Edges of equal bins between the quantiles 0.5 % and 99.5 %; empty without finite values.
    histogram : (B,) int64
        Number of finite values per bin. The outermost bins include values beyond the edges.
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
    splats : int
        Number of splats.
    sh_degree : int
        SH degree, 0 to 3.
    nbytes : int
        Memory of the arrays, bytes.
    num_invalid : int
        Number of rows that cannot be rendered (`Splats.invalid_rows`).
    opaque_share : float or None
        Fraction of splats with an opacity above 0.5; None without splats.
    fill_ratio : float or None
        See the function `fill_ratio`.
    values : dict of str to ValueStatistics
        Statistics by name. Stored values come first: ``means.x`` to ``means.z``, ``scales.0`` to
        ``scales.2``, ``quats.w`` to ``quats.z``, ``opacities``, ``sh0.r`` to ``sh0.b``, and one
        entry per SH band from ``shN.1``. Derived values follow: ``opacities_unit``,
        ``scales_linear.max`` (scene units) and ``elongation`` (natural logarithm of the largest
        scale divided by the middle one). Extra attributes are last: ``extras.NAME``, or
        ``extras.NAME.0``, ``extras.NAME.1``, …
    """

    splats: int
    sh_degree: int
    nbytes: int
    num_invalid: int
    opaque_share: float | None
    fill_ratio: float | None
    values: dict[str, ValueStatistics]


def statistics(splats: Splats, progress: Progress = silent) -> SceneStatistics:
    """Return the statistics of a scene's attributes.

    Parameters
    ----------
    splats : Splats
        Any scene, including rows that cannot be rendered.
    progress : Progress
        Called with ``("statistics", attributes done, attributes)``.
    """
    rows = _stored_values(splats)
    # Overflowing exponentials are counted as inf, and inf - inf as NaN.
    with np.errstate(over="ignore", invalid="ignore"):
        ordered = np.sort(splats.scales, axis=1)
        opacities_unit = opacities_from_logits(splats.opacities.astype(np.float64))
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


def _stored_values(splats: Splats) -> dict[str, F32]:
    """Return the stored values of a scene by name, one row per component or SH band."""
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
    """Yield the name and the values of each component of the extra attributes."""
    for name, values in splats.extras.items():
        if values.ndim == 1:
            yield f"extras.{name}", values
        else:
            for column in range(values.shape[1]):
                yield f"extras.{name}.{column}", values[:, column]


def describe(values: F32) -> ValueStatistics:
    """Return the statistics of an array.

    Parameters
    ----------
    values : (M,) float32
        Values; NaN and ±inf are counted, and excluded from other figures.
    """
    finite = values[np.isfinite(values)]
    num_nan = int(np.isnan(values).sum())
    num_infinite = values.size - finite.size - num_nan
    if not finite.size:
        empty = np.zeros(0, np.int64)
        return ValueStatistics(values.size, num_nan, num_infinite, *(None,) * 5, np.zeros(0), empty)
    # Sums and squares of float32 values cannot overflow float64.
    mean = float(finite.mean(dtype=np.float64))
    square = sum(float(np.square(part - mean).sum()) for part in _wide(finite))
    low, median, high = (float(v) for v in np.quantile(finite, _HISTOGRAM_QUANTILES))
    edges = np.linspace(low, high, BINS + 1)
    # If the width is zero, all values go to the first bin.
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
    """Yield an array as float64 in blocks, so that no second copy of a large shN is needed."""
    for start in range(0, len(values), _BLOCK):
        yield values[start : start + _BLOCK].astype(np.float64)


def fill_ratio(splats: Splats) -> float | None:
    """Estimate the number of splats that a ray through the scene crosses.

    The estimate is the total area of the splats' 1σ ellipses, divided by the mean face area of the
    scene's bounding box. An ellipse spans the two largest scales. The box spans the 1 % to 99 %
    quantiles of the means; the median ellipse replaces its face if that is larger. Trained scenes
    reach 1 to some hundreds; a far larger number makes rendering slow.

    Returns
    -------
    float or None
        The ratio; inf if a scale is infinite. None if no row has finite means and valid scales, or
        all areas are zero.

    Notes
    -----
    The definition is that of ``fillRatio`` in PlayCanvas' splat-transform (type ``LodStats`` of its
    API reference).
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
