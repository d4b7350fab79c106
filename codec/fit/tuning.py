"""Tuning: fewer splats that show the same, trained through the quantisers that store them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.pipeline import SizeOf
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.rate_control import Target
from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .deletion import deletion_errors
from .drawing import Gradients, with_values
from .lessons import Lessons, lessons_of
from .pace import Pace
from .storing import Storing
from .trainer import TrainConfig, Trainer

# What a stored splat takes where splats and bytes are in balance, by SH degree: a captured scene of
# degree 3 in 129 kB was shown better by 11,715 splats than by 14,543. The others are in proportion
# to what SH coefficients take.
_BYTES_PER_SPLAT: Final = (6.5, 8.0, 9.5, 11.0)
# By how much pictures are to be better than the target when the last round ends: what follows it
# brings about half a decibel, and storing takes 1.5 to 2.
_MARGIN_DB: Final = 1.2
# Nearer to that than this, rounds leave out half as many.
_NEAR_DB: Final = 1.0
# Learning rates of rounds, of what follows them, and of training through quantisers: first, last.
_ROUND_RATES: Final = (0.5, 0.5)
_RECOVERY_RATES: Final = (0.5, 0.1)
# σ of this is 0.9997: capped alphas of 0.99 (3DGS) stay, and gradients reach the logit.
_LARGEST_LOGIT: Final = 8.0
# Where the number of splats is not known before, the work is planned for this share of them.
_USUAL_SHARE: Final = 0.25

# Profiles whose quantisers a scene can be trained through; `near-lossless` bounds errors instead.
_PROFILES: Final = ("transform", "vq")

State = Mapping[str, NDArray[np.generic]]
"""All that going on takes, as arrays by name."""


@dataclass(frozen=True)
class TuneConfig:
    """How a scene is tuned.

    Parameters
    ----------
    keep : float or None
        Share of the splats that is kept; None for what the target allows.
    round_keep : float
        Share that one round of leaving out and training keeps.
    round_steps, recovery_steps, storing_steps : int
        Steps of training in each round, after the last of them, and through the quantisers.
    refresh : int
        Steps of training through the quantisers between two encodes of the scene.
    seconds : float or None
        Time that all this may take. Steps then become fewer or more, and the result depends on how
        fast the machine is.
    preset : str
        One of `presets.PRESETS`: how the tuned scene is scored, ordered and compensated.
    profile : str
        ``transform`` or ``vq``: what the scene is stored as. Of ``vq`` the codebooks train with the
        splats, each beginning where the one before ended, and every splat takes the row that is
        nearest by then (Niedermayr et al. 2024, section 3.3, with the means trained too).
    train : TrainConfig
    """

    keep: float | None = None
    round_keep: float = 0.8
    round_steps: int = 150
    recovery_steps: int = 500
    storing_steps: int = 400
    refresh: int = 10
    seconds: float | None = None
    preset: str = "fast"
    profile: str = "transform"
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        if self.keep is not None and not 0.0 < self.keep <= 1.0:
            raise ValueError(f"keep {self.keep}, expected above 0 and at most 1")
        if not 0.0 < self.round_keep < 1.0:
            raise ValueError(f"round_keep {self.round_keep}, expected between 0 and 1")
        steps = (self.round_steps, self.recovery_steps, self.storing_steps, self.refresh)
        if min(steps) < 1:
            raise ValueError(f"steps {steps}, expected at least 1 each")
        if self.seconds is not None and not self.seconds > 0:
            raise ValueError(f"{self.seconds} seconds, expected more than 0")
        if self.preset not in PRESETS:
            raise ValueError(f"preset {self.preset!r}, expected one of {tuple(PRESETS)}")
        if self.profile not in _PROFILES:
            raise ValueError(f"profile {self.profile!r}, expected one of {_PROFILES}")


@dataclass(frozen=True)
class Milestone:
    """Where the tuning of a scene is.

    Parameters
    ----------
    stage : str
        ``trained`` or ``stored``.
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
class Tuned:
    """A tuned scene.

    Parameters
    ----------
    encoded : EncodedScene
        Its report says what was measured against the source.
    splats : Splats
        As they were trained before they were stored.
    """

    encoded: EncodedScene
    splats: Splats


