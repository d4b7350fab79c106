"""Tuning: prune a scene and train it through the quantisers, for a target size or PSNR."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.config import MAX_QUALITY_DB
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.finishing import SizeOf
from cogsplat.codec.errors import FormatError
from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import one_blas_thread, ordered_map, thread_count
from cogsplat.codec.views.view_sets import sample_evenly

from .checkpoint_arrays import CheckpointArrays, checkpoint_array, checkpoint_splats
from .deletion_errors import deletion_errors
from .differentiable_rendering import Gradients, with_values
from .quantised_training import QuantisedTraining
from .splat_budget import corrected_count, count_for_size, next_count, next_count_for_psnr
from .splat_merging import merge_candidates, merge_pairs
from .time_budget import TimeBudget
from .trainer import Trainer
from .training_views import make_training_views
from .tune_config import TuneRequest

# Factors on the learning rates of rounds and of the recovery after them: first step, last step. On
# a captured room, 400 steps of recovery with 1 and 0.1, 2 and 0.2, 3 and 0.3 show held-out views at
# 37.5, 37.8 and 37.7 dB.
_ROUND_RATES: Final = (2.0, 0.6)
_RECOVERY_RATES: Final = (2.0, 0.2)
# Upper limit of opacity logits: an opacity of 0.9997. Alphas capped at 0.99 (3DGS) do not change,
# and gradients reach the logit.
_MAX_LOGIT: Final = 8.0
# Assumed share of splats kept where the target does not fix their number; sizes the time budget.
_ASSUMED_SHARE: Final = 0.25
# Cost of a step through the quantisers, relative to other steps: it includes encoding.
_QUANTISED_STEP_COST: Final = 1.6
# Share of the recovery steps after which a target PSNR decides whether the number of splats is
# right, and the maximum number of such recoveries.
_TRIAL_RECOVERY_SHARE: Final = 0.5
_MAX_RECOVERIES: Final = 3
# Number of these recoveries that a time limit is planned for.
_EXPECTED_RECOVERIES: Final = 2
# Number of earlier rounds that can be restored.
_MAX_EARLIER_ROUNDS: Final = 2
# Time reserved for the end of the encode, in durations of the setup of quantised training, and for
# the last corrections, in cycles of encoding and training. The end takes a third to a half of a
# setup of a captured room.
_RESERVED_SETUPS: Final = 1.0
_CORRECTION_CYCLES: Final = 8
# Views in which the first deletion errors are measured; later ones accumulate in training. With a
# time limit, every 16th is timed, and the others take this share of the limit at most.
_DELETION_VIEWS: Final = 128
_TIMED_DELETIONS: Final = 16
_DELETION_TIME_SHARE: Final = 0.04
# First cycles, which are not timed: they compile kernels.
_UNTIMED_CYCLES: Final = 1
# Steps that are not timed, because they compile kernels, and steps that are timed before the first
# plan that has to meet a deadline.
_WARM_STEPS, _TIMED_STEPS = 2, 8
# Cycles between two checkpoints.
_CHECKPOINT_CYCLES: Final = 5


@dataclass(frozen=True)
class Milestone:
    """Progress report of a tuning run.

    Parameters
    ----------
    stage : str
        ``trained`` after a round, ``stored`` after an encode, ``untuned`` if the untrained source
        is the result, because its encode is smaller.
    splats : int
        Current number of splats.
    psnr_db, worst_db : float
        Mean and lowest PSNR of the test views, dB. In stage ``trained``, pictures are downscaled as
        in training.
    size_bytes : int
        Size of the whole file; 0 in stage ``trained``.
    """

    stage: str
    splats: int
    psnr_db: float
    worst_db: float
    size_bytes: int = 0


@dataclass(frozen=True, eq=False)
class TuneResult:
    """A tuned scene, encoded and as trained splats.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene; its report has the PSNR against the source.
    splats : Splats
        Trained splats before quantised training; the source if its untuned encode is returned.
    """

    encoded: EncodedScene
    splats: Splats


@one_blas_thread()
def tune(
    source: Splats,
    request: TuneRequest,
    *,
    size_of: SizeOf,
    resume: CheckpointArrays | None = None,
    checkpoint: Callable[[CheckpointArrays], None] | None = None,
    notify: Callable[[Milestone], None] | None = None,
    progress: Progress = silent,
) -> TuneResult:
    """Prune and train a scene, and encode it at a target size or PSNR.

    Pruning runs in rounds: delete the splats with the smallest deletion errors, then train the
    rest. The remaining splats are then trained through the encoder's quantisers, with
    straight-through gradients.

    For a target PSNR, the source is also encoded without training. This encode is the result if no
    splat can be deleted or if it is smaller, as for small scenes and for targets that need nearly
    all splats.

    Parameters
    ----------
    source : Splats
        Scene to tune; its rows must be valid (`Splats.require_valid`). Without capture viewpoints
        of its own, it gets those of the views.
    request : TuneRequest
        Views, target and configuration.
    size_of : callable
        Returns the file size of an encoded scene, bytes.
    resume : mapping of str to array, optional
        Last argument of `checkpoint` in a run with the same arguments. With `TuneConfig.seconds`,
        the number of steps is the one planned in that run, whatever time they take: all runs
        resumed from one checkpoint have the same result.
    checkpoint : callable, optional
        Called with a checkpoint after every round, and at intervals in quantised training.
    notify : callable, optional
        Called with a progress report at the same times.
    progress : Progress
        Receives ``training views``, ``search``, ``deletions``, ``train``, ``score``,
        ``train quantised``, ``preview`` and the stages of the encoder.

    Returns
    -------
    TuneResult
        Result; it does not depend on the number of threads, unless `TuneConfig.seconds` is given.

    Raises
    ------
    DataError
        ``invalid-rows``: the source has invalid rows. ``target-out-of-reach``: the file cannot be
        as small as the target.
    """
    source.require_valid()
    source = source.with_capture(request.views.capture)
    config = request.config
    run = _TuningRun(source, request, checkpoint, notify, progress)
    make_quantised = partial(
        QuantisedTraining, source, request=request, size_of=size_of, progress=progress
    )
    # A given share of splats is kept even where the untuned source is smaller.
    compare_untuned = request.target.psnr_db is not None and config.keep is None
    begin = run.time_budget.now()
    of_source = make_quantised(source) if compare_untuned else None
    source_seconds = run.time_budget.now() - begin
    untuned = None if of_source is None else of_source.encode_untrained(source)
    if resume is not None:
        run.restore(resume)
    if run.base is None:
        run.prune(source_seconds)
        run.base = run.trainer.copy()
    if of_source is not None and untuned is not None and run.needs_all:
        return _untuned_result(source, of_source, untuned, notify)
    begin = run.time_budget.now()
    quantised = make_quantised(run.base)
    if resume is not None:
        quantised.restore_codebooks(resume)
    encoded = run.train_quantised(quantised, run.time_budget.now() - begin)
    if (
        of_source is not None
        and untuned is not None
        and of_source.measure(untuned)[-1] < quantised.measure(encoded)[-1]
    ):
        return _untuned_result(source, of_source, untuned, notify)
    return TuneResult(quantised.finish(encoded), run.base)


def _untuned_result(
    source: Splats,
    of_source: QuantisedTraining,
    untuned: EncodedScene,
    notify: Callable[[Milestone], None] | None,
) -> TuneResult:
    """Return the encode of the untrained source as the result."""
    if notify is not None:
        notify(Milestone("untuned", *of_source.measure(untuned)))
    return TuneResult(of_source.finish(untuned), source)


class _TuningRun:
    """State of one tuning run: the scene in training, earlier rounds, and the time budget."""

    def __init__(
        self,
        source: Splats,
        request: TuneRequest,
        checkpoint: Callable[[CheckpointArrays], None] | None,
        notify: Callable[[Milestone], None] | None,
        progress: Progress,
    ) -> None:
        self.base: Splats | None = None
        config, views = request.config, request.views
        self._has_photos = request.photos is not None
        self._target = request.target
        self._config = config
        self._checkpoint = checkpoint
        self._notify = notify
        self._progress = progress
        self._source_count = len(source)
        self.time_budget = TimeBudget(config.seconds)
        # Time to leave for the setup of quantised training and the end of the encode, seconds.
        self._reserved_seconds = 0.0
        # Time between two trainings: deletion errors, merging and measurements, seconds.
        self._round_seconds = 0.0
        self._trained_at = 0.0
        make_views = partial(
            make_training_views,
            source,
            background=request.background,
            threads=config.train.threads,
            device=request.device,
            progress=progress,
        )
        self._views = make_views(views.cameras, photos=request.photos, covering=views.covering)
        self._measured = self._views
        if views.test_views:
            self._measured = make_views(views.test_views, draw=False)
        # Checkpoint arrays from before the last rounds.
        self._earlier_rounds: list[dict[str, NDArray[np.generic]]] = []
        # Recoveries made, and the number of splats that a correction prunes down to; 0 without one.
        self._recoveries = 0
        self._corrected_to = 0
        # Quantised training steps made, steps planned, and nominal quality, dB.
        self._quantised = (0, 0, 0.0)
        clipped = np.minimum(source.opacities, np.float32(_MAX_LOGIT))
        self.trainer = Trainer(replace(source, opacities=clipped), self._views, config.train)

    @property
    def _count(self) -> int:
        """Current number of splats."""
        return len(self.trainer.splats)

    @property
    def _share(self) -> float:
        """Current number of splats, relative to the source."""
        return self._count / max(self._source_count, 1)

    @property
    def _recovery_steps(self) -> int:
        """Steps of one recovery; fewer where a target PSNR decides on the number of splats."""
        share = _TRIAL_RECOVERY_SHARE if self._final_count() is None else 1.0
        return math.ceil(share * self._config.recovery_steps)

    def prune(self, setup_seconds: float) -> None:
        """Prune and train in rounds until the target allows no further round.

        Parameters
        ----------
        setup_seconds : float
            Expected duration of the setup of quantised training; 0 if none was timed.
        """
        self._reserved_seconds = (1.0 + _RESERVED_SETUPS) * setup_seconds
        self._trained_at = self.time_budget.now()
        if not self._recoveries:
            while (count := self._next_count()) is not None:
                self._run_round(count)
            self._recover()
        while self._corrected_to or self._correct_count():
            keep = self._config.round_keep
            while (count := next_count(self._count, self._corrected_to, keep)) is not None:
                self._run_round(count)
            self._corrected_to = 0
            if self.needs_all:
                return
            self._recover()

    @property
    def needs_all(self) -> bool:
        """Whether no splat was deleted, and the source itself is the ground truth.

        Training has nothing to gain then, and training through the quantisers loses: a terrace that
        needs all of its splats at 38.5 dB had 38.1 dB afterwards, in 2.46 MB instead of 0.32 MB.
        """
        return not self._has_photos and self._count == self._source_count

    def _run_round(self, count: int) -> None:
        """Merge similar splats, prune down to `count` splats, and train."""
        if self._target.psnr_db is not None and self._config.keep is None:
            state = {name: values.copy() for name, values in self.trainer.state().items()}
            self._earlier_rounds = [*self._earlier_rounds[1 - _MAX_EARLIER_ROUNDS :], state]
        errors = self.trainer.deletion_errors()
        if errors is None:
            errors = self._measure_deletion_errors()
        splats = self.trainer.splats
        merge_targets, merged = merge_candidates(splats, errors, len(splats) - count)
        # Keep merge targets, delete the splats merged into them.
        errors = errors.copy()
        errors[merge_targets], errors[merged] = np.inf, -np.inf
        kept = np.argsort(-errors, kind="stable")[:count]
        self.trainer.keep(np.sort(kept), merge_pairs(splats, merge_targets, merged))
        self._train(self._config.round_steps, _ROUND_RATES, recovery=False)
        self._report_round()

    def _measure_deletion_errors(self) -> NDArray[np.float64]:
        """Return the deletion errors in training views; a time limit may allow fewer views."""
        measure = partial(
            deletion_errors,
            self.trainer.splats,
            threads=self._config.train.threads,
            progress=self._progress,
        )
        views = self._views.sample(_DELETION_VIEWS, self._config.train.seed)
        if not self.time_budget.has_deadline:
            return measure(views)
        timed, begin = views[::_TIMED_DELETIONS], self.time_budget.now()
        errors = measure(timed)
        seconds = (self.time_budget.now() - begin) / len(timed)
        rest = [view for number, view in enumerate(views) if number % _TIMED_DELETIONS]
        count = self.time_budget.count_within(_DELETION_TIME_SHARE, seconds, len(rest))
        return errors + measure(sample_evenly(rest, count))

    def _recover(self) -> None:
        """Train for the recovery steps, with falling learning rates."""
        self._train(self._recovery_steps, _RECOVERY_RATES, recovery=True)
        self._recoveries += 1
        self._report_round()

    def _correct_count(self) -> bool:
        """Choose another number of splats if the PSNR after training misses the target range.

        If more splats are needed, the checkpoint of an earlier round is restored. If fewer suffice,
        the caller prunes in further rounds.

        Returns
        -------
        bool
            Whether another number was chosen.
        """
        count = self._better_count()
        if count is None:
            return False
        self._corrected_to = count
        if count < self._count:
            return True
        counts = [len(state["splats.opacities"]) for state in self._earlier_rounds]
        # The last round with enough splats, or the round with most.
        enough = [number for number, kept in enumerate(counts) if kept >= count]
        number = enough[-1] if enough else int(np.argmax(counts))
        self.trainer.restore(self._earlier_rounds[number])
        # This was the last correction: alternating between too few and too many would not end.
        self._recoveries = _MAX_RECOVERIES - 1
        return True

    def _next_count(self) -> int | None:
        """Return the number of splats after the next round; None after the last round."""
        keep, final = self._config.round_keep, self._final_count()
        if final is not None:
            return next_count(self._count, final, keep)
        target_db = self._target.psnr_db or 0.0
        return next_count_for_psnr(self._count, self._measure_psnr()[0], target_db, keep)

    def _better_count(self) -> int | None:
        """Return a better number of splats for a target PSNR; None to keep the current one."""
        if self._final_count() is not None or self._recoveries >= _MAX_RECOVERIES:
            return None
        counts = [len(state["splats.opacities"]) for state in self._earlier_rounds]
        target_db = self._target.psnr_db or 0.0
        return corrected_count(
            self._count, self._measure_psnr()[0], target_db, max([self._count, *counts])
        )

    def _final_count(self) -> int | None:
        """Return the number of splats to prune down to; None if a target PSNR decides."""
        if self._config.keep is not None:
            return max(1, round(self._config.keep * self._source_count))
        if self._target.size_bytes is None:
            return None
        degree = self.trainer.splats.sh_degree
        return count_for_size(self._target.size_bytes, degree, self._source_count)

    def _train(self, planned: int, rates: tuple[float, float], *, recovery: bool) -> None:
        """Train for a number of steps scaled by the time budget.

        Parameters
        ----------
        planned : int
            Steps without a deadline.
        rates : tuple of float
            Factors on the learning rates at the first and the last step.
        recovery : bool
            Whether this is a recovery, which the time budget may extend, or a round.
        """
        budget = self.time_budget
        self._round_seconds = budget.now() - self._trained_at
        done = 0
        if budget.needs_measurement and planned > _WARM_STEPS + _TIMED_STEPS:
            self.trainer.run(_WARM_STEPS, rates[0], rates[0])
            timed = partial(self.trainer.run, _TIMED_STEPS, rates[0], rates[0])
            budget.run_timed(timed, TimeBudget.work(_TIMED_STEPS, self._share))
            done = _WARM_STEPS + _TIMED_STEPS
        self._update_time_budget(recovery=recovery)
        steps = max(1, budget.scaled_steps(planned, extend=recovery) - done)
        run = partial(self.trainer.run, steps, *rates, progress=self._progress)
        budget.run_timed(run, TimeBudget.work(steps, self._share))
        self._trained_at = budget.now()

    def _update_time_budget(self, *, recovery: bool) -> None:
        """Set the factor on planned steps so that the remaining training meets the deadline.

        Parameters
        ----------
        recovery : bool
            Whether a recovery starts now, or a round.
        """
        config, share = self._config, self._share
        final = self._final_count()
        rounds, reserved = 0.0, self._reserved_seconds
        if not recovery and not self._recoveries:
            final_share = _ASSUMED_SHARE if final is None else final / max(self._source_count, 1)
            while share > final_share:
                rounds += TimeBudget.work(config.round_steps, share)
                # The last deletion was from the splats that this round began with.
                reserved += self._round_seconds * config.round_keep * share / self._share
                share *= config.round_keep
            share = min(final_share, share)
        expected = 1 if final is not None else max(1, _EXPECTED_RECOVERIES - self._recoveries)
        # The last corrections train too.
        quantised = config.quantised_steps + _CORRECTION_CYCLES * config.encode_interval
        steps = expected * self._recovery_steps + _QUANTISED_STEP_COST * quantised
        self.time_budget.fit_to_deadline(rounds, TimeBudget.work(steps, share), reserved)

    def _measure_psnr(self) -> tuple[float, float]:
        """Return the mean and the lowest PSNR of the test views, dB."""
        views = self._measured

        def measure(view: int) -> float:
            picture = render(self.trainer.splats, views.cameras[view], views.configs[view])
            return float(psnr(views.pictures[view], picture))

        threads = thread_count(self._config.train.threads)
        values = list(ordered_map(measure, range(views.num_given), threads))
        return float(np.mean(values)), min(values)

    def _report_round(self) -> None:
        """Pass the current PSNR and a checkpoint to the caller, after a round or recovery."""
        if self._notify is not None:
            self._notify(Milestone("trained", self._count, *self._measure_psnr()))
        if self._checkpoint is not None:
            self._checkpoint(self.state())

    def train_quantised(self, quantised: QuantisedTraining, setup_seconds: float) -> EncodedScene:
        """Train the scene through the quantisers; return the encode that meets the target best.

        Parameters
        ----------
        quantised : QuantisedTraining
            Encoder of the scene.
        setup_seconds : float
            Duration of the construction of `quantised`; sizes the reserved time.
        """
        interval = self._config.encode_interval
        done, planned, quality_db = self._quantised
        is_new = not planned
        if is_new:
            cycles = -(-self._config.quantised_steps // interval)
            planned = self.time_budget.scaled_steps(cycles, extend=True) * interval
            quality_db = quantised.initial_quality(self.trainer.splats)
        usual, begin = planned // interval, self.time_budget.now()
        while done < planned:
            quality_db = self._run_cycle(quantised, done, planned, quality_db)
            done += interval
            cycles = done // interval
            if is_new and cycles == _UNTIMED_CYCLES:
                begin = self.time_budget.now()
            elif is_new:
                # Planned anew after each cycle: early ones differ from later ones, and other
                # programs may start or end.
                planned = interval * self.time_budget.affordable_count(
                    usual,
                    (self.time_budget.now() - begin) / (cycles - _UNTIMED_CYCLES),
                    _RESERVED_SETUPS * setup_seconds,
                    extra=_CORRECTION_CYCLES,
                    done=cycles,
                )
            self._progress("train quantised", done, planned)
            if cycles % _CHECKPOINT_CYCLES == 0:
                self._quantised = done, planned, quality_db
                self._report_encode(quantised)
        has_time = partial(self.time_budget.has_time, _RESERVED_SETUPS * setup_seconds)
        encoded = quantised.reach_target(self.trainer, quality_db, interval, has_time)
        if self._notify is not None:
            self._notify(Milestone("stored", *quantised.measure(encoded)))
        return encoded

    def _run_cycle(
        self, quantised: QuantisedTraining, done: int, planned: int, quality_db: float
    ) -> float:
        """Encode the scene once and train on its decoded values; return the next nominal quality.

        Parameters
        ----------
        quantised : QuantisedTraining
            Encoder of the scene.
        done, planned : int
            Quantised training steps made and planned.
        quality_db : float
            Nominal quality of the encode, dB.
        """
        interval = self._config.encode_interval
        measure = (done // interval + 1) % _CHECKPOINT_CYCLES == 0
        next_db, made = quantised.encode_towards_target(
            self.trainer.splats, quality_db, done / planned, measure
        )
        first = quantised.learning_rate_factor(done / planned)
        last = quantised.learning_rate_factor((done + interval) / planned)
        quantised.train(self.trainer, made, quality_db, interval, (first, last))
        return next_db

    def _report_encode(self, quantised: QuantisedTraining) -> None:
        """Pass the last measurement and a checkpoint to the caller, during quantised training."""
        if self._notify is not None:
            self._notify(Milestone("stored", *quantised.last_measurement))
        if self._checkpoint is not None:
            self._checkpoint(self.state() | quantised.state())

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the checkpoint arrays of the run by name."""
        arrays = dict(self.trainer.state())
        arrays["stored"] = np.array(self._quantised)
        arrays["recoveries"] = np.array((self._recoveries, self._corrected_to))
        arrays["factor"] = np.array(self.time_budget.factor)
        for number, kept in enumerate(self._earlier_rounds):
            arrays |= {f"kept{number}.{name}": values for name, values in kept.items()}
        if self.base is not None:
            for name in Gradients.names():
                arrays[f"base.{name}"] = getattr(self.base, name)
        return arrays

    def restore(self, state: CheckpointArrays) -> None:
        """Restore the run from the checkpoint of an earlier run with the same arguments.

        Raises
        ------
        FormatError
            ``bad-checkpoint``: an array is missing, or has another shape or type.
        """
        self._earlier_rounds = []
        for number in range(_MAX_EARLIER_ROUNDS):
            prefix = f"kept{number}."
            kept = {
                name.removeprefix(prefix): np.array(values)
                for name, values in state.items()
                if name.startswith(prefix)
            }
            if kept:
                # Checked now: the round may be needed after an hour of training.
                self.trainer.restore(kept)
                self._earlier_rounds.append(kept)
        self.trainer.restore(state)
        done, planned, quality_db = checkpoint_array(state, "stored", (3,)).tolist()
        recoveries, corrected_to = checkpoint_array(state, "recoveries", (2,), "i").tolist()
        factor = float(checkpoint_array(state, "factor", ()))
        within = (
            0 <= done <= planned < np.inf
            and 0.0 <= quality_db <= MAX_QUALITY_DB
            and 0 <= recoveries <= _MAX_RECOVERIES
            and 0 <= corrected_to <= self._source_count
            and 0 < factor < np.inf
            and 0 < self._count <= self._source_count
        )
        if not within:
            raise FormatError(
                "bad-checkpoint",
                f"{self._count} splats, steps {done:g} of {planned:g} at {quality_db:g} dB, "
                f"{recoveries} recoveries to {corrected_to} splats, factor {factor:g}, expected "
                "those of a run",
            )
        self._quantised = int(done), int(planned), quality_db
        self._recoveries, self._corrected_to = recoveries, corrected_to
        self.time_budget.fix_factor(factor)
        if "base.opacities" in state:
            arrays = checkpoint_splats(state, "base.", self.trainer.splats)
            self.base = with_values(self.trainer.splats, arrays)
        elif planned:
            raise FormatError("bad-checkpoint", "no array 'base.means', expected that of a run")
