"""Training: Adam on all values of a scene, against the error of its pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .differentiable_rendering import ForwardPass, Gradients, render_forward, with_values
from .image_losses import LOSSES
from .prefix_loss import PrefixLoss
from .splat_adam import SplatAdam
from .tile_kernels import DELETED
from .training_views import TrainingViews

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

RATES: Final[Mapping[str, float]] = MappingProxyType(
    {
        "means": 0.01,
        "scales": 0.005,
        "quats": 0.002,
        "opacities": 0.03,
        "sh0": 0.005,
        "shN": 0.0015,
    }
)
"""Learning rates. Those of 3DGS but for means, whose unit is each splat's own middle axis: a step
moves a large splat further than a small one, and scenes of any size train alike."""

# Learning rates follow the sizes of splats, looked up once in so many steps.
_STEPS_AT_ONE_RATE: Final = 20
# What the error of a view keeps of itself when it is measured again.
_ERROR_MEMORY: Final = 0.5
# A view whose error is so many times the mean counts no more than that, or less than its inverse.
_MOST_WEIGHT: Final = 4.0

# Steps, of two views each, in which all splats have been seen well enough to compare them; fewer
# where every view has been drawn before.
_STEPS_TO_SCORE: Final = 90

# What a render of the source counts where photos teach as well: enough for what no photo shows to
# stay as it was.
_RENDER_WEIGHT: Final = 0.1

# What tells the random numbers of noise and of prefixes from those of views.
_NOISE, _PREFIX = 2, 3


@dataclass(frozen=True)
class TrainConfig:
    """How a scene is trained.

    Parameters
    ----------
    loss : str
        One of `losses.LOSSES`: ``squared`` or ``photo``.
    worst_views : float
        Views count in proportion to their mean squared error to this power: 0 counts all alike.
    noise : bool
        Whether what lies between the values and what is drawn in their place has a random sign,
        value by value and step by step: noise as large as the errors of the quantisers (Ballé et
        al. 2017), in place of these errors. Measured to be worse; for comparisons.
    rates : mapping of str to float
        Learning rates by array; arrays that are not in it stay as they are.
    seed : int
        Decides in which order views come.
    threads : int
        0 for every core this process may use. The result does not depend on it.
    """

    loss: str = "squared"
    worst_views: float = 1.0
    noise: bool = False
    rates: Mapping[str, float] = field(default_factory=lambda: RATES)
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise ValueError(f"loss {self.loss!r}, expected one of {tuple(LOSSES)}")
        if not 0.0 <= self.worst_views <= 1.0:
            raise ValueError(f"worst_views {self.worst_views}, expected 0 to 1")
        unknown = self.rates.keys() - RATES.keys()
        if unknown:
            raise ValueError(f"learning rates of {sorted(unknown)}, expected some of {list(RATES)}")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed}, expected 0 or more")
        thread_count(self.threads)


class Trainer:
    """A scene while it is trained.

    Each step draws one view along the cameras and one copy off their path, and moves all values
    once. Where photos teach, it draws one of them and one of all other views, which counts less.

    Parameters
    ----------
    splats : Splats
        Copied.
    training_views : TrainingViews
    config : TrainConfig
    steps : int
        Steps that were made before, where training goes on: views come as they would have.
    """

    def __init__(
        self, splats: Splats, training_views: TrainingViews, config: TrainConfig, *, steps: int = 0
    ) -> None:
        self.splats = _copy(splats)
        self.steps = steps
        self._training_views = training_views
        self._config = config
        self._pixels = [picture.shape[0] * picture.shape[1] for picture in training_views.pictures]
        self._adam = SplatAdam(splats)
        self._gradients = Gradients.zeros(splats)
        self._forget_deletions()
        # Mean squared error of each view when it was last drawn; NaN before.
        self._errors = np.full(len(training_views), np.nan)

    def run(
        self,
        steps: int,
        first_rate: float,
        last_rate: float,
        *,
        decoded: Splats | None = None,
        extra_gradients: Gradients | None = None,
        prefix_loss: PrefixLoss | None = None,
        progress: Progress = silent,
        stage: str = "train",
    ) -> float:
        """Train for some steps.

        Parameters
        ----------
        steps : int
        first_rate, last_rate : float
            Factors on the learning rates of the first and of the last step; between them they fall
            by the same share in every step.
        decoded : Splats, optional
            What is drawn in place of the values that are trained, as stored values are: what lies
            between the two is added to the trained values in every step (straight-through
            gradients, Bengio et al. 2013).
        extra_gradients : Gradients, optional
            Derivatives of whatever else the values cost, in units of the mean over pixels of the
            squared error of a picture, its channels summed.
        prefix_loss : PrefixLoss, optional
            In one view of each step one of them is drawn as well.
        progress : Progress
            Called with `stage`, steps done and steps.
        stage : str

        Returns
        -------
        float
            Mean PSNR of the pictures that were drawn, dB.
        """
        offsets = None
        if decoded is not None:
            offsets = {
                name: getattr(decoded, name) - getattr(self.splats, name)
                for name in Gradients.names()
            }
        rates: dict[str, F32] = {}
        decibels = 0.0
        progress(stage, 0, steps)
        for step in range(steps):
            if step % _STEPS_AT_ONE_RATE == 0:
                factor = first_rate * (last_rate / first_rate) ** (step / steps)
                rates = self._rates(factor)
            errors = self._step(rates, offsets, extra_gradients, prefix_loss)
            decibels += sum(-10 * math.log10(max(error, 1e-10)) for error in errors) / len(errors)
            progress(stage, step + 1, steps)
        return decibels / max(steps, 1)

    def copy(self) -> Splats:
        """Return the scene as it is now, which further steps do not change."""
        return _copy(self.splats)

    def keep(self, rows: NDArray[np.int64], changed: Splats | None = None) -> None:
        """Go on with some of the splats, and with what is known of their gradients.

        Parameters
        ----------
        rows : (n,) int64
            Those that stay.
        changed : Splats, optional
            What all of them are from now on; as they were where it is not given.
        """
        self.splats = _copy((self.splats if changed is None else changed).take(rows))
        self._adam = self._adam.take(rows)
        self._gradients = Gradients.zeros(self.splats)
        self._forget_deletions()

    def deletion_errors(self) -> F64 | None:
        """Return what the pictures drawn of late would have lost without each of the splats.

        Returns
        -------
        (N,) float64 or None
            As `deletion.deletion_errors` measures it, in the views drawn since splats were left out
            last, each by its weight, while the values moved: these sums cost a step nearly nothing.
            None where too few views have been drawn since.
        """
        along, total = self._training_views.along, len(self._training_views)
        needed = min(max(along, total - along), _STEPS_TO_SCORE)
        return self._deleted if self._deleted_steps >= needed else None

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return all that `restore` needs, as arrays by name."""
        arrays: dict[str, NDArray[np.generic]] = {
            f"splats.{name}": getattr(self.splats, name) for name in Gradients.names()
        }
        arrays |= self._adam.state()
        arrays |= {"deleted": self._deleted, "deleted_steps": np.array(self._deleted_steps)}
        return arrays | {"steps": np.array(self.steps), "errors": self._errors}

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Go on from what `state` returned."""
        arrays = {name: np.array(state[f"splats.{name}"], np.float32) for name in Gradients.names()}
        self.splats = with_values(self.splats, arrays)
        self._adam = SplatAdam.from_state(state)
        self._gradients = Gradients.zeros(self.splats)
        self.steps = int(state["steps"])
        self._errors = np.array(state["errors"], np.float64)
        self._deleted = np.array(state["deleted"], np.float64)
        self._deleted_steps = int(state["deleted_steps"])

    def _forget_deletions(self) -> None:
        self._deleted = np.zeros(len(self.splats))
        self._deleted_steps = 0

    def _step(
        self,
        rates: Mapping[str, F32],
        offsets: Mapping[str, F32] | None,
        extra_gradients: Gradients | None,
        prefix_loss: PrefixLoss | None,
    ) -> list[float]:
        """Move the values once; return the mean squared errors of the views that were drawn."""
        shown = self.splats
        if offsets is not None:
            if self._config.noise:
                offsets = self._with_random_signs(offsets)
            moved = {name: getattr(shown, name) + offset for name, offset in offsets.items()}
            shown = with_values(shown, moved)
        views = self._views()
        # Weighed before the errors change that weights follow from.
        weighed = [(view, self._weight(view)) for view in views]
        measure = partial(self._measured, shown=shown)
        self._gradients.clear()
        errors = []
        found = ordered_map(measure, weighed, thread_count(self._config.threads))
        for (view, weight), (drawing, sums, error) in zip(weighed, found, strict=True):
            drawing.add(sums, self._gradients)
            self._deleted[drawing.footprints.index] += weight * sums[:, DELETED]
            before = self._errors[view]
            kept = error if math.isnan(before) else _ERROR_MEMORY * (before - error) + error
            self._errors[view] = kept
            errors.append(error)
        if prefix_loss is not None:
            number = self.steps % len(views)
            view, weight = weighed[number]
            prefix_loss.add_gradients(
                shown,
                self._training_views.cameras[view],
                self._training_views.configs[view],
                self._training_views.pictures[view],
                loss=self._config.loss,
                # One view of a prefix stands for all views of the step.
                error=len(views) * weight * errors[number],
                rng=np.random.default_rng((self._config.seed, _PREFIX, self.steps)),
                gradients=self._gradients,
            )
        if extra_gradients is not None:
            # The loss is half the squared error, summed over the pixels of these views.
            self._gradients.add(
                extra_gradients.times(0.5 * sum(self._pixels[view] for view in views))
            )
        self._adam.step(self.splats, self._gradients, rates, self._config.threads)
        self.steps += 1
        self._deleted_steps += 1
        return errors

    def _with_random_signs(self, offsets: Mapping[str, F32]) -> dict[str, F32]:
        """Return offsets with other signs; those of splats that are not drawn stay."""
        rng = np.random.default_rng((self._config.seed, _NOISE, self.steps))
        return {
            name: np.where((rng.random(values.shape) < 0.5) & np.isfinite(values), -values, values)
            for name, values in offsets.items()
        }

    def _measured(
        self, weighed: tuple[int, float], *, shown: Splats
    ) -> tuple[ForwardPass, F64, float]:
        """Draw a view; return the picture, what the loss asks of it, and its squared error."""
        view, weight = weighed
        training_views = self._training_views
        drawing = render_forward(shown, training_views.cameras[view], training_views.configs[view])
        error, by_picture = LOSSES[self._config.loss](
            drawing.picture, training_views.pictures[view]
        )
        by_picture *= np.float32(weight)
        return drawing, drawing.sums(by_picture), error

    def _weight(self, view: int) -> float:
        """Return how much a view counts, by the error that it had when it was last drawn."""
        error = self._errors[view]
        photos = self._training_views.photos
        weight = _RENDER_WEIGHT if 0 < photos <= view else 1.0
        if not self._config.worst_views or not error > 0.0:
            return weight
        ratio = float((error / np.nanmean(self._errors)) ** self._config.worst_views)
        return weight * min(max(ratio, 1.0 / _MOST_WEIGHT), _MOST_WEIGHT)

    def _views(self) -> list[int]:
        """Return the views of this step: each comes once in every round through all of its kind."""
        first_kind, total = (
            self._training_views.photos or self._training_views.along,
            len(self._training_views),
        )
        views = []
        kinds = ((0, first_kind), (first_kind, total - first_kind))
        for kind, (first, count) in enumerate(kinds):
            if count:
                turn, place = divmod(self.steps, count)
                rng = np.random.default_rng((self._config.seed, kind, turn))
                views.append(first + int(rng.permutation(count)[place]))
        return views

    def _rates(self, factor: float) -> dict[str, F32]:
        """Return the learning rate of every splat's values."""
        rates = {}
        for name, rate in self._config.rates.items():
            each = np.full(len(self.splats), factor * rate, np.float32)
            if name == "means":
                each *= np.exp(np.median(self.splats.scales, axis=1))
            rates[name] = each
        return rates


def _copy(splats: Splats) -> Splats:
    """Return a scene whose arrays may be written to, without extra attributes."""
    arrays = {name: getattr(splats, name).copy() for name in Gradients.names()}
    return with_values(splats.without_extras(), arrays)
