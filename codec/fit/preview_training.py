"""Trained previews: few splats that show the whole scene in the first bytes of its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cogsplat.codec.encode.compensation_fit import plan_layers, usual_errors
from cogsplat.codec.encode.config import MAX_QUALITY_DB, MIN_QUALITY_DB, EncodeConfig
from cogsplat.codec.encode.encoded import EncodedChunk, EncodedScene
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import PreparedScene, prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.preview_chunks import prepend_preview
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.order.chunks import plan_chunks
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.view_sets import sample_evenly

from .deletion import deletion_errors
from .round_trip import round_trip
from .trainer import TrainConfig, Trainer
from .training_views import TrainingViews

# What a splat of a preview takes. On a captured room 1,800 splats of 7.4 B showed 26.1 dB and the
# same in 5.6 B each 23.9.
_BYTES_PER_SPLAT: Final = 7.2
# What the heads of a preview are of the bytes that it makes a file longer by; the others are codes
# of its compensation and rows of tables. Of a captured room 91 to 95 %, the less the smaller.
_OF_HEADS: Final = 0.9
# Below this nominal quality, dB, fewer splats that are stored finer show more.
_LEAST_DB: Final = 26.0
# Splats that training begins with and that each round keeps, in multiples of those that stay.
_ROUNDS: Final = (4.0, 2.4, 1.5, 1.0)
# Factors on the learning rates: of the first step of each round, and what its last step has of
# that, in the last round less.
_RATE: Final = 0.8
_ROUND_FALL: Final = 0.7
_LAST_FALL: Final = 0.3
# The same while the preview trains through its quantisers.
_STORED_RATES: Final = (0.5, 0.1)
# What the first splats of a scene are inflated by before they are trained: the typical inflation of
# a twentieth of a scene, less what training does on its own.
_INFLATION: Final = prefix_inflation.Inflation(0.35, 1.5)
_LARGEST_LOGIT: Final = 8.0
# Views that deletion errors are measured in, that the preview is scored in, and that its error is
# measured in.
_DELETION_VIEWS: Final = 40
_SCORED_VIEWS: Final = 24
_MEASURED_VIEWS: Final = 8
# The preview ends where the others alone, with the usual inflation, have so much of its error. With
# 0.5, 256 KiB of a captured room show 29.9 dB in place of 30.5, and shorter prefixes the same.
_END_SHARE: Final = 0.7
# A preview is for the first seconds: of a large scene it takes no more than this, bytes.
_MOST_BYTES: Final = 1 << 16
# Nor more splats than this, times `prefix_inflation.effective_splats`: so many of the scene's own
# show it as well.
_MOST_SPLATS: Final = 0.25
# Nominal qualities are searched for to this, dB.
_NEAR_DB: Final = 0.15


@dataclass(frozen=True)
class PreviewConfig:
    """How a preview is made.

    Parameters
    ----------
    share : float
        By which it makes the file longer, above 0 and below 1; 64 KiB at most.
    round_steps : int
        Steps of training in each of the four rounds that leave ever fewer splats.
    quantised_steps : int
        Steps of training through the quantisers.
    refresh : int
        Steps between two encodes of the preview.
    seed : int
        Decides in which order views come.
    threads : int
        0 for every core this process may use. The result does not depend on it.
    """

    share: float = 0.02
    round_steps: int = 160
    quantised_steps: int = 80
    refresh: int = 10
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.share < 1.0:
            raise ValueError(f"share {self.share}, expected between 0 and 1")
        steps = (self.round_steps, self.quantised_steps, self.refresh)
        if min(steps) < 1:
            raise ValueError(f"steps {steps}, expected at least 1 each")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed}, expected 0 or more")
        thread_count(self.threads)


class TrainedPreview:
    """Adds a preview to encoded scenes (`encode.preview_chunks.PreviewMaker`).

    It begins as the first splats of the scene, without higher SH coefficients. In rounds, those
    whose absence changes the pictures least are left out and the others trained, in all their
    values, to look like the whole scene; then they train on through their quantisers.

    Parameters
    ----------
    config : PreviewConfig, optional
    """

    def __init__(self, config: PreviewConfig | None = None) -> None:
        self._config = config or PreviewConfig()

    def add(
        self,
        encoded: EncodedScene,
        references: ReferenceViews,
        effective_splats: int,
        *,
        progress: Progress = silent,
    ) -> EncodedScene:
        """Return a scene with its preview as the first chunks.

        Parameters
        ----------
        encoded : EncodedScene
            Without compensation.
        references : ReferenceViews
            Pictures of what was encoded: the preview is trained in these.
        effective_splats : int
            Of the source (`prefix_inflation.effective_splats`).
        progress : Progress
            Called with ``preview``, steps done and steps.

        Returns
        -------
        EncodedScene
            The same for any number of threads. Without a preview where its bytes are too few for
            a splat, or where the scene has none.
        """
        size = self._bytes(encoded)
        count = min(int(size / _BYTES_PER_SPLAT), int(_MOST_SPLATS * effective_splats))
        count = min(count, encoded.splats)
        if count < 1:
            return encoded
        size = min(size, int((count + 1) * _BYTES_PER_SPLAT))
        training_views = _training_views(references, encoded.decoded)
        trainer = self._trained(encoded, training_views, count, progress)
        made = self._stored(trainer, training_views, size, progress)
        if made is None:
            return encoded
        prefix_mse = usual_errors(encoded, references, effective_splats)
        encoded = replace(encoded, prefix_mse=prefix_mse)
        own = len(made.chunks)
        counts = [chunk.splats for chunk in (*made.chunks, *encoded.chunks)]
        # Where a layer of the compensation is complete, what it adds is made for the picture there.
        ends = [*(end for end in plan_layers(counts, effective_splats) if end > own), len(counts)]
        enough = _END_SHARE * _error(made.decoded, references)
        until = next((end for end in ends if prefix_mse[end - own] <= enough), ends[-1])
        return prepend_preview(encoded, made, until)

    def reserve(self, encoded: EncodedScene) -> EncodedScene:
        """Return a scene with first chunks of so many bytes as its preview may take."""
        size = self._bytes(encoded)
        count = min(int(size / _BYTES_PER_SPLAT), encoded.splats)
        if count < 1:
            return encoded
        runs = plan_chunks(count)
        chunks = [
            EncodedChunk(
                splats=run.stop - run.start,
                payloads=Payloads(bytes(-(-size // len(runs))), None, (), (), np.arange(0)),
                box=encoded.box,
                contribution=0.0,
            )
            for run in runs
        ]
        rows = encoded.decoded.with_sh_degree(0).take(np.arange(count))
        blank = replace(encoded, splats=count, chunks=chunks, decoded=rows)
        return prepend_preview(encoded, blank, len(runs) + 1)

    def _bytes(self, encoded: EncodedScene) -> int:
        """Return how many bytes the head of the preview may take."""
        total = sum(len(payload) for book in encoded.codebooks for payload in book.payloads)
        for chunk in encoded.chunks:
            parts = chunk.payloads
            total += len(parts.head) + len(parts.refinement or b"") + len(parts.tail or b"")
        return min(int(_OF_HEADS * self._config.share * total), _MOST_BYTES)

    def _steps(self) -> int:
        return len(_ROUNDS) * self._config.round_steps + self._config.quantised_steps

    def _trained(
        self, encoded: EncodedScene, training_views: TrainingViews, count: int, progress: Progress
    ) -> Trainer:
        """Return what is left of the first splats, trained to look like all."""
        config = self._config
        first = min(round(_ROUNDS[0] * count), encoded.splats)
        begin = encoded.decoded.with_sh_degree(0).take(np.arange(first))
        begin = prefix_inflation.inflate(begin, _INFLATION)
        clipped = np.minimum(begin.opacities, np.float32(_LARGEST_LOGIT))
        settings = TrainConfig(seed=config.seed, threads=config.threads)
        trainer = Trainer(replace(begin, opacities=clipped), training_views, settings)
        progress("preview", 0, self._steps())
        for number, times in enumerate(_ROUNDS):
            left = round(times * count)
            if left < len(trainer.splats):
                self._leave_out(trainer, training_views, left)
            last = number + 1 == len(_ROUNDS)
            fall = _LAST_FALL if last else _ROUND_FALL
            trainer.run(config.round_steps, _RATE, _RATE * fall)
            progress("preview", (number + 1) * config.round_steps, self._steps())
        return trainer

    def _leave_out(self, trainer: Trainer, training_views: TrainingViews, left: int) -> None:
        """Keep so many splats, those whose absence would change the pictures most."""
        some = sample_evenly(range(len(training_views)), _DELETION_VIEWS)
        errors = deletion_errors(trainer.splats, training_views, some, threads=self._config.threads)
        trainer.keep(np.sort(np.argsort(-errors, kind="stable")[:left]))

    def _stored(
        self, trainer: Trainer, training_views: TrainingViews, size: int, progress: Progress
    ) -> EncodedScene | None:
        """Train the preview through its quantisers; return it in `size` bytes, if it can be."""
        config = self._config
        prepared = self._prepared(trainer.splats, training_views)
        while (taken := _head_bytes(prepared, _LEAST_DB)) > size:
            left = int(len(trainer.splats) * size / taken)
            if left < 1:
                return None
            self._leave_out(trainer, training_views, left)
            trainer.run(config.refresh, _RATE, _RATE * _LAST_FALL)
            prepared = self._prepared(trainer.splats, training_views)
        quality = _quality(prepared, size)
        done = 0
        while done < config.quantised_steps:
            steps = min(config.refresh, config.quantised_steps - done)
            decoded = round_trip(prepared, trainer.splats, quality).decoded
            first, last = (_stored_rate(at / config.quantised_steps) for at in (done, done + steps))
            trainer.run(steps, first, last, decoded=decoded)
            done += steps
            progress("preview", self._steps() - config.quantised_steps + done, self._steps())
        prepared = replace(prepared, source=trainer.splats)
        return encode_chunks(prepared, _quality(prepared, size))

    def _prepared(self, splats: Splats, training_views: TrainingViews) -> PreparedScene:
        """Return the preview scored in the views that it is trained in."""
        threads = self._config.threads
        views = sample_evenly(training_views.cameras[: training_views.given], _SCORED_VIEWS)
        settings = PRESETS["fast"].score_config("transform", threads=threads)
        config = EncodeConfig(
            order="contribution",
            refine=False,
            compensate=False,
            prune=None,
            threads=threads,
        )
        return prepare(splats, score(splats, views, settings), config, views=views)


def _stored_rate(done: float) -> float:
    """Return the factor on the learning rates when a share of the steps is made."""
    first, last = _STORED_RATES
    return float(first * (last / first) ** done)


def _head_bytes(prepared: PreparedScene, quality_db: float) -> int:
    """Return the bytes of all heads at a nominal quality."""
    made = encode_chunks(prepared, quality_db)
    return sum(len(chunk.payloads.head) for chunk in made.chunks)


def _quality(prepared: PreparedScene, size: int) -> float:
    """Return the finest nominal quality, dB, at which the heads take at most so many bytes."""
    low, high = MIN_QUALITY_DB, MAX_QUALITY_DB
    while high - low > _NEAR_DB:
        middle = (low + high) / 2
        if _head_bytes(prepared, middle) > size:
            high = middle
        else:
            low = middle
    return low


def _training_views(references: ReferenceViews, splats: Splats) -> TrainingViews:
    """Return the reference views as training_views."""
    configs = [
        RenderConfig(kernel, splats.info.antialiased, near_plane=references.near_plane, threads=1)
        for kernel in references.kernels
    ]
    given = references.given
    return TrainingViews(references.cameras, configs, references.pictures, given, given)


def _error(splats: Splats, references: ReferenceViews) -> float:
    """Return the mean squared error of a scene in some of the reference views."""
    views = references.sample(_MEASURED_VIEWS, 0)
    training_views = _training_views(references, splats)
    weights = references.weights[views] / references.weights[views].sum()
    errors = []
    for view in views:
        drawn = np.clip(
            render(splats, training_views.cameras[view], training_views.configs[view]), 0.0, 1.0
        )
        off = np.square(drawn - references.pictures[view], dtype=np.float64)
        errors.append(float(np.mean(off)))
    return float(weights @ np.array(errors))
