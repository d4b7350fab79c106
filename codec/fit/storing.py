"""Storing: the encoder while a scene is trained through its quantisers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.compensation_fit import blank, compensated
from cogsplat.codec.encode.config import MAX_QUALITY_DB, MIN_QUALITY_DB, EncodeConfig
from cogsplat.codec.encode.encoded import EncodedCodebook, EncodedScene
from cogsplat.codec.encode.pipeline import SizeOf
from cogsplat.codec.encode.prefix_quality import PrefixEvaluator, predicted
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.preview_chunks import PreviewMaker
from cogsplat.codec.encode.rate_control import Target, to_psnr
from cogsplat.codec.errors import DataError
from cogsplat.codec.order.prefix_inflation import effective_splats
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate.allocation import lagrangian
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.reference_views import render_references
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import evenly

from .bit_slopes import PRICE_OF_A_BIT, bit_slopes
from .prefixes import Prefixes
from .stored import Stored, stored
from .trainer import Trainer
from .tune_config import TuneConfig

# Factors on the learning rates while the scene trains through its quantisers: first, last.
_RATES: Final = (0.4, 0.04)
# The nominal quality follows the target for so long; then the steps of the quantisers stay, and
# values settle on what they are rounded to.
_AIMING: Final = 0.6
# Slopes of PSNR and of log2 bytes by the nominal quality (`rate_control`), dB and 1 per dB.
_PSNR_PER_DB: Final = 0.8
_LOG2_BYTES_PER_DB: Final = 0.085
# Before anything is measured: what the nominal quality is above the PSNR, dB.
_FIRST_ABOVE_DB: Final = -0.5
# A size is aimed at from a little below, as a share: it changes while values settle.
_BELOW: Final = 0.997
# Sizes this near, as a share, and a PSNR this near, dB, are met.
_NEAR_SIZE: Final = 0.006
_NEAR_DB: Final = 0.05
# Most corrections of the nominal quality in the end; each trains a little more, at the last rate.
_CORRECTIONS: Final = 6
_CORRECTION_REFRESHES: Final = 3
# Longest step of the nominal quality while it follows the target, dB, and how much of what misses a
# size is made up for by each step on the way and in the end: values that have settled on one grid
# take more bytes on any other, so that bytes change twice as fast as by the slope above, and whole
# steps swing.
_LONGEST_DB: Final = 4.0
_FOLLOWED, _SETTLED = 0.4, 0.6
# Views to score in.
_MOST_SCORED: Final = 64


class Storing:
    """The order and the quantisers of a scene that is still being trained.

    Parameters
    ----------
    source : Splats
        What the result is measured against.
    base : Splats
        The scene as it is now: scored and ordered once.
    cameras : sequence of Camera
        To score in.
    covering : sequence of Camera
        Views of what those leave out (`contribution.score`).
    target : Target
    config : TuneConfig
    test_views : sequence of Camera
        To measure in; some of `cameras` where there are none.
    size_of : callable
        Bytes of the whole file that an encoded scene makes.
    preview : PreviewMaker or None
    progress : Progress
    """

    def __init__(
        self,
        source: Splats,
        base: Splats,
        cameras: Sequence[Camera],
        covering: Sequence[Camera],
        target: Target,
        config: TuneConfig,
        test_views: Sequence[Camera],
        size_of: SizeOf,
        preview: PreviewMaker | None,
        progress: Progress,
    ) -> None:
        self.last_figures = (len(base), 0.0, 0.0, 0)
        self._target = target
        self._rate_weight = config.rate_weight
        self._prefix_weight = config.prefix_weight
        self._size_of = size_of
        self._preview = preview
        self._preset = PRESETS[config.preset]
        self._progress = progress
        threads, profile = config.train.threads, config.profile
        self._fit = self._preset.fit_config(threads)
        views = evenly(cameras, _MOST_SCORED)
        settings = self._preset.score_config(profile, threads=threads)
        scores = score(base, views, settings, covering=covering, progress=progress)
        # Prefixes are compared with the source, which they are to look like.
        self._references = render_references(
            source,
            views,
            jittered=self._preset.reference_jitter,
            pixels=self._preset.reference_pixels,
            threads=threads,
            progress=progress,
        )
        self._prepared = prepare(
            base,
            scores,
            EncodeConfig(profile=profile, threads=threads),
            views=views,
            references=self._references,
            effort=self._preset.gain,
            progress=progress,
        )
        self._evaluator = PrefixEvaluator(
            source, evenly(test_views or cameras, self._preset.test_views), threads
        )
        self._scored_views = len(views)
        # Of the last encode; those of the profile `vq` go on from them in the next one.
        self._codebooks: Sequence[EncodedCodebook] = ()

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that `restore` needs, as arrays by name."""
        arrays: dict[str, NDArray[np.generic]] = {}
        for number, book in enumerate(self._codebooks):
            of = f"codebook.{number}.{book.attribute}.{book.rows}"
            for part, payload in enumerate(book.payloads):
                arrays[f"{of}.{part}"] = np.frombuffer(payload, np.uint8)
        return arrays

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Go on from what `state` returned; arrays of other names are passed over."""
        parts: dict[tuple[str, ...], list[bytes]] = {}
        for name in sorted(name for name in state if name.startswith("codebook.")):
            _, *of, _ = name.split(".")
            parts.setdefault(tuple(of), []).append(state[name].tobytes())
        self._codebooks = [
            EncodedCodebook(attribute, int(rows), tuple(payloads))
            for (_, attribute, rows), payloads in parts.items()
        ]

    @staticmethod
    def rate(done: float) -> float:
        """Return the factor on the learning rates when a share of the steps is made."""
        return float(_RATES[0] * (_RATES[1] / _RATES[0]) ** done)

    def first_quality(self, splats: Splats) -> float:
        """Return a nominal quality to begin with."""
        if self._target.psnr_db is not None:
            return _within(self._target.psnr_db + _FIRST_ABOVE_DB)
        quality = 36.0
        for _ in range(4):
            encoded = self._store(splats, quality).encoded
            moved = _within(quality + self._missed_db(encoded))
            if abs(moved - quality) < 0.1:
                break
            quality = moved
        return quality

    def untrained(self, splats: Splats) -> EncodedScene | None:
        """Return the scene at the PSNR aimed at, not trained; None where it cannot have that.

        Parameters
        ----------
        splats : Splats
            Those that this was made of.
        """
        try:
            hit = to_psnr(
                lambda quality_db: stored(self._prepared, splats, quality_db).encoded,
                self._target.psnr_db or 0.0,
                lambda encoded: self._evaluator.psnr_db(encoded.decoded),
                progress=self._progress,
            )
        except DataError as error:
            # Training may bring a PSNR into reach that the quantisers alone do not give.
            if error.code != "target-out-of-reach":
                raise
            return None
        return hit.encoded

    def aimed(
        self, splats: Splats, quality_db: float, done: float, measure: bool
    ) -> tuple[float, Stored]:
        """Store the scene; return the next nominal quality, which follows the target, and it.

        Parameters
        ----------
        splats : Splats
            As it is trained.
        quality_db : float
            Nominal quality of the last time.
        done : float
            Share of the steps through quantisers that are made.
        measure : bool
            Whether `last_figures` are to be those of this time.
        """
        made = self._store(splats, quality_db)
        if measure:
            self.last_figures = self.figures(made.encoded)
        if done < _AIMING:
            missed = self._step_db(made.encoded, _FOLLOWED)
            quality_db = _within(quality_db + min(max(missed, -_LONGEST_DB), _LONGEST_DB))
            if missed:
                made = self._store(splats, quality_db)
        return quality_db, made

    def train(
        self,
        trainer: Trainer,
        made: Stored,
        quality_db: float,
        steps: int,
        rates: tuple[float, float],
    ) -> None:
        """Train a scene as it is decoded, and against what its values take in bytes.

        Parameters
        ----------
        trainer : Trainer
        made : Stored
            Of the trainer's scene as it is now.
        quality_db : float
            Nominal quality that it was stored at.
        steps : int
        rates : tuple of float
            Factors on the learning rates of the first and of the last step.
        """
        slopes = None
        if self._rate_weight:
            price = PRICE_OF_A_BIT * lagrangian(self._prepared.scores, quality_db)
            slopes = bit_slopes(made.encoded, trainer.splats, made.rows)
            slopes = slopes.times(self._rate_weight * price)
        prefixes = None
        if self._prefix_weight:
            carriers = effective_splats(self._prepared.scores.contribution)
            prefixes = Prefixes.of_chunks(made.rows, carriers, self._prefix_weight)
        trainer.run(steps, *rates, drawn_as=made.decoded, slopes=slopes, prefixes=prefixes)

    def figures(self, encoded: EncodedScene) -> tuple[int, float, float, int]:
        """Return splats, mean and least PSNR in the test views, dB, and bytes of the file."""
        values = self._evaluator.views_db(encoded.decoded)
        return encoded.splats, float(np.mean(values)), min(values), self._bytes(encoded)

    def settled(self, trainer: Trainer, quality_db: float, refresh: int) -> EncodedScene:
        """Correct the nominal quality until the target is met, and train on each time.

        Raises
        ------
        DataError
            ``target-out-of-reach``: a size that it stays above.
        """
        best: EncodedScene | None = None
        for trial in range(_CORRECTIONS + 1):
            encoded = self._store(trainer.splats, quality_db).encoded
            missed = self._missed_db(encoded)
            fits = self._fits(encoded)
            if fits and (best is None or self._is_better(encoded, best)):
                best = encoded
            if trial == _CORRECTIONS or (not missed and fits):
                break
            quality_db = _within(quality_db + (self._step_db(encoded, _SETTLED) or -0.05))
            for _ in range(_CORRECTION_REFRESHES):
                made = self._store(trainer.splats, quality_db)
                self.train(trainer, made, quality_db, refresh, (_RATES[1], _RATES[1]))
        if best is None:
            raise DataError(
                "target-out-of-reach",
                f"a size of {self._target.size_bytes:,} bytes for {encoded.splats:,} splats: the "
                f"nearest it comes is {self._bytes(encoded):,} bytes, expected a target in reach",
            )
        return best

    def finished(self, encoded: EncodedScene) -> EncodedScene:
        """Return the scene with its preview, compensation and predicted quality."""
        contribution = self._prepared.scores.contribution
        if self._preview is not None:
            encoded = self._preview.add(
                encoded, self._references, effective_splats(contribution), progress=self._progress
            )
        encoded = compensated(
            encoded,
            self._references,
            contribution,
            self._fit,
            progress=self._progress,
        )
        encoded = predicted(
            encoded,
            self._evaluator,
            most_views=self._preset.prediction_views,
            progress=self._progress,
        )
        report = replace(
            encoded.report,
            views="given",
            test_views="given",
            scored_views=self._scored_views,
            coverage=float((self._prepared.scores.covered > 0).mean()),
        )
        finished = replace(encoded, report=report)
        size = self._target.size_bytes
        if size is not None and self._size_of(finished) > size:
            # Only the order of segments can have made it larger; this one was measured before.
            finished = replace(finished, prefix_mse=None)
        return finished

    def _store(self, splats: Splats, quality_db: float) -> Stored:
        """Return what the scene becomes when it is stored."""
        made = stored(self._prepared, splats, quality_db, self._codebooks)
        self._codebooks = made.encoded.codebooks
        return made

    def _bytes(self, encoded: EncodedScene) -> int:
        """Return the bytes of the file that the finished scene will make."""
        if self._preview is not None:
            encoded = self._preview.reserve(encoded)
        counts = [chunk.splats for chunk in encoded.chunks]
        carriers = effective_splats(self._prepared.scores.contribution)
        encoded = replace(encoded, compensation=blank(counts, carriers, self._fit))
        chunks = [replace(chunk, quality_db=1.0) for chunk in encoded.chunks]
        return self._size_of(replace(encoded, chunks=chunks))

    def _fits(self, encoded: EncodedScene) -> bool:
        size = self._target.size_bytes
        return size is None or self._bytes(encoded) <= size

    def _missed_db(self, encoded: EncodedScene) -> float:
        """Return what to add to the nominal quality; 0 where the target is met."""
        size = self._target.size_bytes
        if size is not None:
            found = self._bytes(encoded) / size
            if _BELOW - _NEAR_SIZE / 2 <= found / _BELOW <= 1.0 + _NEAR_SIZE / 2 and found <= 1.0:
                return 0.0
            return float(np.log2(_BELOW / found)) / _LOG2_BYTES_PER_DB
        missed = (self._target.psnr_db or 0.0) - self._evaluator.psnr_db(encoded.decoded)
        return 0.0 if abs(missed) <= _NEAR_DB else missed / _PSNR_PER_DB

    def _step_db(self, encoded: EncodedScene, share: float) -> float:
        """Return what to add to the nominal quality of a scene that is being trained."""
        missed = self._missed_db(encoded)
        return missed if self._target.size_bytes is None else share * missed

    def _is_better(self, encoded: EncodedScene, best: EncodedScene) -> bool:
        """Tell whether a scene that fits comes nearer to the target than another."""
        quality, other = (self._evaluator.psnr_db(x.decoded) for x in (encoded, best))
        if self._target.psnr_db is None:
            return quality > other
        return abs(quality - self._target.psnr_db) < abs(other - self._target.psnr_db)


def _within(quality_db: float) -> float:
    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)
