"""Find what prefixes want: opacities and sizes fitted to the full scene's own pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import few_rows
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.gradients import gradient
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.render.shading import row_colours
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.compensation import (
    OPACITY_STEP,
    SCALE_STEP,
    STRENGTH_STEP,
    Compensation,
    Layer,
)
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .adam import Adam
from .encoded import EncodedScene

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# A layer's prefix is so much longer than the one before's; between them shifts are interpolated.
_GROWTH: Final = 1.4
# Prefixes longer than this, in `prefix_inflation.effective_splats`, want next to nothing.
_LAYERED: Final = 1.0
# The first prefix at least so long wants nothing at all.
_WHOLE: Final = 1.27
# Splats behind this, likewise, get no codes: their prefixes are nearly whole.
_CODED: Final = 0.65
# Most of what a code may say, either way: the log scale, and the logit.
_LIMITS: Final = np.array([0.9, 6.0])
# Where what codes say of scales and of opacities matters alike.
_SPREAD: Final = np.array([0.3, 1.8])
# An older chunk's codes were chosen for other prefixes, and fade.
_FADE: Final = 0.57
# Steps of Adam (Kingma and Ba 2015), of shifts and codes and of strengths, and its memories.
_RATES: Final = np.array([0.04, 0.2])
_TABLE_RATES: Final = np.array([0.02, 0.1])
_STRENGTH_RATES: Final = np.array([0.02, 0.02])
# From this share of the iterations on, codes are those of a book.
_QUANTISED_FROM: Final = 0.6
# Added to a view's mean squared error before the logarithm that is minimised.
_ERROR_FLOOR: Final = 3e-4
# Views that the errors of prefixes are measured in.
_MEASURED_VIEWS: Final = 12


@dataclass(frozen=True)
class FitConfig:
    """How compensation is fitted.

    Parameters
    ----------
    code_bits : int
        Of every splat's code, 0 to 8; at 0 only whole chunks are shifted.
    iterations : int
        For each layer.
    views : int
        Looked at in each.
    threads : int
        0 for every core this process may use. The result does not depend on it.
    """

    code_bits: int = 3
    iterations: int = 48
    views: int = 4
    threads: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.code_bits <= 8:
            raise ValueError(f"code_bits {self.code_bits}, expected 0 to 8")
        if self.iterations < 1 or self.views < 1:
            raise ValueError(f"{self}, expected at least 1 iteration and 1 view")
        thread_count(self.threads)


def plan_layers(chunk_splats: Sequence[int], effective_splats: int) -> list[int]:
    """Return the chunks of each layer's prefix, ascending; the whole scene is none of them."""
    layers: list[int] = []
    splats, last = 0, 0
    for chunk, count in enumerate(chunk_splats[:-1], start=1):
        splats += count
        if splats > _LAYERED * effective_splats:
            break
        if splats >= _GROWTH * last:
            layers.append(chunk)
            last = splats
    return layers


def _by_chunk(chunk: I64, values: F64, chunks: int) -> F64:
    """Return the sums of values over chunks: (chunks, 2)."""
    sums = [np.bincount(chunk, values[:, axis], minlength=chunks) for axis in range(2)]
    return np.stack(sums, axis=1)


def _rounded_book(book: F64) -> NDArray[np.int8]:
    return np.clip(np.rint(book / [SCALE_STEP, OPACITY_STEP]), -127, 127).astype(np.int8)


