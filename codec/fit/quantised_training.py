"""Quantised training: encode, decode, steer towards a target and train, in cycles."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import MAX_QUALITY_DB, MIN_QUALITY_DB, EncodeConfig
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.finishing import Finisher, SizeOf
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.rate_control import LOG2_BYTES_PER_DB, PSNR_PER_DB, search_psnr
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.encode.scored_views import score_scene
from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.order.prefix_inflation import effective_splats
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate.allocation import lagrangian
from cogsplat.codec.scoring.contribution import Scores, score
from cogsplat.codec.scoring.reference_views import render_references
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.drawn_views import ViewDrawer
from cogsplat.codec.views.view_sets import TEST_VIEWS, sample_evenly

from .checkpoint_arrays import CheckpointArrays
from .prefix_loss import PrefixLoss
from .preview_training import PreviewConfig, TrainedPreview
from .rate_gradients import ERROR_PER_BIT, rate_gradients
from .round_trip import RoundTrip, round_trip
from .trainer import Trainer
from .tune_config import TuneRequest

# Factors on the learning rates at the first and the last step.
_LEARNING_RATE_FACTORS: Final = (0.8, 0.04)
# Share of the steps in which the nominal quality follows the target. Afterwards the quantiser steps
# are fixed, so that values converge to the quantisation grid.
_RATE_CONTROL_SHARE: Final = 0.6
# First guess of the nominal quality for a target PSNR, relative to it, dB.
_QUALITY_OFFSET_DB: Final = -0.5
# Share of the target size that the search aims at; the size still changes while values converge.
_SIZE_MARGIN: Final = 0.997
# Tolerances of the target: share of a size, and PSNR difference, dB.
_SIZE_TOLERANCE: Final = 0.006
_PSNR_TOLERANCE_DB: Final = 0.05
# Maximum number of corrections of the nominal quality at the end, and the number of cycles of
# encoding and training after each, at the last learning rate.
_MAX_CORRECTIONS: Final = 6
_CYCLES_PER_CORRECTION: Final = 3
# Maximum step of the nominal quality during training, dB.
_MAX_QUALITY_STEP_DB: Final = 4.0
# Damping of size corrections, during training and at the end. Values that have converged to one
# grid take more bytes on any other. Bytes then change twice as fast as by `LOG2_BYTES_PER_DB`, and
# undamped corrections oscillate.
_DAMPING, _FINAL_DAMPING = 0.4, 0.6
# Names of a codebook's payloads in a checkpoint: number, attribute and rows of the codebook, part.
_CODEBOOK_NAME: Final = re.compile(r"codebook\.([0-9]{1,2})\.(\w{1,20})\.([0-9]{1,9})\.[0-9]{1,2}")
# Maximum number of given views for scoring, and the number up to which views near them are added.
# A house of 42 cameras gains 1.1 dB held out by 96 in place of 48, and 6 dB in a view far from all
# cameras; an object, a room and a terrace of 12 cameras lose and gain nothing.
_MAX_SCORED_VIEWS, _LEAST_SCORED_VIEWS = 64, 96

# Preset of the compensation fit and of the order by marginal gain, whatever the others: tuning
# leaves few splats, so that both take seconds of minutes. In eight tuned files, the fit of `best`
# shows up to 2.3 dB more in the first 16 to 64 KiB than the fit of `fast`, and at most 0.1 dB less.
_FIRST_BYTES_PRESET: Final = "best"
# Chunks per sorted run of that order. A captured room tuned to 40 dB shows 25.7 dB in its first
# 64 KiB in place of 21.9 dB by the order of `fast`, at no cost: 182,715 bytes in place of 183,229.
# In runs of three chunks 64 KiB show 1.3 dB less than in runs of two, in 0.7 % more bytes.
_RUN_CHUNKS: Final = 2


class QuantisedTraining:
    """Training of a scene through the quantisers that store it, towards a target.

    The constructor scores and orders the scene once. All later encodes keep this order.

    Parameters
    ----------
    source : Splats
        Ground truth: quality is measured against its renders.
    base : Splats
        Scene at the start of quantised training, which is scored and ordered; `source` itself to
        encode it as without tuning.
    request : TuneRequest
        Views, target and configuration.
    size_of : callable
        Returns the file size of an encoded scene, bytes.
    progress : Progress
        Receives the stages of scoring, ordering and encoding.
    """

    def __init__(
        self,
        source: Splats,
        base: Splats,
        request: TuneRequest,
        size_of: SizeOf,
        progress: Progress,
    ) -> None:
        self.last_measurement = (len(base), 0.0, 0.0, 0)
        self._target = request.target
        config = request.config
        self._rate_weight = config.rate_weight
        self._prefix_weight = config.prefix_weight
        self._size_of = size_of
        self._progress = progress
        best, preset = PRESETS[_FIRST_BYTES_PRESET], PRESETS[config.preset]
        preset = replace(preset, fit_iterations=best.fit_iterations, fit_views=best.fit_views)
        ordering = OrderConfig()
        if base is not source:
            # The source itself is ordered as without tuning.
            preset = replace(preset, gain=best.gain)
            ordering = OrderConfig(run_chunks=_RUN_CHUNKS)
        threads, profile = config.train.threads, config.profile
        settings = preset.score_config(profile, threads=threads)
        views, scores = _score(source, base, request, settings, progress)
        # The source is the ground truth of prefixes, not the trained scene.
        references = render_references(
            source,
            views,
            jittered=preset.reference_jitter,
            pixels=preset.reference_pixels,
            threads=threads,
            progress=progress,
        )
        self._prepared = prepare(
            base,
            scores,
            EncodeConfig(profile=profile, ordering=ordering, threads=threads),
            views=views,
            references=references,
            effort=preset.gain,
            progress=progress,
        )
        preview = None
        if config.preview is not None:
            preview = TrainedPreview(
                PreviewConfig(config.preview, seed=config.train.seed, threads=threads)
            )
        self._finisher = Finisher(
            self._prepared,
            source,
            preset,
            references=references,
            test_views=request.views.test_views or sample_evenly(request.views.cameras, TEST_VIEWS),
            preview=preview,
            size_of=size_of,
            progress=progress,
        )
        self._scored_views = len(views)
        self._test_views = request.views.origin
        # Codebooks of the last encode: k-means of the profile `vq` starts from them next time.
        self._codebooks: Sequence[EncodedCodebook] = ()

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the codebooks of the last encode as checkpoint arrays by name."""
        arrays: dict[str, NDArray[np.generic]] = {}
        for number, book in enumerate(self._codebooks):
            of = f"codebook.{number}.{book.attribute}.{book.rows}"
            for part, payload in enumerate(book.payloads):
                arrays[f"{of}.{part}"] = np.frombuffer(payload, np.uint8)
        return arrays

    def restore_codebooks(self, state: CheckpointArrays) -> None:
        """Restore the codebooks of the last encode from the arrays of a checkpoint.

        Raises
        ------
        FormatError
            ``bad-checkpoint``: the name or the type of an array is that of no codebook.
        """
        parts: dict[tuple[str, ...], list[bytes]] = {}
        for name in sorted(name for name in state if name.startswith("codebook.")):
            match = _CODEBOOK_NAME.fullmatch(name)
            if match is None or state[name].dtype != np.uint8:
                raise FormatError(
                    "bad-checkpoint", f"array {name[:60]!r}, expected bytes of a codebook"
                )
            parts.setdefault(match.groups(), []).append(state[name].tobytes())
        self._codebooks = [
            EncodedCodebook(attribute, int(rows), tuple(payloads))
            for (_, attribute, rows), payloads in parts.items()
        ]

    @staticmethod
    def learning_rate_factor(done: float) -> float:
        """Return the learning-rate factor after a share `done`, 0 to 1, of the training steps."""
        first, last = _LEARNING_RATE_FACTORS
        return float(first * (last / first) ** done)

    def initial_quality(self, splats: Splats) -> float:
        """Return the nominal quality of the first encode, dB, estimated for the target."""
        if self._target.psnr_db is not None:
            return _clamp_quality(self._target.psnr_db + _QUALITY_OFFSET_DB)
        quality = 36.0
        for _ in range(4):
            encoded = self._encode(splats, quality).encoded
            moved = _clamp_quality(quality + self._quality_change_db(encoded))
            if abs(moved - quality) < 0.1:
                break
            quality = moved
        return quality

    def encode_untrained(self, splats: Splats) -> EncodedScene | None:
        """Encode a scene at the target PSNR without training it.

        Parameters
        ----------
        splats : Splats
            The scene that was passed as `base`.

        Returns
        -------
        EncodedScene or None
            None where the quantisers alone cannot reach the target PSNR.
        """
        try:
            hit = search_psnr(
                lambda quality_db: round_trip(self._prepared, splats, quality_db).encoded,
                self._target.psnr_db or 0.0,
                lambda encoded: self._finisher.evaluator.psnr_db(encoded.decoded),
                progress=self._progress,
            )
        except DataError as error:
            # Training may still reach the PSNR.
            if error.code != "target-out-of-reach":
                raise
            return None
        return hit.encoded

    def encode_towards_target(
        self, splats: Splats, quality_db: float, done: float, measure: bool
    ) -> tuple[float, RoundTrip]:
        """Encode the scene, and choose the nominal quality of the next encode.

        The nominal quality changes in the first 60 % of the steps alone.

        Parameters
        ----------
        splats : Splats
            Scene in training.
        quality_db : float
            Nominal quality of this encode, dB.
        done : float
            Share of the quantised training steps already made, 0 to 1.
        measure : bool
            Whether to update `last_measurement`.

        Returns
        -------
        next_db : float
            Nominal quality with which size or PSNR come nearer to the target, dB.
        made : RoundTrip
            Encoded and decoded scene.
        """
        made = self._encode(splats, quality_db)
        if measure:
            self.last_measurement = self.measure(made.encoded)
        if done >= _RATE_CONTROL_SHARE:
            return quality_db, made
        change_db = self._damped_quality_change_db(made.encoded, _DAMPING)
        change_db = min(max(change_db, -_MAX_QUALITY_STEP_DB), _MAX_QUALITY_STEP_DB)
        return _clamp_quality(quality_db + change_db), made

    def train(
        self,
        trainer: Trainer,
        made: RoundTrip,
        quality_db: float,
        steps: int,
        rates: tuple[float, float],
    ) -> None:
        """Train a scene on its decoded values; the loss includes rate and prefix terms.

        Parameters
        ----------
        trainer : Trainer
            Holds the scene in training.
        made : RoundTrip
            Round trip of the trainer's current scene.
        quality_db : float
            Nominal quality of that round trip, dB.
        steps : int
            Training steps.
        rates : tuple of float
            Factors on the learning rates at the first and the last step.
        """
        rate = None
        if self._rate_weight:
            error_per_bit = ERROR_PER_BIT * lagrangian(self._prepared.scores, quality_db)
            rate = rate_gradients(made.encoded, trainer.splats, made.rows)
            rate = rate.times(self._rate_weight * error_per_bit)
        prefix_loss = None
        if self._prefix_weight:
            effective = effective_splats(self._prepared.scores.contribution)
            prefix_loss = PrefixLoss.for_layers(made.rows, effective, self._prefix_weight)
        trainer.run(
            steps, *rates, decoded=made.decoded, extra_gradients=rate, prefix_loss=prefix_loss
        )

    def measure(self, encoded: EncodedScene) -> tuple[int, float, float, int]:
        """Return splat count, mean and worst PSNR of the test views, dB, and file size, bytes."""
        values = self._finisher.evaluator.views_db(encoded.decoded)
        return (
            encoded.splats,
            float(np.mean(values)),
            min(values),
            self._finisher.file_bytes(encoded),
        )

    def reach_target(
        self,
        trainer: Trainer,
        quality_db: float,
        interval: int,
        has_time: Callable[[], bool] = lambda: True,
    ) -> EncodedScene:
        """Alternate corrections of the nominal quality with training; return the best encode.

        Parameters
        ----------
        trainer : Trainer
            Holds the scene in training, which is trained further.
        quality_db : float
            Nominal quality to start from, dB.
        interval : int
            Training steps between two encodes.
        has_time : callable
            Returns whether there is time to train; without it, corrections encode alone.

        Returns
        -------
        EncodedScene
            Encode that meets the target. If none does after six corrections: the nearest one, which
            never exceeds a target size, but may miss a target PSNR.

        Raises
        ------
        DataError
            ``target-out-of-reach``: every encode is larger than the target size.
        """
        best: EncodedScene | None = None
        for trial in range(_MAX_CORRECTIONS + 1):
            encoded = self._encode(trainer.splats, quality_db).encoded
            change_db = self._quality_change_db(encoded)
            fits = self._fits(encoded)
            if fits and (best is None or self._is_better(encoded, best)):
                best = encoded
            if trial == _MAX_CORRECTIONS or (not change_db and fits):
                break
            quality_db = _clamp_quality(
                quality_db + (self._damped_quality_change_db(encoded, _FINAL_DAMPING) or -0.05)
            )
            for _ in range(_CYCLES_PER_CORRECTION):
                if not has_time():
                    break
                made = self._encode(trainer.splats, quality_db)
                last = _LEARNING_RATE_FACTORS[1]
                self.train(trainer, made, quality_db, interval, (last, last))
        if best is None:
            size = self._finisher.file_bytes(encoded)
            raise DataError(
                "target-out-of-reach",
                f"a size of {self._target.size_bytes:,} bytes for {encoded.splats:,} splats: the "
                f"last encode has {size:,} bytes, expected a larger target",
            )
        return best

    def finish(self, encoded: EncodedScene) -> EncodedScene:
        """Add preview chunks, compensation and the estimated PSNR of prefixes to a scene."""
        encoded = self._finisher.finish(encoded)
        report = replace(
            encoded.report,
            views="given",
            test_views=self._test_views,
            scored_views=self._scored_views,
            coverage=float((self._prepared.scores.covered > 0).mean()),
        )
        finished = replace(encoded, report=report)
        size = self._target.size_bytes
        if size is not None and self._size_of(finished) > size:
            # `prefix_mse` reorders segments, the one thing that can have made the file larger. The
            # file without it was measured before and fits.
            finished = replace(finished, prefix_mse=None)
        return finished

    def _encode(self, splats: Splats, quality_db: float) -> RoundTrip:
        """Encode and decode the scene; keep its codebooks for the next encode."""
        made = round_trip(self._prepared, splats, quality_db, self._codebooks)
        self._codebooks = made.encoded.codebooks
        return made

    def _fits(self, encoded: EncodedScene) -> bool:
        """Return whether the file is at most as large as the target size; True for a PSNR."""
        size = self._target.size_bytes
        return size is None or self._finisher.file_bytes(encoded) <= size

    def _quality_change_db(self, encoded: EncodedScene) -> float:
        """Estimate the change of nominal quality that meets the target, dB; 0 if it is met."""
        size = self._target.size_bytes
        if size is not None:
            found = self._finisher.file_bytes(encoded) / size
            low, high = _SIZE_MARGIN - _SIZE_TOLERANCE / 2, 1.0 + _SIZE_TOLERANCE / 2
            if low <= found / _SIZE_MARGIN <= high and found <= 1.0:
                return 0.0
            return float(np.log2(_SIZE_MARGIN / found)) / LOG2_BYTES_PER_DB
        change_db = (self._target.psnr_db or 0.0) - self._finisher.evaluator.psnr_db(
            encoded.decoded
        )
        return 0.0 if abs(change_db) <= _PSNR_TOLERANCE_DB else change_db / PSNR_PER_DB

    def _damped_quality_change_db(self, encoded: EncodedScene, damping: float) -> float:
        """Return the next change of nominal quality, dB; `damping` scales size corrections."""
        change_db = self._quality_change_db(encoded)
        return change_db if self._target.size_bytes is None else damping * change_db

    def _is_better(self, encoded: EncodedScene, best: EncodedScene) -> bool:
        """Return whether `encoded` is a better result than `best`, both within the target size.

        For a target PSNR, the nearer one is better; for a target size, the one of higher PSNR.
        """
        quality, other = (self._finisher.evaluator.psnr_db(x.decoded) for x in (encoded, best))
        if self._target.psnr_db is None:
            return quality > other
        return abs(quality - self._target.psnr_db) < abs(other - self._target.psnr_db)


