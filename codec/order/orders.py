"""Orders: which splats come first."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.geometry import frustum
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats

from . import baselines, chunks, octree
from . import first_view as order_views

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores
    from cogsplat.codec.scoring.reference_views import ReferenceViews

FIRST_VIEW: Final = "first-view"
FRUSTUM: Final = "frustum"
POSE_RULES: Final = (FIRST_VIEW, FRUSTUM)
"""What may follow an order's name, after a ``+``: the same order with one pose served first."""

# PRoGS, section 3.2 (Zoomers et al. 2024): leaves at depth 3.
_OCTREE_DEPTH: Final = 3
# The paper gives no capacity. At a thousand splats a leaf, a captured room of 80,796 splats has
# about as many leaves as a grid of depth 3.
_OCTREE_CAPACITY: Final = 1000
# PRoGS, section 3.3: image bounds increased by 30 %, as 3DGS does: ±1.3 in normalised device
# coordinates, 15 % of the image's size at each side.
_FRUSTUM_MARGIN: Final = 0.15
# On a captured room 10 % by one view costs the others 0.2 to 0.4 dB at 20 % of the splats, and 15 %
# would cost them 1 dB. Unmixed they would lose 4 dB at 10 %.
_FIRST_VIEW_SHARE: Final = 0.1
_FIRST_VIEW_MIX: Final = 0.8


@dataclass(frozen=True)
class OrderConfig:
    """Parameters of the orders that have some.

    Parameters
    ----------
    octree_depth : int
        Halvings of the scene's box for ``octree-round-robin`` and ``octree-quota``, 0 to 20.
    octree_capacity : int
        Most splats in a leaf of ``octree-adaptive``.
    first_view : Camera or None
        The pose that ``+first-view`` and ``+frustum`` serve, in the frame of the means.
    first_view_share : float
        Share of all splats that ``+first-view`` takes in the order of that view, 0 to 1.
    first_view_mix : float
        Of any beginning, how much is of those while they last, 0 to 1; the rest is for the others.
    frustum_share : float or None
        Share of the splats inside the frustum that ``+frustum`` keeps up, 0 to 1; None for the
        share that halves what lies outside (the paper states none).
    frustum_margin : float
        What the frustum is wider than the image at each side, as a share of its size; 0.15 is
        ±1.3 in normalised device coordinates.
    seed : int
        Of ``random``.
    inflated : bool
        Whether ``gain`` makes prefixes for being drawn with compensation, or as they are.
    by_object : bool
        Whether chunks hold one object each (`objects`); needs the attribute ``object``.
    object_budgets : tuple of (int, float)
        Objects that come before the rest, each with the share of its splats that does; None as
        object stands for all that are not named. Only with `by_object`.
    """

    octree_depth: int = _OCTREE_DEPTH
    octree_capacity: int = _OCTREE_CAPACITY
    first_view: Camera | None = None
    first_view_share: float = _FIRST_VIEW_SHARE
    first_view_mix: float = _FIRST_VIEW_MIX
    frustum_share: float | None = None
    frustum_margin: float = _FRUSTUM_MARGIN
    seed: int = 0
    inflated: bool = True
    by_object: bool = False
    object_budgets: tuple[tuple[int | None, float], ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.octree_depth <= octree.MAX_DEPTH:
            raise ValueError(f"octree depth {self.octree_depth}, expected 0 to {octree.MAX_DEPTH}")
        if self.octree_capacity < 1:
            raise ValueError(f"octree capacity {self.octree_capacity}, expected 1 or more")
        for name in ("first_view_share", "first_view_mix", "frustum_share"):
            share = getattr(self, name)
            if share is not None and not 0 <= share <= 1:
                raise ValueError(f"{name} {share}, expected 0 to 1")
        if not 0 <= self.frustum_margin < np.inf:
            raise ValueError(f"frustum_margin {self.frustum_margin}, expected 0 or more")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed}, expected 0 or more")
        for label, share in self.object_budgets:
            if not 0 <= share <= 1:
                raise ValueError(f"budget {share} of object {label}, expected 0 to 1")
        if self.object_budgets and not self.by_object:
            raise ValueError("object_budgets without by_object")


@dataclass(frozen=True, eq=False)
class Unordered:
    """What an order may look at.

    Parameters
    ----------
    splats : Splats
    scores : Scores
        Of these splats, row by row; zeros where nothing was scored.
    views : sequence of Camera
        Those the scores are of, without jittered copies; empty where they are not known.
    threads : int
        0 for all cores; no order depends on it.
    progress : Progress
    jitter : bool
        Whether orders that render look from jittered copies of the views as well.
    references : ReferenceViews or None
        The scene in these views, and their copies where `jitter` says so; None where it has not
        been drawn.
    """

    splats: Splats
    scores: Scores
    views: Sequence[Camera] = ()
    threads: int = 0
    progress: Progress = field(default=silent)
    jitter: bool = True
    references: ReferenceViews | None = None


Order = Callable[[Unordered, OrderConfig], NDArray[np.int64]]


