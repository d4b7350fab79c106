"""Presets: how many views a scene is scored and measured in before it is encoded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.scoring.contribution import LEAST_WEIGHT, ScoreConfig
from cogsplat.codec.scoring.reference_views import PICTURE_PIXELS
from cogsplat.codec.views.planner import ViewPlanConfig
from cogsplat.codec.views.view_sets import sample_evenly

from .shift_optimiser import FitConfig


@dataclass(frozen=True)
class Preset:
    """How many views are planned, scored and predicted in, and the defaults of what renders.

    Parameters
    ----------
    planned_views : int
        Views of a scene that comes without cameras.
    planned_jitter : bool
        Whether their jittered copies are scored as well. Where less time is to be spent, it is
        these that are left out, not places: what no view shows, nothing makes up for.
    views_every : int
        One of so many of the given views is scored, with its jittered copies.
    most_views : int
        And so many at most: what one more view tells falls with their number, what it costs does
        not.
    jitter_copies : int
        `ScoreConfig.jitter_copies`.
    sensitivity_every : int
        `ScoreConfig.sensitivity_every` of the profile that uses sensitivities.
    prediction_views : int
        Views that the quality of prefixes is predicted in, at most.
    test_views : int
        Views that the quality of the whole is predicted in, and a nominal quality corrected, at
        most: a mean over few depends on which they are.
    reference_views : int
        Cameras that reference views are drawn of, at most; never more than
        `reference_views.MAX_VIEWS`.
    reference_pixels : int
        Most pixels of a reference view, which gains and compensation are measured in.
    reference_jitter : bool
        Whether there are reference views from the jittered copies of the cameras as well.
    gain : GainEffort
        How far the order by marginal gain goes, and in what steps.
    fit_iterations : int
        Steps that compensation is fitted in, for each of its layers.
    fit_views : int
        Views that each of them renders.
    fit_coded_share : float
        `FitConfig.coded_share`.
    """

    planned_views: int
    planned_jitter: bool
    views_every: int
    most_views: int
    jitter_copies: int
    sensitivity_every: int
    prediction_views: int
    test_views: int = 32
    reference_views: int = 1024
    reference_pixels: int = PICTURE_PIXELS
    reference_jitter: bool = True
    gain: GainEffort = field(default_factory=GainEffort)
    fit_iterations: int = 16
    fit_views: int = 4
    fit_coded_share: float = 0.65

    def views(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Return the given views to score on, evenly spread; of a few views, all."""
        every = min(self.views_every, max(len(cameras) // FEWEST_VIEWS, 1))
        return sample_evenly(cameras, min(-(-len(cameras) // every), self.most_views))

    def plan_config(self, threads: int = 0) -> ViewPlanConfig:
        """Return how to plan the views of a scene that comes without cameras."""
        return ViewPlanConfig(views=self.planned_views, threads=threads)

    def fit_config(self, threads: int = 0) -> FitConfig:
        """Return how to fit compensation."""
        return FitConfig(
            iterations=self.fit_iterations,
            views=self.fit_views,
            coded_share=self.fit_coded_share,
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
        """Return how to score for a profile.

        Parameters
        ----------
        profile : str
            One of `config.PROFILE_NAMES`; only ``transform`` uses sensitivities.
        top_k : int or None
            As `ScoreConfig` has it; None for all weights of at least `LEAST_WEIGHT`.
        jitter, threads, colour_sensitivity
            As `ScoreConfig` has them; no profile of ours uses the last.
        """
        every = self.sensitivity_every if profile == "transform" else 0
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
"""Fewer given views than this are never thinned out further."""

DEFAULT_PRESET: Final = "balanced"

PRESETS: Final[Mapping[str, Preset]] = MappingProxyType(
    {
        # Ordered and compensated as the others are, it would take three times as long. On a
        # captured room the order of a tenth, in pictures of a quarter of the pixels, shows nearly
        # as much in the first 64 KiB (23.9 dB, the others 24.1) for a tenth of the time, and 1 to
        # 2 dB less from 128 KiB on. With codes for a fifth of the effective splats in place of two
        # thirds, the file is 0.7 % smaller.
        "fast": Preset(
            planned_views=64,
            planned_jitter=False,
            views_every=3,
            most_views=20,
            jitter_copies=1,
            sensitivity_every=2,
            prediction_views=4,
            test_views=20,
            reference_views=24,
            reference_pixels=PICTURE_PIXELS // 4,
            reference_jitter=False,
            gain=GainEffort(until=0.1, growth=0.3, views=8),
            fit_iterations=8,
            fit_views=3,
            fit_coded_share=0.2,
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
