"""Levels of a scene for pictures of several sizes, trained one after the other (LapisGS).

Shi et al. 2025, "LapisGS: Layered Progressive 3D Gaussian Splatting for Adaptive Streaming". A
level adds splats to the level before and trains them on pictures of its own size; what the level
before has stays as it is but for its opacities. Unlike the code that was released with the paper,
added splats may move, start with all their SH coefficients, and frozen splats are never copied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.contribution import ScoreConfig, score
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .densification import Densification
from .differentiable_rendering import Gradients, render_forward, with_values
from .downscaling import downscale_camera, downscale_picture
from .image_losses import LOSSES
from .splat_adam import SplatAdam
from .trainer import RATES

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

MIN_OPACITY: Final = 0.005
"""A splat whose opacity is below this at a level is left out there (LapisGS, section 3.2)."""

# Factors on the learning rates of a level's first and last step; `tuning` begins likewise.
_FIRST_RATE: Final = 0.5
_LAST_RATE: Final = 0.05
# Where a level begins with points, which are further from what they become: the first factor, and
# rates in place of some of `trainer.RATES`. Of a captured room at 1/8 of its size these brought
# 26.96 dB in other views after 1,000 steps, and those 23.59.
_GROWING_RATE: Final = 1.0
_GROWING_RATES: Final = {"means": 0.03, "scales": 0.015, "opacities": 0.06, "sh0": 0.01}
# Share of a level's own splats that lie at points when it begins; growth adds the others where they
# are asked for.
_BEGINNING_SHARE: Final = 0.5
# What tells the random choice of points from that of views.
_POINTS: Final = 1


@dataclass(frozen=True)
class LevelsConfig:
    """How a scene is made into levels.

    Parameters
    ----------
    scales : tuple of int
        By what the pictures of each level are divided in width and height, falling.
    shares : tuple of float
        Share of the scene's splats that each level and those before it have, rising to at most 1.
    steps : int
        Training steps of a level, a view each.
    loss : str
        One of `losses.LOSSES`; ``structure`` is that of LapisGS.
    seed : int
        Decides in which order views come.
    threads : int
        0 for every core this process may use. The result does not depend on it.
    """

    scales: tuple[int, ...] = (8, 4, 2, 1)
    shares: tuple[float, ...] = (0.08, 0.25, 0.6, 1.0)
    steps: int = 400
    loss: str = "structure"
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        if not self.scales or min(self.scales) < 1 or any(a <= b for a, b in pairwise(self.scales)):
            raise ValueError(f"scales {self.scales}, expected whole numbers above 0 that fall")
        if len(self.shares) != len(self.scales):
            raise ValueError(
                f"{len(self.shares)} shares, expected one of {len(self.scales)} levels"
            )
        shares = (0.0, *self.shares)
        if self.shares[-1] > 1 or any(a >= b for a, b in pairwise(shares)):
            raise ValueError(f"shares {self.shares}, expected to rise from above 0 to at most 1")
        if self.steps < 0 or self.seed < 0:
            raise ValueError(f"steps {self.steps}, seed {self.seed}, expected 0 or more")
        if self.loss not in LOSSES:
            raise ValueError(f"loss {self.loss!r}, expected one of {tuple(LOSSES)}")
        thread_count(self.threads)


@dataclass(frozen=True, eq=False)
class LevelledSplats:
    """The splats of a scene with levels.

    Parameters
    ----------
    splats : Splats
        N of all levels, those of level 0 first, without extra attributes; their opacities are those
        of the level that each was added at.
    scales : tuple of int
        Of the levels.
    first, last : (N,) int64
        The level that each splat was added at, and the last that draws it.
    opacities : (L, N) float32
        Logits at every level; those of levels that do not draw a splat mean nothing.
    """

    splats: Splats
    scales: tuple[int, ...]
    first: I64
    last: I64
    opacities: F32

    def rows(self, level: int) -> I64:
        """Return the splats that a level draws."""
        return np.flatnonzero((self.first <= level) & (level <= self.last))

    def at(self, level: int) -> Splats:
        """Return the scene of a level."""
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
    """Make a trained scene into levels.

    Each level begins with the splats that contribute most to pictures of its size and are in no
    level before.

    Parameters
    ----------
    splats : Splats
        Valid rows, in the frame of the cameras.
    cameras : sequence of Camera
        Of the full pictures.
    config : LevelsConfig, optional
    pictures : sequence of (H, W, 3) float32, optional
        What the cameras saw, in the scene's colour space; by default renders of the scene.
    progress : Progress
        Called with ``pictures``, and for each level with ``score`` and ``level 0``, ``level 1`` ….

    Raises
    ------
    ValueError
        No cameras, or pictures of other sizes than theirs.
    """
    config = config or LevelsConfig()
    source = splats.without_extras()
    targets = _targets(source, cameras, pictures, config, progress)
    chosen = np.zeros(len(source), np.bool_)
    stack = _Stack(config.scales)
    for level, (scale, share) in enumerate(zip(config.scales, config.shares, strict=True)):
        views = [downscale_camera(camera, scale) for camera in cameras]
        scored = score(source, views, ScoreConfig(threads=config.threads), progress=progress)
        order = np.argsort(-scored.contribution, kind="stable")
        order = order[~chosen[order]]
        added = np.sort(order[: max(round(share * len(source)) - int(chosen.sum()), 0)])
        chosen[added] = True
        scene, frozen = stack.with_new(source.take(added))
        small = [downscale_picture(target, scale) for target in targets]
        scene = _trained(scene, frozen, views, small, config, level, progress)
        stack.take(scene, frozen)
    return stack.levels()


def grow_levels(
    points: Splats,
    cameras: Sequence[Camera],
    pictures: Sequence[F32],
    most: int,
    config: LevelsConfig | None = None,
    *,
    progress: Progress = silent,
) -> LevelledSplats:
    """Make levels of photos and of the points that structure from motion found in them.

    Each level begins with splats at some of the points, at most half as many as it may have, and
    lets its own become more while it is trained (`growth.Densification`).

    Parameters
    ----------
    points : Splats
        From `points_start.splats_from_points`, in the frame of the cameras.
    cameras : sequence of Camera
        Of the full pictures.
    pictures : sequence of (H, W, 3) float32
        What the cameras saw, 0 to 1.
    most : int
        Splats of all levels together, at most; `LevelsConfig.shares` are shares of it.
    config : LevelsConfig, optional
    progress : Progress
        Called with ``level 0``, ``level 1`` ….

    Raises
    ------
    ValueError
        No cameras, no points, or pictures of other sizes than the cameras'.
    """
    config = config or LevelsConfig()
    if not len(points) or most < 1:
        raise ValueError(f"{len(points)} points for {most} splats, expected at least 1 each")
    targets = _targets(points, cameras, pictures, config, progress)
    stack = _Stack(config.scales)
    for level, (scale, share) in enumerate(zip(config.scales, config.shares, strict=True)):
        views = [downscale_camera(camera, scale) for camera in cameras]
        wanted = max(round(share * most) - stack.splats, 1)
        rng = np.random.default_rng((config.seed, _POINTS, level))
        first = rng.permutation(len(points))[: max(round(_BEGINNING_SHARE * wanted), 1)]
        scene, frozen = stack.with_new(points.take(np.sort(first)))
        growth = Densification(frozen, wanted, config.steps, MIN_OPACITY)
        small = [downscale_picture(target, scale) for target in targets]
        scene = _trained(scene, frozen, views, small, config, level, progress, growth)
        stack.take(scene, frozen)
    return stack.levels()


class _Stack:
    """The levels that are trained so far, and the next one on top of them."""

    def __init__(self, scales: tuple[int, ...]) -> None:
        self._scales = scales
        self._joined: Splats | None = None
        self._first = self._last = np.zeros(0, np.int64)
        self._opacities = np.zeros((len(scales), 0), np.float32)
        # The next level, and the splats of those before that the last of them draws.
        self._level = 0
        self._old = np.zeros(0, np.int64)

    @property
    def splats(self) -> int:
        """Splats of all levels."""
        return len(self._first)

    def with_new(self, new: Splats) -> tuple[Splats, int]:
        """Return what the next level begins with, and how many of it are of the levels before."""
        if self._joined is None:
            return new, 0
        self._old = np.flatnonzero(self._last == self._level - 1)
        before = self._opacities[self._level - 1][self._old]
        return _joined(replace(self._joined.take(self._old), opacities=before), new), len(self._old)

    def take(self, scene: Splats, frozen: int) -> None:
        """Take in the next level as it was trained, of which the first rows are of others."""
        level, old, before = self._level, self._old, self.splats
        drawn = _opacity(scene.opacities) >= MIN_OPACITY
        # Splats that nothing shows at their own level are in no level.
        kept = np.flatnonzero(drawn[frozen:])
        new = scene.take(frozen + kept)
        self._joined = new if self._joined is None else _joined(self._joined, new)
        self._first = np.concatenate([self._first, np.full(len(kept), level)])
        self._last = np.concatenate([self._last, np.full(len(kept), level)])
        self._last[old[drawn[:frozen]]] = level
        wider = np.zeros((len(self._scales), self.splats), np.float32)
        wider[:, :before] = self._opacities
        wider[level, old] = scene.opacities[:frozen]
        wider[level, before:] = new.opacities
        self._opacities = wider
        self._level += 1

    def levels(self) -> LevelledSplats:
        """Return all of them."""
        assert self._joined is not None
        return LevelledSplats(self._joined, self._scales, self._first, self._last, self._opacities)


def train_jointly(
    splats: Splats,
    cameras: Sequence[Camera],
    config: LevelsConfig | None = None,
    *,
    progress: Progress = silent,
) -> LevelledSplats:
    """Train one model on renders of all scales, for comparison with levels.

    It has as many splats as the last level and takes as many steps as all levels together.

    Parameters
    ----------
    splats, cameras, config, progress
        As `train_levels` takes them; `progress` is called with one stage, ``level 0``.

    Returns
    -------
    LevelledSplats
        Of one level, for pictures of the last scale.

    Raises
    ------
    ValueError
        No cameras.
    """
    config = config or LevelsConfig()
    source = splats.without_extras()
    targets = _targets(source, cameras, None, config, progress)
    scored = score(source, cameras, ScoreConfig(threads=config.threads), progress=progress)
    order = np.argsort(-scored.contribution, kind="stable")
    scene = source.take(np.sort(order[: round(config.shares[-1] * len(source))]))
    views = [downscale_camera(camera, scale) for scale in config.scales for camera in cameras]
    pictures = [downscale_picture(target, scale) for scale in config.scales for target in targets]
    longer = replace(config, steps=config.steps * len(config.scales))
    scene = _trained(scene, 0, views, pictures, longer, 0, progress)
    scene = scene.take(np.flatnonzero(_opacity(scene.opacities) >= MIN_OPACITY))
    zeros = np.zeros(len(scene), np.int64)
    return LevelledSplats(scene, config.scales[-1:], zeros, zeros, scene.opacities[None])


def _targets(
    source: Splats,
    cameras: Sequence[Camera],
    pictures: Sequence[F32] | None,
    config: LevelsConfig,
    progress: Progress,
) -> list[F32]:
    """Return the full pictures that are given, or those of the source."""
    if not cameras:
        raise ValueError("no cameras, expected some to train in")
    if pictures is not None:
        sizes = [(camera.height, camera.width, 3) for camera in cameras]
        if [picture.shape for picture in pictures] != sizes:
            raise ValueError(f"{len(pictures)} pictures, expected one of its size for each camera")
        return list(pictures)
    info = source.info
    one = RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased, threads=1)
    drawn = []
    found = ordered_map(
        lambda camera: render(source, camera, one), cameras, thread_count(config.threads)
    )
    for picture in found:
        drawn.append(picture)
        progress("pictures", len(drawn), len(cameras))
    return drawn


def _trained(
    scene: Splats,
    frozen: int,
    views: Sequence[Camera],
    pictures: Sequence[F32],
    config: LevelsConfig,
    level: int,
    progress: Progress,
    growth: Densification | None = None,
) -> Splats:
    """Return a level's scene after training; of the first `frozen` rows opacities alone move."""
    scene = with_values(scene, {name: getattr(scene, name).copy() for name in Gradients.names()})
    info = scene.info
    drawing = RenderConfig(
        kernel_px=info.kernel_px, antialiased=info.antialiased, threads=config.threads
    )
    adam, gradients = SplatAdam(scene), Gradients.zeros(scene)
    axis = _middle_axes(scene)
    first_rate = _FIRST_RATE if growth is None else _GROWING_RATE
    stage = f"level {level}"
    progress(stage, 0, config.steps)
    for step in range(config.steps):
        turn, place = divmod(step, len(views))
        rng = np.random.default_rng((config.seed, level, turn))
        view = int(rng.permutation(len(views))[place])
        picture = render_forward(scene, views[view], drawing)
        _, by_picture = LOSSES[config.loss](picture.picture, pictures[view])
        gradients.clear()
        by_centres = picture.backward(by_picture, gradients)
        factor = first_rate * (_LAST_RATE / first_rate) ** (step / config.steps)
        rates = _rates(axis, frozen, factor, growing=growth is not None)
        adam.step(scene, gradients, rates, config.threads)
        if growth is not None:
            growth.note(picture.footprints.index, by_centres, len(scene))
            if growth.is_due(step + 1):
                scene, adam = growth.densify(scene, adam, step + 1)
                gradients, axis = Gradients.zeros(scene), _middle_axes(scene)
        progress(stage, step + 1, config.steps)
    return scene


def _middle_axes(scene: Splats) -> F32:
    """Return the middle one of the standard deviations of each splat, scene units."""
    axes: F32 = np.exp(np.median(scene.scales, axis=1)) if len(scene) else np.ones(0, np.float32)
    return axes


def _rates(axis: F32, frozen: int, factor: float, *, growing: bool) -> dict[str, F32]:
    """Return the learning rate of every splat's values; 0 for all but opacities of frozen ones."""
    rates = {}
    for name, rate in ({**RATES, **_GROWING_RATES} if growing else RATES).items():
        each = np.full(len(axis), factor * rate, np.float32)
        if name == "means":
            each *= axis
        if name != "opacities":
            each[:frozen] = 0
        rates[name] = each
    return rates


def _opacity(logits: F32) -> NDArray[np.float64]:
    opacity: NDArray[np.float64] = 1 / (1 + np.exp(-np.clip(logits, -80, 80).astype(np.float64)))
    return opacity


def _joined(first: Splats, second: Splats) -> Splats:
    return with_values(
        first,
        {
            name: np.concatenate([getattr(first, name), getattr(second, name)])
            for name in Gradients.names()
        },
    )
