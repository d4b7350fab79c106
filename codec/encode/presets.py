"""Presets of the encoder: numbers of views, effort of ordering and of compensation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.views.view_sets import sample_evenly

if TYPE_CHECKING:
    from cogsplat.codec.scoring.score_config import ScoreConfig
    from cogsplat.codec.views.planner import ViewPlanConfig

    from .shift_optimiser import FitConfig


@dataclass(frozen=True)
class Preset:
    """Numbers of views to plan, score and predict in, and the effort of each rendering stage.

    Parameters
    ----------
    planned_views : int
        Views planned for a scene without cameras. Where given cameras overlap too little, half as
        many are planned and scored in addition.
    planned_jitter : bool
        Score jittered copies of planned views as well. A fast preset drops copies rather than
        places: nothing else shows the surfaces of a dropped place.
    views_every : int
        Score every n-th given view, with its jittered copies.
    most_views : int
        Maximum number of given views to score; each further view adds less information at the same
        cost.
    jitter_copies : int
        Jittered copies of each scored view (`ScoreConfig.jitter_copies`).
    sensitivity_every : int
        Interval of the scored views in which sensitivities are measured
        (`ScoreConfig.sensitivity_every`).
    prediction_views : int
        Maximum number of views in which the quality of prefixes is predicted.
    reference_views : int
        Maximum number of ground-truth renders for the order by marginal gain and for compensation;
        never above `reference_views.MAX_VIEWS`.
    reference_share : float
        Maximum number of pixels of a reference view, as a share of
        `reference_views.PICTURE_PIXELS`.
    reference_jitter : bool
        Also draw reference views from jittered copies of the cameras.
    gain : GainEffort
        Extent and step size of the order by marginal gain.
    fit_iterations : int
        Iterations per compensation layer.
    fit_views : int
        Views rendered in each iteration.
    """

    planned_views: int
    planned_jitter: bool
    views_every: int
    most_views: int
    jitter_copies: int
    sensitivity_every: int
    prediction_views: int
    reference_views: int = 1024
    reference_share: float = 1.0
    reference_jitter: bool = True
    gain: GainEffort = field(default_factory=GainEffort)
    fit_iterations: int = 16
    fit_views: int = 4

    @property
    def reference_pixels(self) -> int:
        """Pixels of a reference view at most."""
        from cogsplat.codec.scoring.reference_views import PICTURE_PIXELS

        return round(self.reference_share * PICTURE_PIXELS)

    def views(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Return the given views to score, evenly spread; a small number is not thinned out.

        Parameters
        ----------
        cameras : sequence of Camera
            Given views.
        """
        every = min(self.views_every, max(len(cameras) // FEWEST_VIEWS, 1))
        return sample_evenly(cameras, min(-(-len(cameras) // every), self.most_views))

    def plan_config(self, threads: int = 0, *, in_addition: bool = False) -> ViewPlanConfig:
        """Return the view planning settings.

        Parameters
        ----------
        threads : int
            Number of threads, 0 for all cores.
        in_addition : bool
            Whether the views are planned in addition to given cameras; then half as many.
        """
        from cogsplat.codec.views.planner import ViewPlanConfig

        views = max(self.planned_views // 2, 1) if in_addition else self.planned_views
        return ViewPlanConfig(views=views, threads=threads)

    def fit_config(self, threads: int = 0) -> FitConfig:
        """Return the settings of the compensation fit.

        Parameters
        ----------
        threads : int
            Number of threads, 0 for all cores.
        """
        from .shift_optimiser import FitConfig

        return FitConfig(
            iterations=self.fit_iterations,
            views=self.fit_views,
            threads=threads,
        )

    def score_config(
        self,
        profile: str,
        *,
        top_k: int | None = None,
        jitter: bool = True,
        threads: int = 0,
        colour_sensitivity: bool = False,
    ) -> ScoreConfig:
        """Return the scoring settings for a profile.

        Parameters
        ----------
        profile : str
            One of `config.PROFILE_NAMES`; `near-lossless` does not use sensitivities.
        top_k : int or None
            `ScoreConfig.top_k`; None for all weights of at least `LEAST_WEIGHT`.
        jitter : bool
            `ScoreConfig.jitter`.
        threads : int
            Number of threads, 0 for all cores.
        colour_sensitivity : bool
            `ScoreConfig.colour_sensitivity`; unused by the profiles.
        """
        from cogsplat.codec.scoring.score_config import LEAST_WEIGHT, ScoreConfig

        every = self.sensitivity_every if profile != "near-lossless" else 0
        return ScoreConfig(
            top_k=top_k or 0,
            least_weight=LEAST_WEIGHT if top_k is None else 0.0,
            jitter=jitter,
            jitter_copies=self.jitter_copies,
            threads=threads,
            sensitivity_every=every,
            colour_sensitivity=colour_sensitivity,
        )


FEWEST_VIEWS: Final = 12
"""Smallest number of given views that is thinned out."""

DEFAULT_PRESET: Final = "balanced"

PRESETS: Final[Mapping[str, Preset]] = MappingProxyType(
    {
        # The ordering and compensation of `balanced` would triple the time of `fast`. Measured on a
        # captured room: ordering a tenth of the splats in pictures of a quarter of the pixels takes
        # a tenth of the time, gives 23.9 dB instead of 24.1 dB in the first 64 KiB, and loses 1 to
        # 2 dB from 128 KiB on.
        "fast": Preset(
            planned_views=64,
            planned_jitter=False,
            views_every=3,
            most_views=20,
            jitter_copies=1,
            sensitivity_every=4,
            prediction_views=4,
            reference_views=24,
            reference_share=0.25,
            reference_jitter=False,
            gain=GainEffort(ordered_ratio=0.17, growth=0.3, views=8),
            fit_iterations=8,
            fit_views=3,
        ),
        "balanced": Preset(
            planned_views=96,
            planned_jitter=True,
            views_every=1,
            most_views=64,
            jitter_copies=1,
            sensitivity_every=2,
            prediction_views=8,
        ),
        "best": Preset(
            planned_views=160,
            planned_jitter=True,
            views_every=1,
            most_views=1024,
            jitter_copies=2,
            sensitivity_every=1,
            prediction_views=24,
            fit_iterations=32,
        ),
    }
)