def _clamp_quality(quality_db: float) -> float:
    """Return a nominal quality, dB, clamped to the valid range."""
    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)


def _score(
    source: Splats,
    base: Splats,
    request: TuneRequest,
    settings: ScoreConfig,
    progress: Progress,
) -> tuple[list[Camera], Scores]:
    """Return the views that the base is scored in, and its scores.

    The source itself is scored as without tuning. A trained scene from few cameras is also scored
    in views drawn near them, so that splats which only these show are not stored coarsely.
    """
    cameras, config = request.views.cameras, request.config
    if base is source and not request.views.planned:
        untuned = EncodeRequest(
            cameras=cameras,
            test_views=request.views.test_views,
            config=EncodeConfig(profile=config.profile, threads=config.train.threads),
            preset=config.preset,
            score_config=settings,
        )
        scored = score_scene(source, untuned, progress)
        assert scored.scores is not None
        return list(scored.views), scored.scores
    views = sample_evenly(cameras, _MAX_SCORED_VIEWS)
    if base is not source and len(views) < _LEAST_SCORED_VIEWS:
        drawer, rng = ViewDrawer(source, views), np.random.default_rng(config.train.seed)
        for number in range(len(views), _LEAST_SCORED_VIEWS):
            views.append(drawer.draw(rng, off_path=bool(number % 2)))
    covering = request.views.covering
    return views, score(base, views, settings, covering=covering, progress=progress)