class _Fit:
    """What is being fitted: shifts of chunks, strengths, and every splat's own shift.

    Parameters
    ----------
    splats : Splats
        Of the last layer's prefix.
    chunk_splats : sequence of int
    layers : list of int
        Chunks of each layer.
    effective_splats : int
    config : FitConfig
    """

    def __init__(
        self,
        splats: Splats,
        chunk_splats: Sequence[int],
        layers: list[int],
        effective_splats: int,
        config: FitConfig,
    ) -> None:
        self.splats = splats
        self._bare = splats.without_extras().with_sh_degree(0)
        self.layers = layers
        self.config = config
        ends = np.cumsum(chunk_splats)
        self.sizes = [int(ends[chunks - 1]) for chunks in layers]
        chunks = layers[-1]
        self.chunk = np.repeat(np.arange(chunks), chunk_splats[:chunks])
        self.own = np.zeros((len(splats), 2))
        # Splats with codes: those of the layers that end early enough.
        coded = [size for size in self.sizes if size <= _CODED * effective_splats]
        self.coded = coded[-1] if coded and config.code_bits else 0
        owner = np.searchsorted(self.sizes, ends[:chunks], side="left")
        self.tables = np.zeros((len(layers), chunks, 2))
        self.strengths = np.zeros((len(layers), chunks, 2))
        for number, (count, size) in enumerate(zip(layers, self.sizes, strict=True)):
            wants = prefix_inflation.typical(size / effective_splats)
            self.tables[number, :count] = wants.scales, wants.opacities
            self.strengths[number, :count] = _FADE ** (number - owner[:count])[:, None]
        self.owner = owner
        self._own_steps = Adam(self.own.shape, _RATES)
        self._table_steps = Adam(self.tables.shape, _TABLE_RATES)
        self._strength_steps = Adam(self.strengths.shape, _STRENGTH_RATES)
        self.books: list[NDArray[np.int8]] = []

    def _said(self, size: int) -> F64:
        """Return what the codes of the first splats say."""
        said = self.own[:size].copy()
        if self.books:
            said = self._labelled(size)[1]
        said[self.coded :] = 0.0
        return said

    def _labelled(self, size: int) -> tuple[I64, F64]:
        labels = np.zeros(size, np.int64)
        said = np.zeros((size, 2))
        first = 0
        for number, book in enumerate(self.books):
            part = slice(first, min(self.sizes[number], size))
            first = part.stop
            exact = book * [SCALE_STEP, OPACITY_STEP]
            labels[part] = few_rows.nearest(self.own[part] / _SPREAD, exact / _SPREAD)
            said[part] = exact[labels[part]]
            if first == size:
                break
        return labels, said

    def close_books(self) -> None:
        """From here on, splats say what their nearest row of a book says."""
        first = 0
        for size in self.sizes:
            if size > self.coded:
                break
            rows = _book_rows(self.config.code_bits, size - first)
            values = np.clip(self.own[first:size], -_LIMITS, _LIMITS)
            self.books.append(_rounded_book(few_rows.train(values / _SPREAD, rows) * _SPREAD))
            first = size

    def shade(self, views: Sequence[int], references: ReferenceViews) -> list[NDArray[np.float32]]:
        """Return the colours of all splats in some views: no shift changes them."""
        rows = np.arange(len(self.splats), dtype=np.int32)
        cameras = [references.cameras[view] for view in views]
        threads = thread_count(self.config.threads)
        return list(ordered_map(partial(row_colours, self.splats, rows), cameras, threads))

    def improve(
        self,
        number: int,
        pace: float,
        references: ReferenceViews,
        views: Sequence[int],
        colours: Sequence[NDArray[np.float32]],
    ) -> None:
        """Take a step with one layer's prefix, as some views show it in these colours."""
        size, count = self.sizes[number], self.layers[number]
        chunk = self.chunk[:size]
        table, strength = self.tables[number], self.strengths[number]
        said = self._said(size)
        shift = (table[chunk] + strength[chunk] * said).astype(np.float32)
        prefix = self._bare.take(slice(0, size))
        drawn = replace(
            prefix,
            scales=prefix.scales + shift[:, :1],
            opacities=prefix.opacities + shift[:, 1],
        )
        lagrangian = np.zeros((size, 2))
        found = ordered_map(
            lambda seen: gradient(
                drawn,
                seen[1],
                references.cameras[seen[0]],
                references.pictures[seen[0]],
                kernel_px=references.kernels[seen[0]],
                near_plane=references.near_plane,
            ),
            zip(views, colours, strict=True),
            thread_count(self.config.threads),
        )
        for view, result in zip(views, found, strict=True):
            # PSNR is a logarithm: a view with little error counts as one with much.
            floor = _ERROR_FLOOR * references.pictures[view].size
            weight = float(references.weights[view]) / (result.error + floor)
            lagrangian[result.rows, 0] += weight * result.scales
            lagrangian[result.rows, 1] += weight * result.opacities
        if self.coded:
            own = slice(0, min(size, self.coded))
            self.own[own] -= pace * self._own_steps.step(own, (lagrangian * strength[chunk])[own])
        by_table = _by_chunk(chunk, lagrangian, len(table))
        by_strength = _by_chunk(chunk, lagrangian * said, len(table))
        table[:count] -= pace * self._table_steps.step(number, by_table)[:count]
        # What the newest chunks' codes say is said in full: it sets what a code means.
        older = self.owner[:count] < number
        told_step = self._strength_steps.step(number, by_strength)[:count]
        strength[:count][older] -= pace * told_step[older]
        np.clip(strength, 0.0, 255 * STRENGTH_STEP, out=strength)

    def result(self) -> list[Layer]:
        """Return the layers as they are stored."""
        labels = self._labelled(self.coded)[0] if self.books else np.zeros(0, np.int64)
        layers = []
        first = 0
        for number, (count, size) in enumerate(zip(self.layers, self.sizes, strict=True)):
            steps = np.rint(self.tables[number, :count] / [SCALE_STEP, OPACITY_STEP])
            table = np.clip(steps, -127, 127).astype(np.int8)
            strengths = np.rint(self.strengths[number, :count] / STRENGTH_STEP)
            book = self.books[number] if number < len(self.books) else np.zeros((0, 2), np.int8)
            layers.append(
                Layer(
                    scales=table[:, 0].copy(),
                    opacities=table[:, 1].copy(),
                    strengths=strengths.astype(np.uint8),
                    book=book,
                    codes=(labels[first:size] if len(book) else labels[:0]).astype(np.uint8),
                )
            )
            first = size
        return layers


