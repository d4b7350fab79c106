"""Training of levels: one scene for pictures of several resolutions (LapisGS).

Shi et al. 2025, "LapisGS: Layered Progressive 3D Gaussian Splatting for Adaptive Streaming". Each
level adds splats to the level below and trains them on pictures of its own resolution. The splats
of the level below are frozen, except for their opacities. Unlike in the released code of the paper,
means of added splats are trained, they start with all SH coefficients, and frozen splats are never
duplicated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.order.marginal_gain import GainConfig, gain_order
from cogsplat.codec.order.prefix_inflation import (
    Inflation,
    best_inflation,
    effective_splats,
    inflate,
)
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.trained_arrays import opacities_from_logits

from .densification import Densification
from .differentiable_rendering import Gradients, render_forward, with_values
from .downscaling import downscale_picture
from .image_losses import LOSSES
from .splat_adam import SplatAdam
from .train_config import RATES, LevelsConfig

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

MIN_OPACITY: Final = 0.005
"""Minimum opacity: a level does not draw splats below it (LapisGS, section 3.2)."""

# Factors on the learning rates at a level's first and last step.
_FIRST_RATE: Final = 0.5
_LAST_RATE: Final = 0.05
# The same for levels that start from points, and learning rates in place of some of
# `RATES`: initial splats are further from their final values. On a captured room at 1/8 of its
# size, held-out views had 26.96 dB after 1,000 steps, and 23.59 dB with `RATES`.
_FIRST_RATE_FROM_POINTS: Final = 1.0
_RATES_FROM_POINTS: Final = {"means": 0.03, "scales": 0.015, "opacities": 0.06, "sh0": 0.01}
# Share of a level's added splats that start at points; densification adds the rest.
_INITIAL_SHARE: Final = 0.5
# Salt of the random generator for points.
_POINTS_SALT: Final = 1


@dataclass(frozen=True, eq=False)
class LevelledSplats:
    """A scene with L levels: all splats, and the range of levels that draws each splat.

    Parameters
    ----------
    splats : Splats
        N splats of all levels, by the level that added them, without extra attributes. Opacities
        are those of that level.
    scales : tuple of int
        Downscaling of the pictures of each level, per axis.
    first_level, last_level : (N,) int64
        First and last level that draws each splat.
    opacities : (L, N) float32
        Opacity logits at each level; undefined at levels that do not draw the splat.
    """

    splats: Splats
    scales: tuple[int, ...]
    first_level: I64
    last_level: I64
    opacities: F32

    def rows(self, level: int) -> I64:
        """Return the (n,) int64 rows of the splats that a level draws."""
        return np.flatnonzero((self.first_level <= level) & (level <= self.last_level))

    def scene(self, level: int) -> Splats:
        """Return the splats that a level draws, with their opacities at this level."""
        rows = self.rows(level)
        return replace(self.splats.take(rows), opacities=self.opacities[level][rows])


def train_levels(
    splats: Splats,
    cameras: Sequence[Camera],
    config: LevelsConfig | None = None,
    *,
    pictures: Sequence[F32] | None = None,
    progress: Progress = silent,
) -> LevelledSplats:
    """Train a scene with levels of detail from a trained scene.

    Each level is trained for pictures of one resolution. It adds splats of the trained scene that
    no lower level has: the first of the order by marginal gain in pictures of its resolution,
    inflated as a prefix of the level's size needs. Of a captured room, a file with 12,119 of 80,796
    splats for a quarter of the size had 33.2 dB after 150 steps, and 23.3 dB with splats of highest
    contribution, not inflated.

    Parameters
    ----------
    splats : Splats
        Trained scene with valid rows, in the frame of the cameras.
    cameras : sequence of Camera
        Training views at full resolution.
    config : LevelsConfig, optional
        Settings of the levels.
    pictures : sequence of (H, W, 3) float32, optional
        Ground truth of each camera at full resolution, in the scene's colour space; renders of the
        scene by default.
    progress : Progress
        Receives ``pictures``, and for each level ``score`` and ``level 0``, ``level 1`` …

    Returns
    -------
    LevelledSplats

    Raises
    ------
    ValueError
        There are no cameras, or a picture differs from its camera in size.
    """
    config = config or LevelsConfig()
    source = splats.without_extras()
    targets = _targets(source, cameras, pictures, config, progress)
    used = np.zeros(len(source), np.bool_)
    builder = _LevelBuilder(config.scales)
    for level, (scale, share) in enumerate(zip(config.scales, config.shares, strict=True)):
        views = [camera.downscaled(scale) for camera in cameras]
        count = round(share * len(source))
        order, inflation = _gain_order(source, views, count, config, progress)
        order = order[~used[order]]
        added = np.sort(order[: max(count - int(used.sum()), 0)])
        used[added] = True
        scene, frozen = builder.initial_scene(inflate(source.take(added), inflation))
        small = [downscale_picture(target, scale) for target in targets]
        scene = _train_level(scene, frozen, views, small, config, level, progress)
        builder.append_level(scene, frozen)
    return builder.levels()


def grow_levels(
    points: Splats,
    cameras: Sequence[Camera],
    pictures: Sequence[F32],
    max_splats: int,
    config: LevelsConfig | None = None,
    *,
    progress: Progress = silent,
) -> LevelledSplats:
    """Train a scene with levels of detail from photos and structure-from-motion points.

    Each level has a budget of splats to add. Half of the budget starts at randomly chosen points.
    Training splits these splats until the budget is used (`densification.Densification`).

    Parameters
    ----------
    points : Splats
        Splats from `initial_splats.splats_from_points`, in the frame of the cameras.
    cameras : sequence of Camera
        Training views at full resolution.
    pictures : sequence of (H, W, 3) float32
        Photo of each camera, 0 to 1.
    max_splats : int
        Maximum number of splats of all levels; `LevelsConfig.shares` are shares of it.
    config : LevelsConfig, optional
        Settings of the levels.
    progress : Progress
        Receives ``level 0``, ``level 1`` …

    Returns
    -------
    LevelledSplats

    Raises
    ------
    ValueError
        There are no cameras or no points, or a photo differs from its camera in size.
    """
    config = config or LevelsConfig()
    if not len(points) or max_splats < 1:
        raise ValueError(f"{len(points)} points for {max_splats} splats, expected at least 1 each")
    targets = _targets(points, cameras, pictures, config, progress)
    builder = _LevelBuilder(config.scales)
    for level, (scale, share) in enumerate(zip(config.scales, config.shares, strict=True)):
        views = [camera.downscaled(scale) for camera in cameras]
        added = max(round(share * max_splats) - builder.count, 1)
        rng = np.random.default_rng((config.seed, _POINTS_SALT, level))
        initial = rng.permutation(len(points))[: max(round(_INITIAL_SHARE * added), 1)]
        scene, frozen = builder.initial_scene(points.take(np.sort(initial)))
        densification = Densification(frozen, added, config.steps, MIN_OPACITY)
        small = [downscale_picture(target, scale) for target in targets]
        scene = _train_level(scene, frozen, views, small, config, level, progress, densification)
        builder.append_level(scene, frozen)
    return builder.levels()


class _LevelBuilder:
    """Builder of a scene with levels, one trained level at a time."""

    def __init__(self, scales: tuple[int, ...]) -> None:
        self._scales = scales
        self._splats: Splats | None = None
        self._first = self._last = np.zeros(0, np.int64)
        self._opacities = np.zeros((len(scales), 0), np.float32)
        # Index of the next level, and rows of the splats that the level below draws.
        self._level = 0
        self._drawn_below = np.zeros(0, np.int64)

    @property
    def count(self) -> int:
        """Number of splats of all levels so far."""
        return len(self._first)

    def initial_scene(self, added: Splats) -> tuple[Splats, int]:
        """Start the next level from the level below and added splats.

        Parameters
        ----------
        added : Splats
            Splats that the level adds.

        Returns
        -------
        scene : Splats
            Splats of the level below, then the added ones.
        frozen : int
            Number of splats of the level below.
        """
        if self._splats is None:
            return added, 0
        below = self._level - 1
        self._drawn_below = np.flatnonzero(self._last == below)
        opacities = self._opacities[below][self._drawn_below]
        old = replace(self._splats.take(self._drawn_below), opacities=opacities)
        return _concatenate(old, added), len(old)

    def append_level(self, scene: Splats, frozen: int) -> None:
        """Append a trained level.

        Parameters
        ----------
        scene : Splats
            Trained scene of the level.
        frozen : int
            Number of leading rows that belong to the levels below; only their opacities are
            recorded.
        """
        level, before = self._level, self.count
        is_drawn = opacities_from_logits(scene.opacities.astype(np.float64)) >= MIN_OPACITY
        # An added splat that its own level does not draw belongs to no level.
        kept = np.flatnonzero(is_drawn[frozen:])
        added = scene.take(frozen + kept)
        self._splats = added if self._splats is None else _concatenate(self._splats, added)
        self._first = np.concatenate([self._first, np.full(len(kept), level)])
        self._last = np.concatenate([self._last, np.full(len(kept), level)])
        self._last[self._drawn_below[is_drawn[:frozen]]] = level
        opacities = np.zeros((len(self._scales), self.count), np.float32)
        opacities[:, :before] = self._opacities
        opacities[level, self._drawn_below] = scene.opacities[:frozen]
        opacities[level, before:] = added.opacities
        self._opacities = opacities
        self._level += 1

    def levels(self) -> LevelledSplats:
        """Return the scene with all levels appended so far."""
        assert self._splats is not None
        return LevelledSplats(self._splats, self._scales, self._first, self._last, self._opacities)


def _gain_order(
    source: Splats, views: Sequence[Camera], count: int, config: LevelsConfig, progress: Progress
) -> tuple[I64, Inflation]:
    """Order the splats by marginal gain in views, and return the inflation of the first `count`."""
    scores = score(source, views, ScoreConfig(threads=config.threads), progress=progress)
    # Behind the splats of this level the order has no effect.
    relative = max(count, 1) / effective_splats(scores.contribution)
    effort = GainEffort(ordered_ratio=min(GainEffort().ordered_ratio, relative))
    gain = GainConfig(jitter=False, threads=config.threads, effort=effort)
    order = gain_order(source, scores, views, gain, progress=progress)
    return order, best_inflation(relative)


def _targets(
    source: Splats,
    cameras: Sequence[Camera],
    pictures: Sequence[F32] | None,
    config: LevelsConfig,
    progress: Progress,
) -> list[F32]:
    """Return the ground truth of each camera: given pictures, or renders of the source."""
    if not cameras:
        raise ValueError("no cameras, expected at least 1 to train in")
    if pictures is not None:
        sizes = [(camera.height, camera.width, 3) for camera in cameras]
        if [picture.shape for picture in pictures] != sizes:
            raise ValueError(f"{len(pictures)} pictures, expected one per camera, of its size")
        return list(pictures)
    settings = RenderConfig(threads=1)
    targets = []
    renders = ordered_map(
        lambda camera: render(source, camera, settings), cameras, thread_count(config.threads)
    )
    for picture in renders:
        targets.append(picture)
        progress("pictures", len(targets), len(cameras))
    return targets


def _train_level(
    scene: Splats,
    frozen: int,
    views: Sequence[Camera],
    pictures: Sequence[F32],
    config: LevelsConfig,
    level: int,
    progress: Progress,
    densification: Densification | None = None,
) -> Splats:
    """Train the scene of one level and return it.

    Parameters
    ----------
    scene : Splats
        Initial scene of the level.
    frozen : int
        Number of leading rows that are frozen, except for their opacities.
    views : sequence of Camera
        Training views at the resolution of the level.
    pictures : sequence of (H, W, 3) float32
        Ground truth of each view.
    config : LevelsConfig
        Steps, loss, seed and threads.
    level : int
        Index of the level; seeds the order of views and names the progress stage.
    progress : Progress
        Receives the stage ``level 0``, ``level 1`` … of this level, in steps.
    densification : Densification, optional
        Splits splats; also selects the learning rates of levels that start from points.
    """
    scene = with_values(scene, {name: getattr(scene, name).copy() for name in Gradients.names()})
    settings = RenderConfig(threads=config.threads)
    adam, gradients = SplatAdam(scene), Gradients.zeros(scene)
    axes = _middle_axes(scene)
    from_points = densification is not None
    first_rate = _FIRST_RATE_FROM_POINTS if from_points else _FIRST_RATE
    stage = f"level {level}"
    progress(stage, 0, config.steps)
    for step in range(config.steps):
        epoch, position = divmod(step, len(views))
        rng = np.random.default_rng((config.seed, level, epoch))
        view = int(rng.permutation(len(views))[position])
        forward = render_forward(scene, views[view], settings)
        _, by_picture = LOSSES[config.loss](forward.picture, pictures[view])
        gradients.clear()
        by_centres = forward.backward(by_picture, gradients)
        factor = first_rate * (_LAST_RATE / first_rate) ** (step / config.steps)
        rates = _learning_rates(axes, frozen, factor, from_points=from_points)
        adam.step(scene, gradients, rates, config.threads)
        if densification is not None:
            densification.accumulate(forward.footprints.index, by_centres, len(scene))
            if densification.is_due(step + 1):
                scene, adam = densification.densify(scene, adam, step + 1)
                gradients, axes = Gradients.zeros(scene), _middle_axes(scene)
        progress(stage, step + 1, config.steps)
    return scene


def _middle_axes(scene: Splats) -> F32:
    """Return the middle of the three standard deviations of each splat, (N,), scene units."""
    axes: F32 = np.exp(np.median(scene.scales, axis=1)) if len(scene) else np.ones(0, np.float32)
    return axes


def _learning_rates(axes: F32, frozen: int, factor: float, *, from_points: bool) -> dict[str, F32]:
    """Return the learning rate of each splat by array.

    Parameters
    ----------
    axes : (N,) float32
        Middle standard deviations, the unit of the learning rate of means.
    frozen : int
        Number of leading rows whose learning rates are 0, except for opacities.
    factor : float
        Factor on all rates.
    from_points : bool
        Whether the level starts from points; selects higher rates.
    """
    rates = {}
    for name, rate in ({**RATES, **_RATES_FROM_POINTS} if from_points else RATES).items():
        by_splat = np.full(len(axes), factor * rate, np.float32)
        if name == "means":
            by_splat *= axes
        if name != "opacities":
            by_splat[:frozen] = 0
        rates[name] = by_splat
    return rates


def _concatenate(first: Splats, second: Splats) -> Splats:
    """Return the splats of two scenes as one scene."""
    return with_values(
        first,
        {
            name: np.concatenate([getattr(first, name), getattr(second, name)])
            for name in Gradients.names()
        },
    )
