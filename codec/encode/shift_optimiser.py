"""Gradient descent on the shifts of scales and opacities of a scene's prefixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering import few_rows
from cogsplat.codec.executor import Executor
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.order.prefix_inflation import Inflation
from cogsplat.codec.render.gradients import Gradient, gradient
from cogsplat.codec.render.shading import row_colours
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.prefix_compensation import (
    OPACITY_STEP,
    SCALE_STEP,
    STRENGTH_STEP,
    Layer,
)
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count

from .shift_adam import ShiftAdam
from .shift_kernels import add_gradient, choose_rows, draw_shifts, move_shifts

F64 = NDArray[np.float64]

# Largest absolute shift of a code: log scale, logit.
_LIMITS: Final = np.array([0.9, 6.0])
# Shifts of log scale and logit that change pictures about equally: the unit of distance.
_SPREAD: Final = np.array([0.3, 1.8])
# Initial strength of a chunk's shifts in each later layer, relative to the layer before: its shifts
# were fitted to shorter prefixes.
_FADE: Final = 0.57
# Learning rates of Adam (Kingma and Ba 2015): scales, opacities.
_SPLAT_RATES: Final = np.array([0.04, 0.2])
_CHUNK_RATES: Final = np.array([0.02, 0.1])
_STRENGTH_RATES: Final = np.array([0.02, 0.02])
# Term added to a view's mean squared error before the logarithm.
_ERROR_FLOOR: Final = 3e-4

# Units of stored shifts (SPEC 8.5).
_STEPS: Final = np.array([SCALE_STEP, OPACITY_STEP])


@dataclass(frozen=True)
class FitConfig:
    """Settings of the compensation fit.

    Parameters
    ----------
    code_bits : int
        Bits of each splat's code, 0 to 8; 0 shifts whole chunks only.
    iterations : int
        Iterations per layer.
    views : int
        Views rendered in each iteration.
    coded_share : float
        Length of the longest prefix with codes, in `prefix_inflation.effective_splats`; 0 or more.
        In longer prefixes, codes take more bytes than they are worth. At 0.65 in place of 0.2, two
        trained objects show 0.15 and 0.3 dB less in as many bytes. The first half of one then shows
        1 dB more, and the first two thirds of the other 1.5 dB less.
    threads : int
        Number of threads, 0 for all cores. The result does not depend on it.
    """

    code_bits: int = 3
    iterations: int = 16
    views: int = 4
    coded_share: float = 0.2
    threads: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        if not 0 <= self.code_bits <= 8:
            raise ValueError(f"code_bits {self.code_bits}, expected 0 to 8")
        if self.iterations < 1 or self.views < 1:
            raise ValueError(f"{self}, expected at least 1 iteration and 1 view")
        if not self.coded_share >= 0:
            raise ValueError(f"coded_share {self.coded_share}, expected 0 or more")
        thread_count(self.threads)


def coded_splats(sizes: Sequence[int], effective_splats: int, config: FitConfig) -> int:
    """Return the number of leading splats that have codes, which are codebook indices.

    Parameters
    ----------
    sizes : sequence of int
        Splats of each layer's prefix, ascending.
    effective_splats : int
        Effective number of splats of the source.
    config : FitConfig
        Bits of a code, and share of coded splats.
    """
    coded = [size for size in sizes if size <= config.coded_share * effective_splats]
    return coded[-1] if coded and config.code_bits else 0


def shift_codebook_rows(code_bits: int, splats: int) -> int:
    """Return the rows of a layer's codebook: one per code, at most one per new splat.

    Parameters
    ----------
    code_bits : int
        Number of bits of a code.
    splats : int
        Number of new splats of the layer.
    """
    return min(1 << code_bits, max(splats, 1))


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Shifted log scales, (n, 3), and logits, (n,), of a rendered prefix."""

    scales: NDArray[np.float32]
    opacities: NDArray[np.float32]