def by_contribution(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by descending contribution, ties in file order (PRoGS, section 3.1)."""
    return baselines.descending(scene.scores.contribution)


def _octree_round_robin(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    leaves = octree.leaves(scene.splats.means, config.octree_depth)
    return octree.round_robin(leaves, scene.scores.contribution)


def _octree_quota(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    leaves = octree.leaves(scene.splats.means, config.octree_depth)
    return octree.quota(leaves, scene.scores.contribution)


def _octree_adaptive(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    leaves = octree.adaptive_leaves(scene.splats.means, config.octree_capacity)
    return octree.round_robin(leaves, scene.scores.contribution)


def _by_gain(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    from .marginal_gain import GainConfig, gain_order

    rows = gain_order(
        scene.splats,
        scene.scores,
        scene.views,
        GainConfig(inflated=config.inflated, jitter=scene.jitter, threads=scene.threads),
        references=scene.references,
        progress=scene.progress,
    )
    return chunks.sort_runs(rows, scene.scores.contribution)


def _baseline(priority: Callable[[Splats], NDArray[np.float64]]) -> Order:
    return lambda scene, config: baselines.descending(priority(scene.splats))


def _source(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    return np.arange(len(scene.splats), dtype=np.int64)


def _random(scene: Unordered, config: OrderConfig) -> NDArray[np.int64]:
    return np.random.default_rng(config.seed).permutation(len(scene.splats)).astype(np.int64)


# What renders belongs in a module of its own, imported when it is asked for.
_ORDERS: Final[Mapping[str, Order]] = {
    "contribution": by_contribution,
    "gain": _by_gain,
    "octree-round-robin": _octree_round_robin,
    "octree-quota": _octree_quota,
    "octree-adaptive": _octree_adaptive,
    "antimatter": _baseline(baselines.antimatter),
    "sgss": _baseline(baselines.sgss),
    "opacity": _baseline(baselines.opacity),
    "scale": _baseline(baselines.scale),
    "distance": _baseline(baselines.nearness),
    "source": _source,
    "random": _random,
}

_SCORED: Final = frozenset(
    {"contribution", "gain", "octree-round-robin", "octree-quota", "octree-adaptive"}
)

ORDERS: Final = tuple(_ORDERS)
"""Names of the orders; each may be followed by one of `POSE_RULES`."""


def split_name(name: str) -> tuple[str, str]:
    """Return the order and the rule for a pose that a name such as ``contribution+frustum`` names.

    Parameters
    ----------
    name : str

    Returns
    -------
    order, rule : str
        `rule` is empty where the name has none.

    Raises
    ------
    ValueError
        An unknown order or rule.
    """
    base, plus, rule = name.partition("+")
    if base not in _ORDERS or (plus and rule not in POSE_RULES):
        raise ValueError(
            f"order {name!r}, expected one of {ORDERS}, alone or followed by + and one of "
            f"{POSE_RULES}"
        )
    return base, rule


def needs_scores(name: str) -> bool:
    """Tell whether an order depends on scores; the others need neither cameras nor a renderer.

    Examples
    --------
    >>> needs_scores("gain"), needs_scores("source+frustum")
    (True, False)
    """
    return split_name(name)[0] in _SCORED


def require_order(name: str, config: OrderConfig) -> None:
    """Check that an order is known and has the parameters it needs.

    Raises
    ------
    ValueError
        An unknown name, or a rule for a pose and no `OrderConfig.first_view`.
    """
    rule = split_name(name)[1]
    if rule and config.first_view is None:
        raise ValueError(f"order {name!r} without a first view, expected one")


def order_rows(name: str, scene: Unordered, config: OrderConfig | None = None) -> NDArray[np.int64]:
    """Return the permutation of an order: rows of the scene, first to last.

    Parameters
    ----------
    name : str
        ``contribution``: descending contribution, ties in file order (PRoGS, section 3.1);
        ``gain``: what the picture so far needs most (`gain`), by contribution where no views are
        known; ``octree-round-robin``, ``octree-quota``, ``octree-adaptive``: every leaf of an
        octree gets its share early;
        ``antimatter``, ``sgss``, ``opacity``, ``scale``, ``distance``: what others sort by
        (`order_baselines`); ``source``: as in the file; ``random``. Followed by ``+first-view`` or
        ``+frustum`` (`order_views`), the same with one pose served first.
    scene : Unordered
    config : OrderConfig, optional

    Returns
    -------
    (N,) int64
        The same for any number of threads.

    Raises
    ------
    DataError
        ``cameras-see-nothing``: the first view shows no splat.
    ValueError
        As `require_order`.
    """
    config = config or OrderConfig()
    require_order(name, config)
    base, rule = split_name(name)
    rows = _ORDERS[base](scene, config)
    if not rule or config.first_view is None or not len(rows):
        return rows
    if rule == FRUSTUM:
        inside = frustum.in_frustum(scene.splats, config.first_view, config.frustum_margin)
        share = config.frustum_share
        if share is None:
            share = order_views.halved_outside(inside)
        served = order_views.keep_share(rows, inside, share)
        if np.array_equal(served, rows):
            warnings.warn(
                f"order {name}: {inside.mean():.1%} of the splats lie in the frustum of the first "
                f"view, so that keeping {share:.1%} inside changes nothing",
                CogsplatWarning,
                stacklevel=2,
            )
        return served
    in_view = _seen_from(scene, config.first_view)
    ahead = _ORDERS[base](in_view, config)
    ahead = ahead[in_view.scores.contribution[ahead] > 0]
    return order_views.lead(rows, ahead, config.first_view_share, config.first_view_mix)


def _seen_from(scene: Unordered, camera: Camera) -> Unordered:
    """Return the scene scored from one camera alone."""
    from cogsplat.codec.scoring.contribution import ScoreConfig, score

    # All weights count: a splat that others hide in part of one view has no other view to make up
    # for it, and in a short prefix the others are not there.
    config = ScoreConfig(top_k=0, jitter=False, threads=scene.threads)
    scores = score(scene.splats, [camera], config)
    return replace(scene, scores=scores, views=[camera], references=None)
