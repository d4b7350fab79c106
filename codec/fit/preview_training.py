"""Preview training: few splats that show the whole scene in the first bytes of its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cogsplat.codec.encode.compensation_fit import errors_before_fit, plan_layers
from cogsplat.codec.encode.config import MAX_QUALITY_DB, MIN_QUALITY_DB, EncodeConfig
from cogsplat.codec.encode.encoded import EncodedChunk, EncodedScene
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import PreparedScene, prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.preview_chunks import prepend_preview
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.order.chunk_plan import plan_chunks
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.view_sets import sample_evenly

from .deletion_errors import deletion_errors
from .round_trip import round_trip
from .train_config import TrainConfig
from .trainer import Trainer
from .training_views import TrainingViews

# Bytes per preview splat. On a captured room 1,800 splats at 7.4 B showed 26.1 dB, and the same
# splats at 5.6 B showed 23.9 dB.
_BYTES_PER_SPLAT: Final = 7.2
# Share of the heads in the bytes that a preview adds to a file; compensation and tables take the
# rest. 91 to 95 % on a captured room, lower for small previews.
_HEAD_SHARE: Final = 0.9
# Minimum nominal quality, dB: below it, fewer splats stored finer show more.
_MIN_QUALITY_DB: Final = 26.0
# Splats at the start of each round, in multiples of the final number.
_ROUNDS: Final = (4.0, 2.4, 1.5, 1.0)
# Factors on the learning rates: at the first step of each round, and the decay until its last step,
# which is stronger in the last round.
_RATE: Final = 0.8
_ROUND_DECAY: Final = 0.7
_LAST_ROUND_DECAY: Final = 0.3
# Factors on the learning rates of quantised training: first step, last step.
_QUANTISED_RATES: Final = (0.5, 0.1)
# Inflation of the splats before training: the typical one of a twentieth of a scene, less the part
# that training adds by itself.
_INFLATION: Final = prefix_inflation.Inflation(0.35, 1.5)
_MAX_LOGIT: Final = 8.0
# Number of views for deletion errors, for scoring the preview, and for measuring its error.
_DELETION_VIEWS: Final = 40
_SCORED_VIEWS: Final = 24
_MEASURED_VIEWS: Final = 8
# The preview ends where the scene's own splats, with `best_inflation`, have at most this share
# of its error. With 0.5, 256 KiB of a captured room show 29.9 dB in place of 30.5 dB, and shorter
# prefixes gain nothing.
_END_ERROR_SHARE: Final = 0.7
# Limit for large scenes, bytes: a preview serves the first seconds of loading.
_MAX_BYTES: Final = 1 << 16
# Limit of the number of splats, as a share of `prefix_inflation.effective_splats`: that many of the
# scene's own splats show the scene as well.
_MAX_SPLAT_SHARE: Final = 0.25
# Precision of the search for a nominal quality, dB.
_QUALITY_PRECISION_DB: Final = 0.15


@dataclass(frozen=True)
class PreviewConfig:
    """Settings of preview training.

    Parameters
    ----------
    share : float
        Size of the preview relative to the file without it, between 0 and 1; at most 64 KiB.
    round_steps : int
        Training steps in each of the four pruning rounds.
    quantised_steps : int
        Training steps through the quantisers.
    encode_interval : int
        Training steps between two encodes of the preview in quantised training.
    seed : int
        Seed of the order of views.
    threads : int
        Number of threads; 0 uses all cores. The result does not depend on it.
    """

    share: float = 0.02
    round_steps: int = 160
    quantised_steps: int = 80
    encode_interval: int = 10
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        if not 0.0 < self.share < 1.0:
            raise ValueError(f"share {self.share}, expected between 0 and 1")
        steps = (self.round_steps, self.quantised_steps, self.encode_interval)
        if min(steps) < 1:
            raise ValueError(f"steps {steps}, expected at least 1 each")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed}, expected 0 or more")
        thread_count(self.threads)


class TrainedPreview:
    """Trains a preview and adds it to encoded scenes (`preview_chunks.PreviewMaker`).

    The preview starts as the first splats of the scene, without higher SH coefficients. Rounds
    delete the splats with the smallest deletion errors, and train all values of the others to show
    the whole scene. The remaining splats are then trained through their quantisers.

    Parameters
    ----------
    config : PreviewConfig, optional
        Size, steps, seed and threads.
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
        """Train a preview and return the scene with its chunks in front.

        Parameters
        ----------
        encoded : EncodedScene
            Scene without compensation.
        references : ReferenceViews
            Renders of the source, the ground truth that the preview is trained on.
        effective_splats : int
            Effective number of splats of the source (`prefix_inflation.effective_splats`).
        progress : Progress
            Receives the stage ``preview``, in steps.

        Returns
        -------
        EncodedScene
            Scene with preview; it does not depend on the number of threads. The scene itself where
            the preview would have no splats.
        """
        size = self._head_budget(encoded)
        count = min(int(size / _BYTES_PER_SPLAT), int(_MAX_SPLAT_SHARE * effective_splats))
        count = min(count, encoded.splats)
        if count < 1:
            return encoded
        size = min(size, int((count + 1) * _BYTES_PER_SPLAT))
        views = _as_training_views(references, encoded.decoded)
        trainer = self._train(encoded, views, count, progress)
        preview = self._train_quantised(trainer, views, size, progress)
        if preview is None:
            return encoded
        prefix_mse = errors_before_fit(encoded, references, effective_splats)
        encoded = replace(encoded, prefix_mse=prefix_mse)
        own = len(preview.chunks)
        counts = [chunk.splats for chunk in (*preview.chunks, *encoded.chunks)]
        # It ends at a compensation layer, which is fitted to the picture without the preview.
        ends = [*(end for end in plan_layers(counts, effective_splats) if end > own), len(counts)]
        max_error = _END_ERROR_SHARE * _mean_error(preview.decoded, references)
        until = next((end for end in ends if prefix_mse[end - own] <= max_error), ends[-1])
        return prepend_preview(encoded, preview, until)

    def reserve(self, encoded: EncodedScene) -> EncodedScene:
        """Return a scene with dummy preview chunks, of the largest size that `add` can make."""
        size = self._head_budget(encoded)
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
        dummy = replace(encoded, splats=count, chunks=chunks, decoded=rows)
        return prepend_preview(encoded, dummy, len(runs) + 1)

    def _head_budget(self, encoded: EncodedScene) -> int:
        """Return the maximum size of the heads of the preview chunks, bytes."""
        total = sum(len(payload) for book in encoded.codebooks for payload in book.payloads)
        for chunk in encoded.chunks:
            parts = chunk.payloads
            total += len(parts.head) + len(parts.refinement or b"") + len(parts.tail or b"")
        return min(int(_HEAD_SHARE * self._config.share * total), _MAX_BYTES)

    def _total_steps(self) -> int:
        """Return the number of training steps of a preview."""
        return len(_ROUNDS) * self._config.round_steps + self._config.quantised_steps

    def _train(
        self, encoded: EncodedScene, views: TrainingViews, count: int, progress: Progress
    ) -> Trainer:
        """Prune the first splats of a scene down to `count`; return the trainer of the preview."""
        config = self._config
        first = min(round(_ROUNDS[0] * count), encoded.splats)
        initial = encoded.decoded.with_sh_degree(0).take(np.arange(first))
        initial = prefix_inflation.inflate(initial, _INFLATION)
        clipped = np.minimum(initial.opacities, np.float32(_MAX_LOGIT))
        settings = TrainConfig(seed=config.seed, threads=config.threads)
        trainer = Trainer(replace(initial, opacities=clipped), views, settings)
        progress("preview", 0, self._total_steps())
        for number, multiple in enumerate(_ROUNDS):
            kept = round(multiple * count)
            if kept < len(trainer.splats):
                self._prune(trainer, views, kept)
            is_last = number + 1 == len(_ROUNDS)
            decay = _LAST_ROUND_DECAY if is_last else _ROUND_DECAY
            trainer.run(config.round_steps, _RATE, _RATE * decay)
            progress("preview", (number + 1) * config.round_steps, self._total_steps())
        return trainer

    def _prune(self, trainer: Trainer, views: TrainingViews, count: int) -> None:
        """Delete all splats but the `count` with the largest deletion errors."""
        shown = views.sample(_DELETION_VIEWS, self._config.seed)
        errors = deletion_errors(trainer.splats, shown, threads=self._config.threads)
        trainer.keep(np.sort(np.argsort(-errors, kind="stable")[:count]))

    def _train_quantised(
        self, trainer: Trainer, views: TrainingViews, size: int, progress: Progress
    ) -> EncodedScene | None:
        """Train the preview through its quantisers and encode it.

        Parameters
        ----------
        trainer : Trainer
            Holds the trained preview.
        views : TrainingViews
            Views of the whole scene.
        size : int
            Maximum size of the heads, bytes.
        progress : Progress
            Receives the stage ``preview``, in steps.

        Returns
        -------
        EncodedScene or None
            Encoded preview; None where not even one splat fits.
        """
        config = self._config
        prepared = self._score(trainer.splats, views)
        while (smallest := _head_bytes(prepared, _MIN_QUALITY_DB)) > size:
            count = int(len(trainer.splats) * size / smallest)
            if count < 1:
                return None
            self._prune(trainer, views, count)
            trainer.run(config.encode_interval, _RATE, _RATE * _LAST_ROUND_DECAY)
            prepared = self._score(trainer.splats, views)
        quality_db = _quality_for_size(prepared, size)
        done = 0
        while done < config.quantised_steps:
            steps = min(config.encode_interval, config.quantised_steps - done)
            decoded = round_trip(prepared, trainer.splats, quality_db).decoded
            first, last = (
                _quantised_rate(at / config.quantised_steps) for at in (done, done + steps)
            )
            trainer.run(steps, first, last, decoded=decoded)
            done += steps
            total = self._total_steps()
            progress("preview", total - config.quantised_steps + done, total)
        prepared = replace(prepared, source=trainer.splats)
        return encode_chunks(prepared, _quality_for_size(prepared, size))

    def _score(self, splats: Splats, views: TrainingViews) -> PreparedScene:
        """Score and order preview splats in a sample of the given training views."""
        threads = self._config.threads
        cameras = sample_evenly(views.cameras[: views.num_given], _SCORED_VIEWS)
        settings = PRESETS["fast"].score_config("transform", threads=threads)
        config = EncodeConfig(
            order="contribution",
            refine=False,
            compensate=False,
            prune=None,
            threads=threads,
        )
        return prepare(splats, score(splats, cameras, settings), config, views=cameras)