def _nothing(chunks: int) -> Layer:
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
    progress: Progress = silent,
) -> Compensation:
    """Fit the compensation of a scene's prefixes to its own pictures.

    Parameters
    ----------
    splats : Splats
        As they are decoded, in stored order.
    chunk_splats : sequence of int
        Splats of each chunk.
    references : ReferenceViews
        Pictures of the source.
    effective_splats : int
        Of the source (`prefix_inflation.effective_splats`): how long a prefix is, in these.
    config : FitConfig, optional
    progress : Progress
        Called with ``("compensate", steps done, steps)``.

    Returns
    -------
    Compensation
        Without layers where the first chunk is all there is, or nearly.

    Notes
    -----
    Minimises the mean of the logarithm of each view's squared error by Adam, all layers in turn.
    Each splat has one code for all prefixes that it is in, chosen as it comes in; how much of it
    counts fades from layer to layer, as the chunk's strengths say. Where codes and books are in
    use, steps pass to what the codes stand for as if these were not rounded.
    """
    config = config or FitConfig()
    layers = plan_layers(chunk_splats, effective_splats)
    counts = np.array(chunk_splats, np.int64)
    if not layers:
        return Compensation((), counts)
    size = int(counts[: layers[-1]].sum())
    state = _Fit(splats.take(slice(0, size)), chunk_splats, layers, effective_splats, config)
    total = config.iterations * len(layers)
    close = int(_QUANTISED_FROM * config.iterations)
    progress("compensate", 0, total)
    for turn in range(config.iterations):
        if turn == close:
            state.close_books()
        pace = min(1.0, 2.0 * (1.0 - turn / config.iterations))
        views = references.sample(config.views, turn)
        colours = state.shade(views, references)
        for number in range(len(layers)):
            state.improve(number, pace, references, views, colours)
            progress("compensate", turn * len(layers) + number + 1, total)
    if not state.books:
        state.close_books()
    found = state.result()
    if _whole(chunk_splats, effective_splats, layers):
        found.append(_nothing(_whole(chunk_splats, effective_splats, layers)))
    return Compensation(tuple(found), counts)


