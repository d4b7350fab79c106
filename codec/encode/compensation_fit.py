"""Fit prefix compensation: shifts of opacities and scales that apply while chunks are missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.order.prefix_inflation import Inflation
from cogsplat.codec.partition.chunk_tree import ROOT_CHUNKS
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.prefix_compensation import (
    OPACITY_STEP,
    SCALE_STEP,
    Compensation,
    Layer,
)
from cogsplat.codec.splats import Splats

from .encoded import EncodedChunk, EncodedScene
from .partial_prefixes import decode_partial_prefixes
from .prefix_sampling import choose_prefixes, interpolate_prefixes
from .shift_optimiser import FitConfig, ShiftOptimiser, coded_splats, shift_codebook_rows

F64 = NDArray[np.float64]

# Growth of the prefix length from layer to layer; shifts in between are interpolated.
_GROWTH: Final = 1.4
# Longest prefix of a layer, in effective splats; longer prefixes hardly change.
_LONGEST_LAYER: Final = 1.0
# Length, in effective splats, of the first prefix whose layer has no shifts.
_UNCHANGED: Final = 1.27
# Splats above which a layer is fitted in every second or third iteration only: a step costs as much
# as rendering its splats, and longer prefixes need smaller shifts. On a captured scene, two layers
# at every second iteration keep the mean PSNR (29.508 dB), at every third they lose 0.06 dB.
_LONG_LAYER: Final = 1 << 16
_RAREST: Final = 3
# Share of the iterations after which splats use the shifts of codebook rows.
_QUANTISED_FROM: Final = 0.6
# Views that errors are measured in, per view that an iteration renders, and measured prefixes at
# most. Only the order of segments in the file depends on them.
_MEASURED_VIEWS: Final = 2
_MEASURED_PREFIXES: Final = 10


def plan_layers(
    chunk_splats: Sequence[int], effective_splats: int, most_chunks: int | None = None
) -> list[int]:
    """Return the number of chunks of each layer's prefix, ascending; the whole scene has no layer.

    Parameters
    ----------
    chunk_splats : sequence of int
        Splats of each chunk.
    effective_splats : int
        Effective number of splats of the source (`prefix_inflation.effective_splats`).
    most_chunks : int, optional
        Chunks of a layer at most (`most_layer_chunks`); no limit by default.
    """
    layers: list[int] = []
    splats, last = 0, 0
    for chunk, count in enumerate(chunk_splats[:-1][:most_chunks], start=1):
        splats += count
        if splats > _LONGEST_LAYER * effective_splats:
            break
        if splats >= _GROWTH * last:
            layers.append(chunk)
            last = splats
    return layers


def most_layer_chunks(chunks: Sequence[EncodedChunk]) -> int | None:
    """Return the largest number of chunks in a layer: where pages follow cells, the root's.

    In longer prefixes some cells are whole and others coarse, which no client fetches. From the
    last layer on, shifts fade with the missing descendants of each chunk (SPEC 8.5). None where
    all prefixes are fetched.
    """
    follows_cells = len(chunks) > ROOT_CHUNKS and all(chunk.cell for chunk in chunks)
    return ROOT_CHUNKS if follows_cells else None


def _step_interval(splats: int) -> int:
    """Return the number of iterations between two steps of a layer of `splats` splats."""
    return min(max(1, round(splats / _LONG_LAYER)), _RAREST)


def _identity_layer(chunks: int) -> Layer:
    """Return a layer without shifts."""
    zeros = np.zeros(chunks, np.int8)
    strengths = np.zeros((chunks, 2), np.uint8)
    return Layer(zeros, zeros, strengths, np.zeros((0, 2), np.int8), np.zeros(0, np.uint8))


def fit(
    splats: Splats,
    chunk_splats: Sequence[int],
    references: ReferenceViews,
    effective_splats: int,
    config: FitConfig | None = None,
    *,
    prefixes: Sequence[Splats] | None = None,
    inflations: Sequence[Inflation] | None = None,
    most_chunks: int | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Compensation:
    """Fit the compensation of a scene's prefixes to renders of the source.

    Parameters
    ----------
    splats : Splats
        Decoded splats in stored order.
    chunk_splats : sequence of int
        Splats of each chunk.
    references : ReferenceViews
        Pictures of the source.
    effective_splats : int
        Effective number of splats of the source (`prefix_inflation.effective_splats`): the unit of
        prefix lengths.
    config : FitConfig, optional
        Iterations, views and codes.
    prefixes : sequence of Splats, optional
        Prefix of each layer (`plan_layers`) without shifts; by default rows of `splats`.
    inflations : sequence of Inflation, optional
        Initial shifts of each layer; by default `best_inflation` of its prefix.
    most_chunks : int, optional
        Chunks of a layer at most (`plan_layers`).
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.
    progress : Progress
        Called with ``compensate``, finished steps and all steps.

    Returns
    -------
    Compensation
        Fitted layers; none for a scene of one chunk, or hardly more.

    Notes
    -----
    Adam minimises the mean log squared error over the views, for one layer after the other. Each
    splat has one shift for all its prefixes, scaled by a strength that its chunk has in each layer.
    Once splats use codebook rows, gradients ignore the choice of the row (straight-through
    estimation).
    """
    config = config or FitConfig()
    layers = plan_layers(chunk_splats, effective_splats, most_chunks)
    counts = np.array(chunk_splats, np.int64)
    if not layers:
        return Compensation((), counts)
    executor = executor or LocalThreads(config.threads)
    ends = np.cumsum(counts)
    if prefixes is None:
        prefixes = [splats.take(slice(0, int(ends[chunks - 1]))) for chunks in layers]
    if inflations is None:
        sizes = [int(ends[chunks - 1]) for chunks in layers]
        inflations = [prefix_inflation.best_inflation(size / effective_splats) for size in sizes]
    optimiser = ShiftOptimiser(
        prefixes, chunk_splats, layers, inflations, effective_splats, config, executor
    )
    every = [_step_interval(int(ends[chunks - 1])) for chunks in layers]
    total = config.iterations * len(layers)
    progress("compensate", 0, total)
    for iteration in range(config.iterations):
        if iteration == int(_QUANTISED_FROM * config.iterations):
            optimiser.quantise()
        rate = min(1.0, 2.0 * (1.0 - iteration / config.iterations))
        views = references.sample(config.views, iteration)
        for number in range(len(layers)):
            if (iteration + number) % every[number] == 0:
                optimiser.step(number, rate, references, views)
            progress("compensate", iteration * len(layers) + number + 1, total)
    if not optimiser.is_quantised:
        optimiser.quantise()
    found = optimiser.layers()
    unchanged = _identity_chunks(chunk_splats, effective_splats, layers, most_chunks)
    if unchanged:
        found.append(_identity_layer(unchanged))
    return Compensation(tuple(found), counts)


def compensate_prefixes(
    encoded: EncodedScene,
    references: ReferenceViews,
    contribution: NDArray[np.float64],
    config: FitConfig | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Return an encoded scene with compensation fitted to its partly received prefixes.

    Parameters
    ----------
    encoded : EncodedScene
        Scene without compensation.
    references : ReferenceViews
        Pictures of the source.
    contribution : (N,) float64
        Contribution of each splat of the source.
    config : FitConfig, optional
        Iterations, views and codes.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.
    progress : Progress
        Called with the stage ``compensate``.
    """
    config = config or FitConfig()
    counts = [chunk.splats for chunk in encoded.chunks]
    effective_splats = prefix_inflation.effective_splats(contribution)
    most_chunks = most_layer_chunks(encoded.chunks)
    layers = plan_layers(counts, effective_splats, most_chunks)
    if not layers:
        return encoded
    splats = encoded.decoded
    executor = executor or LocalThreads(config.threads)
    progress("compensate", 0, config.iterations * len(layers))
    # The order of segments decides which parts of a prefix are received, and follows from these
    # errors. Errors after the fit would give no better order.
    if encoded.prefix_mse is None:
        prefix_mse = errors_before_fit(
            encoded, references, effective_splats, config, executor=executor
        )
        encoded = replace(encoded, prefix_mse=prefix_mse)
    found = fit(
        splats,
        counts,
        references,
        effective_splats,
        config,
        prefixes=decode_partial_prefixes(encoded, layers, _LONG_LAYER),
        inflations=[_initial_inflation(encoded, chunks, effective_splats) for chunks in layers],
        most_chunks=most_chunks,
        executor=executor,
        progress=progress,
    )
    return replace(encoded, compensation=found)


