"""Training of a scene: Adam on all splat values against the error of rendered views."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .checkpoint_arrays import (
    CheckpointArrays,
    checkpoint_array,
    checkpoint_count,
    checkpoint_splats,
)
from .differentiable_rendering import ForwardPass, Gradients, render_forward, with_values
from .image_losses import LOSSES
from .prefix_loss import PrefixLoss
from .splat_adam import SplatAdam
from .tile_kernels import DELETED
from .train_config import TrainConfig
from .training_views import DrawnViews, TrainingView, TrainingViews

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Steps between two updates of the learning rates of means, which follow the sizes of splats.
_RATE_UPDATE_INTERVAL: Final = 20

# Steps, of two views each, after which deletion errors accumulated in training are reliable. Fewer
# steps suffice where every view has been rendered.
_DELETION_STEPS: Final = 90

# Weight of renders of the source where photos are ground truth as well: enough to preserve what no
# photo shows.
_RENDER_WEIGHT: Final = 0.1

# Where views are drawn, a given camera is rendered every third step, and one of the few covering
# views every eighth.
_GIVEN_INTERVAL, _COVERING_INTERVAL = 3, 8
# Number of steps that share a set of drawn views, and the number of them that show each view.
# Their pictures are kept meanwhile, up to 100 MB. A view's ground truth, a render of the source,
# costs more than training few splats. In equal processor time, views shown four times gain 0.2 dB
# on a captured room and lose 0.2 dB in its worst view; in equal steps they cost 0.3 dB off the path
# on an object. Showing each twice is between these and new views in every step.
_DRAWN_STEPS, _SHOWINGS = 32, 2

# Salts of the random generators for noise, prefixes and drawn views; fixed views use 0 and 1.
_NOISE_SALT, _PREFIX_SALT, _DRAWN_SALT = 2, 3, 4


@dataclass(frozen=True, eq=False)
class _RenderedView:
    """A view of one step: its forward pass, footprint sums, mean squared error and weight."""

    training_view: TrainingView
    forward: ForwardPass
    sums: F64
    error: float
    weight: float


class Trainer:
    """A scene in training, with its optimiser state.

    A step renders a view on the capture path and a view off it, and updates all values once. Most
    of these views are drawn (`TrainingViews.drawn`), and each is shown in two steps. Where photos
    are ground truth, the first view is a photo's, and the second has a lower weight. Without drawn
    views, both come from the fixed set; a set without views off the path has one view per step.

    Parameters
    ----------
    splats : Splats
        Scene to train; it is copied.
    views : TrainingViews
        Cameras and ground truth.
    config : TrainConfig
        Loss, learning rates, seed and threads.
    steps : int
        Steps already made in a resumed run; the order of views continues from there.
    """

    def __init__(
        self, splats: Splats, views: TrainingViews, config: TrainConfig, *, steps: int = 0
    ) -> None:
        self.splats = _writable_copy(splats)
        self.steps = steps
        self._views = views
        self._config = config
        self._adam = SplatAdam(splats)
        self._gradients = Gradients.zeros(splats)
        # Drawn views of the current steps, by random seed.
        self._drawn: dict[tuple[int, ...], TrainingView] = {}
        self._reset_deletion_errors()

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
        """Train for a number of steps.

        Parameters
        ----------
        steps : int
            Number of steps.
        first_rate, last_rate : float
            Factors on the learning rates at the first and the last step; exponential in between.
        decoded : Splats, optional
            Scene after an encode-decode round trip. Its difference from the current scene is the
            quantisation error. Every step adds this error to the trained values before rendering
            (straight-through gradients, Bengio et al. 2013).
        extra_gradients : Gradients, optional
            Gradients of a further loss, such as the rate, added in every step. Their unit is the
            squared error of a picture, summed over channels and averaged over pixels.
        prefix_loss : PrefixLoss, optional
            Loss of renders of a random prefix of the chunks, added in one view per step.
        progress : Progress
            Receives `stage`, in steps.
        stage : str
            Name of the stage.

        Returns
        -------
        float
            Mean PSNR of the training renders of all steps, dB.
        """
        offsets = None
        if decoded is not None:
            offsets = {
                name: getattr(decoded, name) - getattr(self.splats, name)
                for name in Gradients.names()
            }
        rates: dict[str, F32] = {}
        total_db = 0.0
        progress(stage, 0, steps)
        for step in range(steps):
            if step % _RATE_UPDATE_INTERVAL == 0:
                factor = first_rate * (last_rate / first_rate) ** (step / steps)
                rates = self._rates(factor)
            errors = self._step(rates, offsets, extra_gradients, prefix_loss)
            total_db += sum(-10 * math.log10(max(error, 1e-10)) for error in errors) / len(errors)
            progress(stage, step + 1, steps)
        return total_db / max(steps, 1)

    def copy(self) -> Splats:
        """Return a copy of the current scene, which further steps do not change."""
        return _writable_copy(self.splats)

    def keep(self, rows: NDArray[np.int64], changed: Splats | None = None) -> None:
        """Delete all splats except for some rows, which keep their optimiser state.

        Parameters
        ----------
        rows : (n,) int64
            Rows to keep.
        changed : Splats, optional
            Scene that replaces the current one before rows are deleted; the current one by default.
        """
        self.splats = _writable_copy((self.splats if changed is None else changed).take(rows))
        self._adam = self._adam.select(rows)
        self._gradients = Gradients.zeros(self.splats)
        self._reset_deletion_errors()

    def deletion_errors(self) -> F64 | None:
        """Return the deletion error of each splat, accumulated while training.

        Returns
        -------
        (N,) float64 or None
            Squared colour change by the removal of each splat (`deletion_errors.deletion_errors`),
            over the views rendered since the last deletion, with their weights in training. Values
            changed between these views, but the sums cost next to nothing. None where too few views
            were rendered.
        """
        needed = _DELETION_STEPS
        if self._views.drawn is None:
            given, total = self._views.num_given, len(self._views)
            needed = min(max(given, total - given), needed)
        return self._deletion_errors if self._deletion_steps >= needed else None

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the checkpoint arrays of the trainer by name."""
        arrays: dict[str, NDArray[np.generic]] = {
            f"splats.{name}": getattr(self.splats, name) for name in Gradients.names()
        }
        arrays |= self._adam.state()
        arrays["deleted"] = self._deletion_errors
        arrays["deleted_steps"] = np.array(self._deletion_steps)
        return arrays | {"steps": np.array(self.steps)}

    def restore(self, state: CheckpointArrays) -> None:
        """Restore the trainer from the checkpoint arrays of `state`.

        Raises
        ------
        FormatError
            ``bad-checkpoint``: an array is missing, or has another shape or type.
        """
        splats = with_values(self.splats, checkpoint_splats(state, "splats.", self.splats))
        adam = SplatAdam.from_state(state, splats)
        steps, deletion_steps = (checkpoint_count(state, n) for n in ("steps", "deleted_steps"))
        deletion_errors = checkpoint_array(state, "deleted", (len(splats),))
        self.splats, self._adam, self.steps = splats, adam, steps
        self._gradients = Gradients.zeros(splats)
        self._deletion_errors = np.array(deletion_errors, np.float64)
        self._deletion_steps = deletion_steps

    def _reset_deletion_errors(self) -> None:
        """Start accumulating deletion errors anew."""
        self._deletion_errors = np.zeros(len(self.splats))
        self._deletion_steps = 0

    def _step(
        self,
        rates: Mapping[str, F32],
        offsets: Mapping[str, F32] | None,
        extra_gradients: Gradients | None,
        prefix_loss: PrefixLoss | None,
    ) -> list[float]:
        """Render the views of one step and make one optimiser step.

        Parameters
        ----------
        rates : mapping of str to (N,) float32
            Learning rate of each splat by array.
        offsets : mapping of str to float32 array, optional
            Quantisation errors by array, added to the values before rendering.
        extra_gradients, prefix_loss
            See `run`.

        Returns
        -------
        list of float
            Mean squared error of each rendered view.
        """
        scene = self._with_offsets(offsets)
        if self.steps % _DRAWN_STEPS == 0:
            self._drawn.clear()
        choices = self._choose_views()
        self._gradients.clear()
        render_view = partial(self._render_and_differentiate, scene=scene)
        rendered = list(ordered_map(render_view, choices, thread_count(self._config.threads)))
        for view in rendered:
            view.forward.add_gradients(view.sums, self._gradients)
            self._deletion_errors[view.forward.footprints.index] += (
                view.weight * view.sums[:, DELETED]
            )
        if prefix_loss is not None:
            view = rendered[self.steps % len(rendered)]
            prefix_loss.add_gradients(
                scene,
                view.training_view.camera,
                view.training_view.config,
                view.training_view.picture,
                loss=self._config.loss,
                # Prefixes are rendered in one view for all views of the step.
                error=len(rendered) * view.weight * view.error,
                rng=np.random.default_rng((self._config.seed, _PREFIX_SALT, self.steps)),
                gradients=self._gradients,
            )
        if extra_gradients is not None:
            # The loss is half the squared error, summed over the pixels of these views.
            pixels = sum(view.training_view.picture[..., 0].size for view in rendered)
            self._gradients.add(extra_gradients.times(0.5 * pixels))
        self._adam.step(self.splats, self._gradients, rates, self._config.threads)
        self.steps += 1
        self._deletion_steps += 1
        return [view.error for view in rendered]

    def _with_offsets(self, offsets: Mapping[str, F32] | None) -> Splats:
        """Return the scene to render: the current values plus their quantisation errors."""
        if offsets is None:
            return self.splats
        if self._config.noise:
            offsets = self._with_random_signs(offsets)
        moved = {name: getattr(self.splats, name) + offset for name, offset in offsets.items()}
        return with_values(self.splats, moved)

    def _with_random_signs(self, offsets: Mapping[str, F32]) -> dict[str, F32]:
        """Return offsets with random signs; infinite ones, of pruned splats, are unchanged."""
        rng = np.random.default_rng((self._config.seed, _NOISE_SALT, self.steps))
        return {
            name: np.where((rng.random(values.shape) < 0.5) & np.isfinite(values), -values, values)
            for name, values in offsets.items()
        }

    def _render_and_differentiate(
        self, choice: tuple[Callable[[], TrainingView], float], *, scene: Splats
    ) -> _RenderedView:
        """Render a chosen view and differentiate its loss; see `_choose_views`."""
        make_view, weight = choice
        view = make_view()
        forward = render_forward(scene, view.camera, view.config)
        error, by_picture = LOSSES[self._config.loss](forward.picture, view.picture)
        by_picture *= np.float32(weight)
        return _RenderedView(view, forward, forward.footprint_sums(by_picture), error, weight)

    def _choose_views(self) -> list[tuple[Callable[[], TrainingView], float]]:
        """Return functions that make the views of this step, on and off the path, with weights.

        An epoch shows each fixed view of a kind once.
        """
        views, seed = self._views, self._config.seed
        given, total = views.num_given, len(views)
        given_interval = 1 if views.photos else _GIVEN_INTERVAL
        kinds = ((0, given, given_interval), (given, total - given, _COVERING_INTERVAL))
        chosen: list[tuple[Callable[[], TrainingView], float]] = []
        for kind, (first, count, interval) in enumerate(kinds):
            interval = 1 if views.drawn is None else interval
            if count and self.steps % interval == 0:
                epoch, position = divmod(self.steps // interval, count)
                order = np.random.default_rng((seed, kind, epoch)).permutation(count)
                number = first + int(order[position])
                chosen.append((partial(views.fixed, number), 1.0))
            elif views.drawn is not None:
                # Photos show the path alone: the other view is on and off it in turn.
                block, position = divmod(self.steps, _DRAWN_STEPS)
                rng = np.random.default_rng((seed, _DRAWN_SALT, kind, block))
                number = int(rng.permutation(_DRAWN_STEPS)[position]) // _SHOWINGS
                off_path = bool(kind) and not (views.photos and number % 2)
                key = (seed, _DRAWN_SALT, kind, block, number)
                chosen.append((partial(self._drawn_view, views.drawn, key, off_path), 1.0))
        if views.photos:
            chosen[1:] = [(make_view, _RENDER_WEIGHT) for make_view, _ in chosen[1:]]
        return chosen

    def _drawn_view(self, drawn: DrawnViews, key: tuple[int, ...], off_path: bool) -> TrainingView:
        """Return the drawn view of a random seed, with its ground truth."""
        found = self._drawn.get(key)
        if found is None:
            found = drawn.render(*drawn.camera(np.random.default_rng(key), off_path=off_path))
            self._drawn[key] = found
        return found

    def _rates(self, factor: float) -> dict[str, F32]:
        """Return the learning rate of each splat by array, times a factor."""
        rates = {}
        for name, rate in self._config.rates.items():
            by_splat = np.full(len(self.splats), factor * rate, np.float32)
            if name == "means":
                by_splat *= np.exp(np.median(self.splats.scales, axis=1))
            rates[name] = by_splat
        return rates


def _writable_copy(splats: Splats) -> Splats:
    """Return a copy of a scene with writable arrays and without extra attributes."""
    arrays = {name: getattr(splats, name).copy() for name in Gradients.names()}
    return with_values(splats.without_extras(), arrays)
