"""Orders by name: contribution, marginal gain, octree, baselines; with or without a first view."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.executor import Executor
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry import frustum
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats

from . import baselines, chunk_plan, octree
from . import first_view as view_rules
from .gain_effort import GainEffort

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores
    from cogsplat.codec.scoring.reference_views import ReferenceViews

FIRST_VIEW: Final = "first-view"
FRUSTUM: Final = "frustum"
POSE_RULES: Final = (FIRST_VIEW, FRUSTUM)
"""Suffixes of an order's name, after a ``+``, that bring the splats of a first view forward."""

# PRoGS, section 3.2 (Zoomers et al. 2024): leaves at depth 3.
_OCTREE_DEPTH: Final = 3
# The paper gives no capacity. At 1000 splats per leaf, a captured room of 80,796 splats has about
# the number of leaves of a grid of depth 3.
_OCTREE_CAPACITY: Final = 1000
# PRoGS, section 3.3: image bounds increased by 30 %, as 3DGS does: ±1.3 in normalised device
# coordinates, 15 % of the image's size at each side.
_FRUSTUM_MARGIN: Final = 0.15
# On a captured room, taking 10 % of the splats by one view costs other views 0.2 to 0.4 dB in a
# prefix of 20 %; taking 15 % would cost 1 dB. Without mixing, other views lose 4 dB at 10 %.
_FIRST_VIEW_SHARE: Final = 0.1
_FIRST_VIEW_MIX: Final = 0.8


@dataclass(frozen=True)
class OrderConfig:
    """Settings of the orders.

    Parameters
    ----------
    octree_depth : int
        Depth of the octree of ``octree-round-robin`` and ``octree-quota``, 0 to 20.
    octree_capacity : int
        Splats of a leaf of ``octree-adaptive`` at most.
    first_view : Camera or None
        First view for ``+first-view`` and ``+frustum``, in the frame of the means.
    first_view_share : float
        Share of all splats that ``+first-view`` orders by that view, 0 to 1.
    first_view_mix : float
        Share of those splats in every prefix until all are included, 0 to 1; the rest of the prefix
        follows the order of the whole scene.
    frustum_share : float or None
        Share of every prefix that ``+frustum`` keeps inside the frustum, 0 to 1. None halves the
        share of splats outside (`first_view.default_share`; the paper states no value).
    frustum_margin : float
        Extension of the frustum beyond the image at each side, as a share of the image size; 0.15
        is ±1.3 in normalised device coordinates.
    seed : int
        Seed of ``random``.
    inflated : bool
        Whether ``gain`` inflates prefixes as compensation will draw them when it measures gains.
    run_chunks : int
        Chunks of each run of ``gain`` that is sorted by contribution, at least 1; fewer show more
        in prefixes, and take more bytes.
    by_object : bool
        Whether each chunk holds a single object (`objects`); needs the attribute ``object``.
    object_budgets : tuple of (int, float)
        Objects that come first: label, and the share of the object's splats within its budget.
        Label None stands for all other objects. Only with `by_object`.
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
    run_chunks: int = chunk_plan.RUN_CHUNKS
    by_object: bool = False
    object_budgets: tuple[tuple[int | None, float], ...] = ()

    def __post_init__(self) -> None:
        require_finite(self)
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
        if self.run_chunks < 1:
            raise ValueError(f"runs of {self.run_chunks} chunks, expected 1 or more")
        for label, share in self.object_budgets:
            if not 0 <= share <= 1:
                raise ValueError(f"budget {share} of object {label}, expected 0 to 1")
        if self.object_budgets and not self.by_object:
            raise ValueError("object_budgets without by_object")


@dataclass(frozen=True, eq=False)
class OrderInputs:
    """Scene to order, with its scores and views.

    Parameters
    ----------
    splats : Splats
        Splats to order.
    scores : Scores
        Scores of these splats; zeros if no view was scored.
    views : sequence of Camera
        Scored cameras without jittered copies; empty if not known.
    threads : int
        Number of threads; 0 for all cores. No order depends on it.
    progress : Progress
        Called by orders that render views.
    jitter : bool
        Whether orders that render views use jittered copies too.
    references : ReferenceViews or None
        Reference views of these cameras; None if not rendered yet.
    executor : Executor or None
        Executor of the work on single views; None for threads of this process.
    effort : GainEffort
        Effort of ``gain``.
    """

    splats: Splats
    scores: Scores
    views: Sequence[Camera] = ()
    threads: int = 0
    progress: Progress = field(default=silent)
    jitter: bool = True
    references: ReferenceViews | None = None
    executor: Executor | None = None
    effort: GainEffort = field(default_factory=GainEffort)


Order = Callable[[OrderInputs, OrderConfig], NDArray[np.int64]]


def by_contribution(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by descending contribution, ties in file order (PRoGS, section 3.1)."""
    return baselines.sort_descending(scene.scores.contribution)