def _initial_inflation(encoded: EncodedScene, chunks: int, effective_splats: int) -> Inflation:
    """Return `best_inflation` of a prefix; none while its preview shows the whole scene."""
    own = encoded.chunks[:chunks]
    if any(chunk.until > chunks for chunk in own):
        return Inflation(0.0, 0.0)
    size = sum(chunk.splats for chunk in own if not chunk.until)
    return prefix_inflation.best_inflation(size / effective_splats)


def errors_before_fit(
    encoded: EncodedScene,
    references: ReferenceViews,
    effective_splats: int,
    config: FitConfig | None = None,
    *,
    executor: Executor | None = None,
) -> F64:
    """Measure the error of each prefix with `best_inflation`, before any fit.

    Parameters
    ----------
    encoded : EncodedScene
        Scene whose prefixes are measured.
    references : ReferenceViews
        Pictures of the source.
    effective_splats : int
        Effective number of splats of the source (`prefix_inflation.effective_splats`).
    config : FitConfig, optional
        Number of views.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.

    Returns
    -------
    (c + 1,) float64
        Mean squared errors as in `errors`; preview chunks are not drawn.
    """
    config = config or FitConfig()
    stay = np.array([not chunk.until for chunk in encoded.chunks])
    counts = np.array([chunk.splats for chunk in encoded.chunks])
    splats = encoded.decoded
    if not stay.all():
        splats = splats.take(np.repeat(stay, counts))
    start = initial_compensation(counts[stay].tolist(), effective_splats)
    views = _MEASURED_VIEWS * config.views
    found = errors(start, splats, references, views=views, executor=executor)
    each: F64 = found[np.concatenate([[0], np.cumsum(stay)])]
    return each


