"""Tuning: fewer splats that show the same, trained through the quantisers that store them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.pipeline import SizeOf
from cogsplat.codec.encode.preview_chunks import PreviewMaker
from cogsplat.codec.encode.rate_control import Target
from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .deletion import deletion_errors
from .differentiable_rendering import Gradients, with_values
from .quantised_training import QuantisedTraining
from .splat_budget import (
    corrected_count,
    count_after_round,
    count_after_round_for_psnr,
    count_for_size,
)
from .splat_merging import merge_candidates, merge_pairs
from .time_budget import TimeBudget
from .trainer import Trainer
from .training_views import TrainingViews, make_training_views
from .tune_config import TuneConfig

# Learning rates of rounds, of what follows them, and of training through quantisers: first, last.
_ROUND_RATES: Final = (1.0, 0.3)
_RECOVERY_RATES: Final = (1.0, 0.1)
# σ of this is 0.9997: capped alphas of 0.99 (3DGS) stay, and gradients reach the logit.
_LARGEST_LOGIT: Final = 8.0
# Where the number of splats is not known before, the work is planned for this share of them.
_USUAL_SHARE: Final = 0.25
# What a step through the quantisers takes, in steps without them: the scene is encoded in between.
_STORING_WORK: Final = 1.6
# Where a PSNR decides how many splats are left, training tells whether they are as many as it asks
# for: for this share of the steps of a recovery, and so many times at most.
_PROBING_SHARE: Final = 0.5
_MOST_RECOVERIES: Final = 3
# Earlier rounds that are kept to go back to.
_ROUNDS_KEPT: Final = 2
# Time that is kept for what follows training through the quantisers: so many times what preparing
# it took, and so many times what encoding once and training on takes.
_FINISHING, _SETTLING = 2.0, 8.0
# The part that tells what parts take: what happens once only is over by then.
_PARTS_TIMED: Final = 2
# Parts between two checkpoints.
_PARTS_KEPT: Final = 5

State = Mapping[str, NDArray[np.generic]]
"""All that going on takes, as arrays by name."""


@dataclass(frozen=True)
class Milestone:
    """Where the tuning of a scene is.

    Parameters
    ----------
    stage : str
        ``trained``, ``stored``, or ``untuned`` where the source as it is takes fewer bytes.
    splats : int
        That are left.
    psnr_db, worst_db : float
        Mean over the test views and the worst of them, dB; ``trained`` in as many pixels as teach.
    size_bytes : int
        Of the whole file; 0 before the scene is stored.
    """

    stage: str
    splats: int
    psnr_db: float
    worst_db: float
    size_bytes: int = 0


@dataclass(frozen=True, eq=False)
class TuneResult:
    """A tuned scene.

    Parameters
    ----------
    encoded : EncodedScene
        Its report says what was measured against the source.
    splats : Splats
        As they were trained before they were stored; those of the source where it is stored as it
        is.
    """

    encoded: EncodedScene
    splats: Splats


def tune(
    source: Splats,
    training_views: TrainingViews,
    cameras: Sequence[Camera],
    target: Target,
    config: TuneConfig,
    *,
    test_views: Sequence[Camera] = (),
    covering: Sequence[Camera] = (),
    size_of: SizeOf,
    preview: PreviewMaker | None = None,
    resume: State | None = None,
    checkpoint: Callable[[State], None] | None = None,
    notify: Callable[[Milestone], None] | None = None,
    progress: Progress = silent,
) -> TuneResult:
    """Train fewer splats to show what a scene shows, and store them.

    In rounds, the splats whose deletion changes the pictures least are left out and the others
    trained to make up for them. What is left trains on through the encoder's own quantisers: it is
    drawn as it will be decoded, and its values move by what the pictures then ask for.

    Where the target is a PSNR, the source is also encoded as it is, without training, and this is
    the result where it has the PSNR in fewer bytes: small scenes, and targets that need nearly all
    splats, leave training nothing to save.

    Parameters
    ----------
    source : Splats
        Rows must be valid (`Splats.require_valid`).
    training_views : TrainingViews
        Of the source (`training_views.make_training_views`).
    cameras : sequence of Camera
        Views to score in, in the frame of the means.
    target : Target
        PSNR against renders of the source in the test views, or size of the file.
    config : TuneConfig
    test_views : sequence of Camera
        Where quality is measured; some of `cameras` where none are given.
    covering : sequence of Camera
        Views of what `cameras` leave out (`contribution.score`).
    size_of : callable
        Bytes of the whole file that an encoded scene makes.
    preview : PreviewMaker, optional
        Makes first chunks that stand for the source until more of the tuned scene has come.
    resume : mapping of str to array, optional
        What `checkpoint` was given last in a run with the same arguments. With
        `TuneConfig.seconds`, as many steps follow as that run had planned when it was given this,
        whatever time they take: all runs that go on from one state have the same result.
    checkpoint : callable, optional
        Called after every round, and now and then while the scene is stored.
    notify : callable, optional
        Called with what was reached, at the same times.
    progress : Progress
        Called with ``search``, ``deletions``, ``train``, ``score``, ``train stored``, ``preview``
        and the stages of the encoder.

    Returns
    -------
    TuneResult
        The same for any number of threads, unless `TuneConfig.seconds` is given.

    Raises
    ------
    DataError
        ``invalid-rows``; ``target-out-of-reach``.
    """
    source.require_valid()
    measured = training_views
    if test_views:
        measured = make_training_views(
            source,
            test_views,
            copies=False,
            background=training_views.configs[0].background,
            threads=config.train.threads,
            device=training_views.configs[0].device,
            progress=progress,
        )
    run = _Run(source, training_views, measured, target, config, checkpoint, notify, progress)
    storing_of = partial(
        QuantisedTraining,
        source,
        cameras=cameras,
        covering=covering,
        target=target,
        config=config,
        test_views=test_views,
        size_of=size_of,
        preview=preview,
        progress=progress,
    )
    # A share that is given is kept, whatever the file takes.
    compared = target.psnr_db is not None and config.keep is None
    as_it_is = storing_of(source) if compared else None
    untuned = None if as_it_is is None else as_it_is.encode_untrained(source)
    if resume is not None:
        run.restore(resume)
    if run.base is None:
        run.leave_out()
        run.base = run.trainer.copy()
    begin = run.budget.now()
    storing = storing_of(run.base)
    if resume is not None:
        storing.restore_codebooks(resume)
    encoded = run.through_quantisers(storing, run.budget.now() - begin)
    if as_it_is is not None and untuned is not None:
        figures = as_it_is.measure(untuned)
        if figures[-1] < storing.measure(encoded)[-1]:
            if notify is not None:
                notify(Milestone("untuned", *figures))
            return TuneResult(as_it_is.finish(untuned), source)
    return TuneResult(storing.finish(encoded), run.base)


class _Run:
    """The state of one tuning."""

    def __init__(
        self,
        source: Splats,
        training_views: TrainingViews,
        measured: TrainingViews,
        target: Target,
        config: TuneConfig,
        checkpoint: Callable[[State], None] | None,
        notify: Callable[[Milestone], None] | None,
        progress: Progress,
    ) -> None:
        self.base: Splats | None = None
        self._training_views = training_views
        self._measured = measured
        self._target = target
        self._config = config
        self._checkpoint = checkpoint
        self._notify = notify
        self._progress = progress
        self._all = len(source)
        self.budget = TimeBudget(config.seconds)
        # States before the last rounds, how often splats were trained for long after them, and the
        # number that a correction is on its way to; 0 for none.
        self._kept: list[dict[str, NDArray[np.generic]]] = []
        self._recoveries = 0
        self._aim = 0
        # Steps made through quantisers, all of those planned, and the nominal quality they have.
        self._stored = (0, 0, 0.0)
        clipped = np.minimum(source.opacities, np.float32(_LARGEST_LOGIT))
        self.trainer = Trainer(replace(source, opacities=clipped), training_views, config.train)

    @property
    def _share(self) -> float:
        return len(self.trainer.splats) / max(self._all, 1)

    def leave_out(self) -> None:
        """Leave out splats round by round, as long as the target allows, and train the others."""
        if not self._recoveries:
            while (count := self._next_count()) is not None:
                self._round(count)
            self._recover()
        while self._aim or self._turns():
            keep = self._config.round_keep
            while (
                fewer := count_after_round(len(self.trainer.splats), self._aim, keep)
            ) is not None:
                self._round(fewer)
            self._aim = 0
            self._recover()

    def _round(self, count: int) -> None:
        """Merge splats that look alike, delete others until so many are left, and train these."""
        if self._target.psnr_db is not None and self._config.keep is None:
            state = {name: values.copy() for name, values in self.trainer.state().items()}
            self._kept = [*self._kept[1 - _ROUNDS_KEPT :], state]
        errors = self.trainer.deletion_errors()
        if errors is None:
            errors = deletion_errors(
                self.trainer.splats,
                self._training_views,
                threads=self._config.train.threads,
                progress=self._progress,
            )
        splats = self.trainer.splats
        kept, given_up = merge_candidates(splats, errors, len(splats) - count)
        # What stands for two stays, and what another stands for goes.
        errors = errors.copy()
        errors[kept], errors[given_up] = np.inf, -np.inf
        most = np.argsort(-errors, kind="stable")[:count]
        self.trainer.keep(np.sort(most), merge_pairs(splats, kept, given_up))
        self._train(self._config.round_steps, _ROUND_RATES, stretched=False)
        self._reached()

    def _recover(self) -> None:
        """Train for long, with the learning rates falling."""
        steps = self._config.recovery_steps
        if self._least_count() is None:
            steps = math.ceil(_PROBING_SHARE * steps)
        self._train(steps, _RECOVERY_RATES, stretched=True)
        self._recoveries += 1
        self._reached()

    def _turns(self) -> bool:
        """Turn to another number of splats where the target asks for it; tell whether it does.

        The way to fewer is by further rounds, to more from an earlier round.
        """
        count = self._corrected_count()
        if count is None:
            return False
        self._aim = count
        if count < len(self.trainer.splats):
            return True
        rows = [len(state["splats.opacities"]) for state in self._kept]
        # The last round that had as many; where none is kept any more, the one with most.
        enough = [number for number, kept in enumerate(rows) if kept >= count]
        self.trainer.restore(self._kept[enough[-1] if enough else int(np.argmax(rows))])
        # Having been too few once, they are not made fewer again.
        self._recoveries = _MOST_RECOVERIES - 1
        return True

    def _next_count(self) -> int | None:
        """Return how many splats the next round keeps; None where no more are left out."""
        count, keep = len(self.trainer.splats), self._config.round_keep
        least = self._least_count()
        if least is not None:
            return count_after_round(count, least, keep)
        return count_after_round_for_psnr(
            count, self._measured_db()[0], self._target.psnr_db or 0.0, keep
        )

    def _corrected_count(self) -> int | None:
        """Return how many splats the target asks for after training; None for those there are."""
        if self._least_count() is not None or self._recoveries >= _MOST_RECOVERIES:
            return None
        count = len(self.trainer.splats)
        most = max([count, *(len(state["splats.opacities"]) for state in self._kept)])
        return corrected_count(count, self._measured_db()[0], self._target.psnr_db or 0.0, most)

    def _least_count(self) -> int | None:
        """Return how many splats are to be left; None where a PSNR decides."""
        if self._config.keep is not None:
            return max(1, round(self._config.keep * self._all))
        if self._target.size_bytes is None:
            return None
        degree = self.trainer.splats.sh_degree
        return count_for_size(self._target.size_bytes, degree, self._all)

    def _train(self, planned: int, rates: tuple[float, float], *, stretched: bool) -> None:
        self._plan(planned if stretched else 0)
        steps = self.budget.steps(planned, stretched=stretched)
        run = partial(self.trainer.run, steps, *rates, progress=self._progress)
        self.budget.timed(run, TimeBudget.work(steps, self._share))

    def _plan(self, recovery_steps: int) -> None:
        """Plan how many steps follow, the steps of a recovery that begins now among them."""
        config, share = self._config, self._share
        least = self._least_count()
        end = _USUAL_SHARE if least is None else least / max(self._all, 1)
        rounds = 0.0
        if not recovery_steps and not self._recoveries:
            while share > end:
                rounds += TimeBudget.work(config.round_steps, share)
                share *= config.round_keep
            recovery_steps = config.recovery_steps
        stored = _STORING_WORK * config.quantised_steps
        self.budget.plan(rounds, TimeBudget.work(recovery_steps + stored, min(end, share)))

    def _measured_db(self) -> tuple[float, float]:
        """Return the mean and the least PSNR in the test views, dB."""
        training_views = self._measured

        def measure(view: int) -> float:
            picture = render(
                self.trainer.splats, training_views.cameras[view], training_views.configs[view]
            )
            return float(psnr(training_views.pictures[view], picture))

        threads = thread_count(self._config.train.threads)
        found = list(ordered_map(measure, range(training_views.given), threads))
        return float(np.mean(found)), min(found)

    def _reached(self) -> None:
        if self._notify is not None:
            self._notify(Milestone("trained", len(self.trainer.splats), *self._measured_db()))
        if self._checkpoint is not None:
            self._checkpoint(self.state())

    def through_quantisers(self, storing: QuantisedTraining, seconds: float) -> EncodedScene:
        """Train the scene as it will be decoded; return it as it is stored in the end.

        Parameters
        ----------
        storing : QuantisedTraining
        seconds : float
            That making it took.
        """
        refresh = self._config.refresh
        done, planned, quality = self._stored
        timed = not planned
        if timed:
            parts = self.budget.steps(-(-self._config.quantised_steps // refresh), stretched=True)
            planned = parts * refresh
            quality = storing.initial_quality(self.trainer.splats)
        while done < planned:
            begin = self.budget.now()
            quality = self._part(storing, done, planned, quality)
            done += refresh
            took = self.budget.now() - begin
            if timed and done == _PARTS_TIMED * refresh:
                left = self.budget.fitting(
                    (planned - done) // refresh, took, _FINISHING * seconds + _SETTLING * took
                )
                planned = done + left * refresh
            self._progress("train stored", done, planned)
            if (done // refresh) % _PARTS_KEPT == 0:
                self._stored = done, planned, quality
                self._stored_reached(storing)
        encoded = storing.reach_target(self.trainer, quality, refresh)
        if self._notify is not None:
            self._notify(Milestone("stored", *storing.measure(encoded)))
        return encoded

    def _part(self, storing: QuantisedTraining, done: int, planned: int, quality: float) -> float:
        """Encode the scene, and train on as it is decoded; return the next nominal quality."""
        refresh = self._config.refresh
        # Each part has one set of decoded values.
        measure = (done // refresh + 1) % _PARTS_KEPT == 0
        quality, made = storing.encode_towards_target(
            self.trainer.splats, quality, done / planned, measure
        )
        rates = (
            storing.learning_rate_factor(done / planned),
            storing.learning_rate_factor((done + refresh) / planned),
        )
        storing.train(self.trainer, made, quality, refresh, rates)
        return quality

    def _stored_reached(self, storing: QuantisedTraining) -> None:
        if self._notify is not None:
            self._notify(Milestone("stored", *storing.last_measurement))
        if self._checkpoint is not None:
            self._checkpoint(self.state() | storing.state())

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that `restore` needs."""
        arrays = dict(self.trainer.state())
        arrays["stored"] = np.array(self._stored)
        arrays["recoveries"] = np.array((self._recoveries, self._aim))
        arrays["factor"] = np.array(self.budget.factor)
        for number, kept in enumerate(self._kept):
            arrays |= {f"kept{number}.{name}": values for name, values in kept.items()}
        if self.base is not None:
            for name in Gradients.names():
                arrays[f"base.{name}"] = getattr(self.base, name)
        return arrays

    def restore(self, state: State) -> None:
        """Go on from a state of an earlier run with the same arguments."""
        self.trainer.restore(state)
        done, planned, quality = state["stored"].tolist()
        self._stored = int(done), int(planned), float(quality)
        self._recoveries, self._aim = state["recoveries"].tolist()
        self.budget.hold(float(state["factor"]))
        self._kept = []
        for number in range(_ROUNDS_KEPT):
            first = f"kept{number}."
            kept = {
                name.removeprefix(first): np.array(values)
                for name, values in state.items()
                if name.startswith(first)
            }
            self._kept += [kept] if kept else []
        if "base.means" in state:
            arrays = {
                name: np.array(state[f"base.{name}"], np.float32) for name in Gradients.names()
            }
            self.base = with_values(self.trainer.splats, arrays)