def tune(
    source: Splats,
    lessons: Lessons,
    cameras: Sequence[Camera],
    target: Target,
    config: TuneConfig,
    *,
    test_views: Sequence[Camera] = (),
    size_of: SizeOf,
    resume: State | None = None,
    checkpoint: Callable[[State], None] | None = None,
    notify: Callable[[Milestone], None] | None = None,
    progress: Progress = silent,
) -> Tuned:
    """Train fewer splats to show what a scene shows, and store them.

    In rounds, the splats whose deletion changes the pictures least are left out and the others
    trained to make up for them. What is left trains on through the encoder's own quantisers: it is
    drawn as it will be decoded, and its values move by what the pictures then ask for.

    Parameters
    ----------
    source : Splats
        Rows must be valid (`Splats.require_valid`).
    lessons : Lessons
        Of the source (`lessons.lessons_of`).
    cameras : sequence of Camera
        Views to score in, in the frame of the means.
    target : Target
        PSNR against renders of the source in the test views, or size of the file.
    config : TuneConfig
    test_views : sequence of Camera
        Where quality is measured; some of `cameras` where none are given.
    size_of : callable
        Bytes of the whole file that an encoded scene makes.
    resume : mapping of str to array, optional
        What `checkpoint` was given last in a run with the same arguments.
    checkpoint : callable, optional
        Called after every round, and now and then while the scene is stored.
    notify : callable, optional
        Called with what was reached, at the same times.
    progress : Progress
        Called with ``deletions``, ``train``, ``score``, ``train stored`` and the stages of the
        encoder.

    Returns
    -------
    Tuned
        The same for any number of threads, unless `TuneConfig.seconds` is given.

    Raises
    ------
    DataError
        ``invalid-rows``; ``target-out-of-reach``.
    """
    source.require_valid()
    measured = lessons
    if test_views:
        measured = lessons_of(
            source,
            test_views,
            copies=False,
            background=lessons.configs[0].background,
            threads=config.train.threads,
            progress=progress,
        )
    run = _Run(source, lessons, measured, target, config, checkpoint, notify, progress)
    if resume is not None:
        run.restore(resume)
    if run.base is None:
        run.leave_out()
        run.base = run.trainer.copy()
    storing = Storing(
        source, run.base, cameras, target, config.preset, config.profile, test_views, size_of,
        config.train.threads, progress,
    )  # fmt: skip
    if resume is not None:
        storing.restore(resume)
    encoded = run.through_quantisers(storing)
    return Tuned(storing.finished(encoded), run.base)