def initial_compensation(chunk_splats: Sequence[int], effective_splats: int) -> Compensation:
    """Return the initial compensation of a fit: `best_inflation` of every prefix.

    Parameters
    ----------
    chunk_splats : sequence of int
        Splats of each chunk.
    effective_splats : int
        Effective number of splats of the source.
    """
    layers = plan_layers(chunk_splats, effective_splats)
    ends = np.cumsum(chunk_splats)
    found = []
    for chunks in layers:
        best = prefix_inflation.best_inflation(int(ends[chunks - 1]) / effective_splats)
        scales = np.full(chunks, round(best.scales / SCALE_STEP), np.int8)
        opacities = np.full(chunks, round(best.opacities / OPACITY_STEP), np.int8)
        found.append(replace(_identity_layer(chunks), scales=scales, opacities=opacities))
    unchanged = _identity_chunks(chunk_splats, effective_splats, layers, None)
    if unchanged:
        found.append(_identity_layer(unchanged))
    return Compensation(tuple(found), np.array(chunk_splats, np.int64))


def _view_error(
    view: int,
    splats: Splats,
    references: ReferenceViews,
    compensation: Compensation,
    *,
    size: int,
    chunks: int,
) -> float:
    """Return the mean squared error of a compensated prefix in one reference view."""
    prefix = compensation.apply(splats.take(slice(0, size)), chunks)
    config = RenderConfig(
        near_plane=references.near_plane, reduction=references.reductions[view], threads=1
    )
    drawn = np.clip(render(prefix, references.cameras[view], config), 0.0, 1.0)
    return float(np.mean(np.square(drawn - references.pictures[view], dtype=np.float64)))


def errors(
    compensation: Compensation,
    splats: Splats,
    references: ReferenceViews,
    *,
    views: int = 8,
    executor: Executor | None = None,
) -> F64:
    """Measure the mean squared error of compensated prefixes.

    Parameters
    ----------
    compensation : Compensation
        Compensation to apply.
    splats : Splats
        All decoded splats of the scene.
    references : ReferenceViews
        Pictures of the source.
    views : int
        Approximate number of rendered views.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.

    Returns
    -------
    (c + 1,) float64
        Mean squared error of the pictures of 0, 1, … c chunks. At most 10 prefixes are measured;
        between them the root of the error is interpolated.
    """
    sampled = references.sample(views, 0)
    weights = references.weights[sampled] / references.weights[sampled].sum()
    counts = compensation.chunk_splats.tolist()
    ends = np.concatenate([[0], np.cumsum(compensation.chunk_splats)])

    runner = executor or LocalThreads()

    def error(chunks: int) -> float:
        """Return the weighted mean squared error of a prefix."""
        far = partial(_view_error, size=int(ends[chunks]), chunks=chunks)
        return float(
            weights @ np.array(list(runner.map(far, sampled, splats, references, compensation)))
        )

    measured = choose_prefixes(counts, _MEASURED_PREFIXES)
    roots = np.sqrt([error(chunks) for chunks in measured.tolist()])
    return np.concatenate([[error(0)], np.square(interpolate_prefixes(counts, measured, roots))])


def placeholder_compensation(
    chunk_splats: Sequence[int],
    effective_splats: int,
    config: FitConfig | None = None,
    *,
    most_chunks: int | None = None,
) -> Compensation:
    """Return a compensation without shifts that has the size of a fitted one.

    Parameters
    ----------
    chunk_splats : sequence of int
        Splats of each chunk.
    effective_splats : int
        Effective number of splats of the source.
    config : FitConfig, optional
        Share of coded splats and bits of a code.
    most_chunks : int, optional
        Chunks of a layer at most (`plan_layers`).
    """
    config = config or FitConfig()
    layers = plan_layers(chunk_splats, effective_splats, most_chunks)
    ends = np.cumsum(chunk_splats)
    sizes = [int(ends[chunks - 1]) for chunks in layers]
    coded = coded_splats(sizes, effective_splats, config)
    found = []
    first = 0
    for chunks, size in zip(layers, sizes, strict=True):
        layer = _identity_layer(chunks)
        if size <= coded:
            rows = shift_codebook_rows(config.code_bits, size - first)
            layer = replace(
                layer, book=np.zeros((rows, 2), np.int8), codes=np.zeros(size - first, np.uint8)
            )
        found.append(layer)
        first = size
    unchanged = _identity_chunks(chunk_splats, effective_splats, layers, most_chunks)
    if unchanged:
        found.append(_identity_layer(unchanged))
    return Compensation(tuple(found), np.array(chunk_splats, np.int64))


def _identity_chunks(
    chunk_splats: Sequence[int],
    effective_splats: int,
    layers: Sequence[int],
    most_chunks: int | None,
) -> int:
    """Return the number of chunks of the last layer, which has no shifts; 0 for no such layer."""
    if not layers:
        return 0
    chunks = int(np.searchsorted(np.cumsum(chunk_splats), _UNCHANGED * effective_splats)) + 1
    most = len(chunk_splats) - 1 if most_chunks is None else most_chunks
    return chunks if layers[-1] < chunks <= most else 0