def _quantised_rate(done: float) -> float:
    """Return the learning-rate factor after a share, 0 to 1, of the quantised steps."""
    first, last = _QUANTISED_RATES
    return float(first * (last / first) ** done)


def _head_bytes(prepared: PreparedScene, quality_db: float) -> int:
    """Return the size of all heads at a nominal quality, bytes."""
    encoded = encode_chunks(prepared, quality_db)
    return sum(len(chunk.payloads.head) for chunk in encoded.chunks)


def _quality_for_size(prepared: PreparedScene, size: int) -> float:
    """Return the highest nominal quality, dB, at which all heads take at most `size` bytes."""
    low, high = MIN_QUALITY_DB, MAX_QUALITY_DB
    while high - low > _QUALITY_PRECISION_DB:
        middle = (low + high) / 2
        if _head_bytes(prepared, middle) > size:
            high = middle
        else:
            low = middle
    return low


def _as_training_views(references: ReferenceViews, splats: Splats) -> TrainingViews:
    """Return reference views as training views."""
    configs = [
        RenderConfig(near_plane=references.near_plane, reduction=reduction, threads=1)
        for reduction in references.reductions
    ]
    given = references.given
    return TrainingViews(references.cameras, configs, references.pictures, given)


def _mean_error(splats: Splats, references: ReferenceViews) -> float:
    """Return the weighted mean squared error of a scene over a sample of reference views."""
    sample = references.sample(_MEASURED_VIEWS, 0)
    views = _as_training_views(references, splats)
    weights = references.weights[sample] / references.weights[sample].sum()
    errors = []
    for view in sample:
        picture = np.clip(render(splats, views.cameras[view], views.configs[view]), 0.0, 1.0)
        difference = np.square(picture - references.pictures[view], dtype=np.float64)
        errors.append(float(np.mean(difference)))
    return float(weights @ np.array(errors))