class _Run:
    """The state of one tuning."""

    def __init__(
        self,
        source: Splats,
        lessons: Lessons,
        measured: Lessons,
        target: Target,
        config: TuneConfig,
        checkpoint: Callable[[State], None] | None,
        notify: Callable[[Milestone], None] | None,
        progress: Progress,
    ) -> None:
        self.base: Splats | None = None
        self._lessons = lessons
        self._measured = measured
        self._target = target
        self._config = config
        self._checkpoint = checkpoint
        self._notify = notify
        self._progress = progress
        self._all = len(source)
        self._pace = Pace(config.seconds)
        # Steps made through quantisers, all of those planned, and the nominal quality they have.
        self._stored = (0, 0, 0.0)
        clipped = np.minimum(source.opacities, np.float32(_LARGEST_LOGIT))
        self.trainer = Trainer(replace(source, opacities=clipped), lessons, config.train)

    @property
    def _share(self) -> float:
        return len(self.trainer.splats) / max(self._all, 1)

    def leave_out(self) -> None:
        """Leave out splats round by round, as long as the target allows, and train the others."""
        config = self._config
        while (count := self._next_count()) is not None:
            errors = deletion_errors(
                self.trainer.splats,
                self._lessons,
                threads=config.train.threads,
                progress=self._progress,
            )
            most = np.argsort(-errors, kind="stable")[:count]
            self.trainer.keep(np.sort(most))
            self._train(config.round_steps, _ROUND_RATES)
            self._reached()
        self._train(config.recovery_steps, _RECOVERY_RATES)
        self._reached()

    def _next_count(self) -> int | None:
        """Return how many splats the next round keeps; None where no more are left out."""
        config, count = self._config, len(self.trainer.splats)
        least = self._least_count()
        if least is None:
            beyond = self._measured_db()[0] - (self._target.psnr_db or 0.0) - _MARGIN_DB
            keep = config.round_keep if beyond > _NEAR_DB else (1 + config.round_keep) / 2
            return int(keep * count) if beyond > 0 and count > 1 else None
        return max(least, int(config.round_keep * count)) if least < count else None

    def _least_count(self) -> int | None:
        """Return how many splats are to be left; None where a PSNR decides."""
        if self._config.keep is not None:
            return max(1, round(self._config.keep * self._all))
        if self._target.size_bytes is None:
            return None
        each = _BYTES_PER_SPLAT[self.trainer.splats.sh_degree]
        return max(1, min(self._all, int(self._target.size_bytes / each)))

    def _train(self, planned: int, rates: tuple[float, float]) -> None:
        steps = self._pace.steps(planned, self._share, self._work_after(planned))
        run = partial(self.trainer.run, steps, *rates, progress=self._progress)
        self._pace.timed(lambda: (run(), None)[1], steps, self._share)

    def _work_after(self, planned: int) -> float:
        """Return the work that follows the steps which are being planned."""
        config = self._config
        least = self._least_count()
        end = _USUAL_SHARE if least is None else least / max(self._all, 1)
        work = Pace.work(config.storing_steps * 2, end)
        if planned == config.recovery_steps:
            return work
        share = self._share * config.round_keep
        while share > end:
            work += Pace.work(config.round_steps, share)
            share *= config.round_keep
        return work + Pace.work(config.recovery_steps, end)

    def _measured_db(self) -> tuple[float, float]:
        """Return the mean and the least PSNR in the test views, dB."""
        lessons = self._measured

        def measure(view: int) -> float:
            picture = render(self.trainer.splats, lessons.cameras[view], lessons.configs[view])
            return float(psnr(lessons.pictures[view], picture))

        threads = thread_count(self._config.train.threads)
        found = list(ordered_map(measure, range(lessons.given), threads))
        return float(np.mean(found)), min(found)

    def _reached(self) -> None:
        if self._notify is not None:
            self._notify(Milestone("trained", len(self.trainer.splats), *self._measured_db()))
        if self._checkpoint is not None:
            self._checkpoint(self.state())

    def through_quantisers(self, storing: Storing) -> EncodedScene:
        """Train the scene as it will be decoded; return it as it is stored in the end."""
        config = self._config
        done, planned, quality = self._stored
        if not planned:
            planned = self._pace.steps(config.storing_steps, self._share, 0.0)
            # Each part of the run has one rate and one set of decoded values.
            planned = -(-planned // config.refresh) * config.refresh
            quality = storing.first_quality(self.trainer.splats)
        for begin in range(done, planned, config.refresh):
            quality, decoded = storing.aimed(self.trainer.splats, quality, begin / planned)
            rates = [storing.rate((begin + k) / planned) for k in (0, config.refresh)]
            self.trainer.run(config.refresh, rates[0], rates[1], drawn_as=decoded)
            self._progress("train stored", begin + config.refresh, planned)
            if (begin // config.refresh) % 5 == 4:
                self._stored = begin + config.refresh, planned, quality
                self._stored_reached(storing)
        encoded = storing.settled(self.trainer, quality, config.refresh)
        if self._notify is not None:
            self._notify(Milestone("stored", *storing.figures(encoded)))
        return encoded

    def _stored_reached(self, storing: Storing) -> None:
        if self._notify is not None:
            self._notify(Milestone("stored", *storing.last_figures))
        if self._checkpoint is not None:
            self._checkpoint(self.state() | storing.state())

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that `restore` needs."""
        arrays = dict(self.trainer.state())
        arrays["stored"] = np.array(self._stored)
        if self.base is not None:
            for name in Gradients.names():
                arrays[f"base.{name}"] = getattr(self.base, name)
        return arrays

    def restore(self, state: State) -> None:
        """Go on from a state of an earlier run with the same arguments."""
        self.trainer.restore(state)
        done, planned, quality = state["stored"].tolist()
        self._stored = int(done), int(planned), float(quality)
        if "base.means" in state:
            arrays = {
                name: np.array(state[f"base.{name}"], np.float32) for name in Gradients.names()
            }
            self.base = with_values(self.trainer.splats, arrays)