def compensated(
    encoded: EncodedScene,
    references: ReferenceViews,
    contribution: NDArray[np.float64],
    config: FitConfig | None = None,
    *,
    progress: Progress = silent,
) -> EncodedScene:
    """Return an encoded scene with what its prefixes want.

    Parameters
    ----------
    encoded : EncodedScene
    references : ReferenceViews
        Pictures of what was encoded.
    contribution : (N,) float64
        Of the source's splats.
    config : FitConfig, optional
    progress : Progress
        Called with the stage ``compensate``.
    """
    config = config or FitConfig()
    counts = [chunk.splats for chunk in encoded.chunks]
    effective_splats = prefix_inflation.effective_splats(contribution)
    if not plan_layers(counts, effective_splats):
        return encoded
    splats = encoded.decoded
    found = fit(splats, counts, references, effective_splats, config, progress=progress)
    prefix_mse = errors(found, splats, references, threads=config.threads)
    return replace(encoded, compensation=found, prefix_mse=prefix_mse)


def errors(
    compensation: Compensation, splats: Splats, references: ReferenceViews, *, threads: int = 0
) -> F64:
    """Measure how far compensated prefixes are from the whole.

    Parameters
    ----------
    compensation : Compensation
    splats : Splats
        All of the scene's, as they are decoded.
    references : ReferenceViews
    threads : int
        0 for every core this process may use.

    Returns
    -------
    (c + 1,) float64
        Mean squared error of pictures without chunks, of the first, and so on to all.
    """
    views = references.sample(_MEASURED_VIEWS, 0)
    weights = references.weights[views] / references.weights[views].sum()
    ends = np.concatenate([[0], np.cumsum(compensation.chunk_splats)])
    found = np.zeros(len(ends))
    for chunks, end in enumerate(ends.tolist()):
        prefix = compensation.apply(splats.take(slice(0, end)), chunks)

        def far(view: int, prefix: Splats = prefix) -> float:
            picture = references.pictures[view]
            kernel_px, near_plane = references.kernels[view], references.near_plane
            info = prefix.info
            config = RenderConfig(kernel_px, info.antialiased, near_plane=near_plane, threads=1)
            drawn = np.clip(render(prefix, references.cameras[view], config), 0.0, 1.0)
            return float(np.mean(np.square(drawn - picture, dtype=np.float64)))

        each = list(ordered_map(far, views, thread_count(threads)))
        found[chunks] = float(weights @ np.array(each))
    return found


def blank(
    chunk_splats: Sequence[int], effective_splats: int, config: FitConfig | None = None
) -> Compensation:
    """Return a compensation that adds nothing and takes the same room as a fitted one.

    Parameters
    ----------
    chunk_splats, effective_splats, config
        As `fit` takes them.
    """
    config = config or FitConfig()
    layers = plan_layers(chunk_splats, effective_splats)
    ends = np.cumsum(chunk_splats)
    found = []
    first = 0
    for chunks in layers:
        size = int(ends[chunks - 1])
        layer = _nothing(chunks)
        if config.code_bits and size <= _CODED * effective_splats:
            rows = _book_rows(config.code_bits, size - first)
            layer = replace(
                layer, book=np.zeros((rows, 2), np.int8), codes=np.zeros(size - first, np.uint8)
            )
        found.append(layer)
        first = size
    if layers and _whole(chunk_splats, effective_splats, layers):
        found.append(_nothing(_whole(chunk_splats, effective_splats, layers)))
    return Compensation(tuple(found), np.array(chunk_splats, np.int64))


def _book_rows(bits: int, splats: int) -> int:
    return min(1 << bits, max(splats, 1))


def _whole(chunk_splats: Sequence[int], effective_splats: int, layers: Sequence[int]) -> int:
    """Return the chunks of the first prefix that wants nothing; 0 where that is no layer."""
    chunks = int(np.searchsorted(np.cumsum(chunk_splats), _WHOLE * effective_splats)) + 1
    return chunks if layers[-1] < chunks < len(chunk_splats) else 0