def _view_gradient(
    view: int, prefix: Splats, references: ReferenceViews, drawn: _Drawn
) -> Gradient:
    """Return the gradient of a view's error w.r.t. the shifted log scales and logits."""
    camera = references.cameras[view]
    shapes = prefix.without_extras().with_sh_degree(0)
    return gradient(
        replace(shapes, scales=drawn.scales, opacities=drawn.opacities),
        row_colours(prefix, np.arange(len(prefix), dtype=np.int32), camera),
        camera,
        references.pictures[view],
        reduction=references.reductions[view],
        near_plane=references.near_plane,
    )


class ShiftOptimiser:
    """Optimiser of the compensation shifts of one scene.

    A layer is a prefix of whole chunks. In a layer, the log scale and the logit of a splat are
    shifted by its chunk's shift plus its own shift times its chunk's strength. A splat's own shift
    is the same in all layers.

    Parameters
    ----------
    prefixes : sequence of Splats
        Prefix of each layer without shifts.
    chunk_splats : sequence of int
        Splats of each chunk of the scene.
    layers : sequence of int
        Number of chunks of each layer's prefix, ascending.
    inflations : sequence of Inflation
        Initial chunk shifts of each layer.
    effective_splats : int
        Effective number of splats of the source (`prefix_inflation.effective_splats`).
    config : FitConfig
        Settings of the fit.
    executor : Executor
        Runs the gradients of single views.
    """

    def __init__(
        self,
        prefixes: Sequence[Splats],
        chunk_splats: Sequence[int],
        layers: Sequence[int],
        inflations: Sequence[Inflation],
        effective_splats: int,
        config: FitConfig,
        executor: Executor,
    ) -> None:
        self._executor = executor
        self._prefixes = list(prefixes)
        self._layers = list(layers)
        self._config = config
        ends = np.cumsum(chunk_splats)
        self._sizes = [int(ends[chunks - 1]) for chunks in layers]
        chunks = self._layers[-1]
        self._starts = np.concatenate([[0], ends[:chunks]]).astype(np.int64)
        # First layer of each chunk.
        self._first_layer = np.searchsorted(self._sizes, ends[:chunks], side="left")
        self._coded = coded_splats(self._sizes, effective_splats, config)
        # Optimised shifts, shifts used for rendering, and moments of the gradient.
        self._splat_shifts = np.zeros((self._coded, 2), np.float32)
        self._own = np.zeros((self._coded, 2), np.float32)
        self._moments = np.zeros((2, self._coded, 2), np.float32)
        self._counts = np.zeros(chunks, np.int64)
        self._codes = np.zeros(self._coded, np.uint8)
        size = self._sizes[-1]
        self._gradients = np.empty((size, 2))
        self._drawn = np.empty((size, 3), np.float32), np.empty(size, np.float32)
        self._chunk_shifts = np.zeros((len(layers), chunks, 2))
        self._strengths = np.zeros((len(layers), chunks, 2))
        for number, (count, by) in enumerate(zip(layers, inflations, strict=True)):
            self._chunk_shifts[number, :count] = by.scales, by.opacities
            self._strengths[number, :count] = _FADE ** (number - self._first_layer[:count])[:, None]
        self._chunk_steps = ShiftAdam(self._chunk_shifts.shape, _CHUNK_RATES)
        self._strength_steps = ShiftAdam(self._strengths.shape, _STRENGTH_RATES)
        # Codebook of each layer with codes, in units of `_STEPS`; empty before training.
        self._codebooks: list[NDArray[np.int8]] = []

    @property
    def is_quantised(self) -> bool:
        """Whether splats use the shifts of codebook rows."""
        return bool(self._codebooks)

    def quantise(self) -> None:
        """Train a codebook per layer; from now on splats use the shifts of their rows."""
        first = 0
        for size in self._sizes:
            if size > self._coded:
                break
            rows = shift_codebook_rows(self._config.code_bits, size - first)
            shifts = np.clip(self._splat_shifts[first:size].astype(np.float64), -_LIMITS, _LIMITS)
            book = few_rows.train(shifts / _SPREAD, rows) * _SPREAD
            self._codebooks.append(_in_steps(book))
            first = size
        self._update_rendered(self._coded)

    def step(
        self,
        number: int,
        rate: float,
        references: ReferenceViews,
        views: Sequence[int],
    ) -> None:
        """Move the shifts of one layer against the gradient of its picture error.

        Parameters
        ----------
        number : int
            Number of the layer.
        rate : float
            Factor on all learning rates.
        references : ReferenceViews
            Pictures of the source.
        views : sequence of int
            Numbers of the reference views to render.
        """
        size, count = self._sizes[number], self._layers[number]
        starts = self._starts[: count + 1]
        chunk_shifts, strengths = self._chunk_shifts[number], self._strengths[number]
        bare, (scales, opacities) = self._prefixes[number], self._drawn
        coded = min(size, self._coded)
        own = self._own[:coded]
        draw_shifts(
            starts, chunk_shifts, strengths, own, bare.scales, bare.opacities, scales, opacities
        )
        gradients = self._layer_gradient(number, references, views)
        self._counts[:count] += 1
        of_chunks, of_strengths = np.zeros((2, *chunk_shifts.shape))
        means, squares = self._moments
        move_shifts(
            starts,
            gradients,
            strengths,
            rate * _SPLAT_RATES,
            self._counts,
            means[:coded],
            squares[:coded],
            self._splat_shifts[:coded],
            own,
            of_chunks,
            of_strengths,
        )
        self._update_rendered(size)
        chunk_shifts[:count] -= rate * self._chunk_steps.step(number, of_chunks)[:count]
        # A chunk's strength in its first layer stays 1, which fixes the unit of its splats' shifts.
        older = self._first_layer[:count] < number
        moved = self._strength_steps.step(number, of_strengths)[:count]
        strengths[:count][older] -= rate * moved[older]
        np.clip(strengths, 0.0, 255 * STRENGTH_STEP, out=strengths)

    def layers(self) -> list[Layer]:
        """Return the fitted layers: shifts, strengths and codebooks in the units of the file."""
        stored = []
        first = 0
        for number, (count, size) in enumerate(zip(self._layers, self._sizes, strict=True)):
            shifts = _in_steps(self._chunk_shifts[number, :count])
            strengths = np.rint(self._strengths[number, :count] / STRENGTH_STEP)
            book = np.zeros((0, 2), np.int8)
            codes = self._codes[:0]
            if number < len(self._codebooks):
                book, codes = self._codebooks[number], self._codes[first:size].copy()
            stored.append(
                Layer(
                    scales=shifts[:, 0].copy(),
                    opacities=shifts[:, 1].copy(),
                    strengths=strengths.astype(np.uint8),
                    book=book,
                    codes=codes,
                )
            )
            first = size
        return stored

    def _layer_gradient(
        self,
        number: int,
        references: ReferenceViews,
        views: Sequence[int],
    ) -> F64:
        """Return the gradient of the views' mean log error w.r.t. a layer's shifts, (n, 2)."""
        size = self._sizes[number]
        # A new object for each step: an executor may cache shared arguments.
        drawn = _Drawn(*(values[:size] for values in self._drawn))
        found = self._executor.map(_view_gradient, views, self._prefixes[number], references, drawn)
        gradients = self._gradients[:size]
        gradients[:] = 0.0
        for view, result in zip(views, found, strict=True):
            # PSNR is logarithmic: views count equally whatever their error.
            floor = _ERROR_FLOOR * references.pictures[view].size
            weight = float(references.weights[view]) / (result.error + floor)
            add_gradient(result.rows, result.scales, result.opacities, weight, gradients)
        return gradients

    def _update_rendered(self, stop: int) -> None:
        """Update the shifts with which the first `stop` splats are rendered.

        A splat has its own shift or, after `quantise`, that of the nearest codebook row.
        """
        if not self._codebooks:
            self._own[:stop] = self._splat_shifts[:stop]
            return
        first = 0
        for size, book in zip(self._sizes, self._codebooks, strict=False):
            part = slice(first, min(size, stop))
            choose_rows(
                self._splat_shifts[part],
                _SPREAD,
                book * _STEPS,
                self._codes[part],
                self._own[part],
            )
            if size >= stop:
                break
            first = size


def _in_steps(shifts: F64) -> NDArray[np.int8]:
    """Quantise shifts to int8, in the units of the file."""
    stored: NDArray[np.int8] = np.clip(np.rint(shifts / _STEPS), -127, 127).astype(np.int8)
    return stored