def _octree_round_robin(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by `octree.round_robin`."""
    leaves = octree.leaves(scene.splats.means, config.octree_depth)
    return octree.round_robin(leaves, scene.scores.contribution)


def _octree_quota(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by `octree.quota`."""
    leaves = octree.leaves(scene.splats.means, config.octree_depth)
    return octree.quota(leaves, scene.scores.contribution)


def _octree_adaptive(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by `octree.round_robin` over leaves of bounded size."""
    leaves = octree.adaptive_leaves(scene.splats.means, config.octree_capacity)
    return octree.round_robin(leaves, scene.scores.contribution)


def _by_gain(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows by marginal gain, sorted by contribution in runs of chunks."""
    from .marginal_gain import GainConfig, gain_order

    rows = gain_order(
        scene.splats,
        scene.scores,
        scene.views,
        GainConfig(
            inflated=config.inflated,
            jitter=scene.jitter,
            threads=scene.threads,
            effort=scene.effort,
        ),
        references=scene.references,
        executor=scene.executor,
        progress=scene.progress,
    )
    return chunk_plan.sort_runs(rows, scene.scores.contribution, run_chunks=config.run_chunks)


def _baseline(priority: Callable[[Splats], NDArray[np.float64]]) -> Order:
    """Return an order function that sorts by descending `priority`."""
    return lambda scene, config: baselines.sort_descending(priority(scene.splats))


def _source(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return rows in file order."""
    return np.arange(len(scene.splats), dtype=np.int64)


def _random(scene: OrderInputs, config: OrderConfig) -> NDArray[np.int64]:
    """Return a random permutation of the rows."""
    return np.random.default_rng(config.seed).permutation(len(scene.splats)).astype(np.int64)


# Orders that render import their modules when called: importing this module must not need numba.
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
    """Split a name such as ``contribution+frustum`` into the order and the rule for a first view.

    Returns
    -------
    order, rule : str
        Name of the order, and one of `POSE_RULES` or an empty string.

    Raises
    ------
    ValueError
        The order or rule is unknown.
    """
    base, plus, rule = name.partition("+")
    if base not in _ORDERS or (plus and rule not in POSE_RULES):
        raise ValueError(
            f"order {name!r}, expected one of {ORDERS}, alone or followed by + and one of "
            f"{POSE_RULES}"
        )
    return base, rule


def needs_scores(name: str) -> bool:
    """Return whether an order depends on scores, and so on cameras and a renderer.

    Parameters
    ----------
    name : str
        Name of the order; see `order_rows`.

    Returns
    -------
    bool

    Raises
    ------
    ValueError
        The name is unknown.

    Examples
    --------
    >>> needs_scores("gain"), needs_scores("source+frustum")
    (True, False)
    """
    return split_name(name)[0] in _SCORED


def order_rows(
    name: str, scene: OrderInputs, config: OrderConfig | None = None
) -> NDArray[np.int64]:
    """Return the permutation of an order: rows of the scene, first to last.

    Parameters
    ----------
    name : str
        ``contribution``: descending contribution, ties in file order (PRoGS, section 3.1).
        ``gain``: by marginal gain (`marginal_gain`), or by contribution without views.
        ``octree-round-robin``, ``octree-quota``, ``octree-adaptive``: every leaf of an octree gets
        its share early (`octree`).
        ``antimatter``, ``sgss``, ``opacity``, ``scale``, ``distance``: baselines of other programs
        and papers (`baselines`).
        ``source``: file order. ``random``: a random permutation.
        The suffix ``+first-view`` or ``+frustum`` brings the splats of a first view forward
        (`first_view`).
    scene : OrderInputs
        Scene to order, with its scores and views.
    config : OrderConfig, optional
        Settings; None for the defaults.

    Returns
    -------
    (N,) int64
        Order, independent of the number of threads.

    Raises
    ------
    DataError
        ``cameras-see-nothing``: the first view shows no splat.
    ValueError
        The name is unknown, or has a rule for a first view without `OrderConfig.first_view`.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.order.orders import OrderInputs, order_rows
    >>> from cogsplat.codec.scoring.contribution import zero_scores
    >>> from cogsplat.codec.splats import empty
    >>> splats = empty(0, 3)
    >>> splats.opacities[:] = [0.5, 2.0, -1.0]
    >>> order_rows("opacity", OrderInputs(splats, zero_scores(3))).tolist()
    [1, 0, 2]
    """
    config = config or OrderConfig()
    base, rule = split_name(name)
    if rule and config.first_view is None:
        raise ValueError(f"order {name!r} without a first view, expected one")
    rows = _ORDERS[base](scene, config)
    if not rule or config.first_view is None or not len(rows):
        return rows
    if rule == FRUSTUM:
        inside = frustum.in_frustum(scene.splats, config.first_view, config.frustum_margin)
        share = config.frustum_share
        if share is None:
            share = view_rules.default_share(inside)
        brought_forward = view_rules.keep_share(rows, inside, share)
        if np.array_equal(brought_forward, rows):
            warnings.warn(
                f"order {name}: {inside.mean():.1%} of the splats lie in the frustum of the first "
                f"view, so that keeping {share:.1%} inside changes nothing",
                CogsplatWarning,
                stacklevel=2,
            )
        return brought_forward
    in_view = _score_in_view(scene, config.first_view)
    view_rows = _ORDERS[base](in_view, config)
    view_rows = view_rows[in_view.scores.contribution[view_rows] > 0]
    return view_rules.bring_forward(rows, view_rows, config.first_view_share, config.first_view_mix)


def _score_in_view(scene: OrderInputs, camera: Camera) -> OrderInputs:
    """Return the inputs with scores from a single camera."""
    from cogsplat.codec.scoring.contribution import score
    from cogsplat.codec.scoring.score_config import ScoreConfig

    # No top K: a splat covered in this view has no other view to count in, and in a short prefix
    # the splats that cover it are missing.
    config = ScoreConfig(top_k=0, jitter=False, threads=scene.threads)
    scores = score(scene.splats, [camera], config, executor=scene.executor)
    return replace(scene, scores=scores, views=[camera], references=None)
