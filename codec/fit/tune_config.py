"""Configuration and request of `tuning.tune`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.config import Target
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.finite_fields import require_finite

from .train_config import TrainConfig

if TYPE_CHECKING:
    from .tuning_views import TuningViews

DEFAULT_TARGET: Final = Target(psnr_db=40.0)
"""Target of tuning without a given one."""

# Profiles with quantisers to train through; `near-lossless` bounds errors per value instead.
_PROFILES: Final = ("transform", "vq")


@dataclass(frozen=True)
class TuneConfig:
    """Settings of tuning: steps of each phase, loss weights, preset and profile.

    Parameters
    ----------
    keep : float or None
        Share of the splats to keep; None to derive it from the target.
    round_keep : float
        Share of the splats that one pruning round keeps.
    round_steps, recovery_steps, quantised_steps : int
        Training steps in each pruning round, after the last round, and through the quantisers.
    encode_interval : int
        Training steps between two encodes in quantised training.
    rate_weight : float
        Weight of the rate in the loss of quantised training. At 1, a bit costs the error that it
        would remove elsewhere (`rate_gradients.ERROR_PER_BIT`); 0 ignores the rate. Measured on a
        captured room: at 1.59 bytes per splat of the source, weights 1, 3 and 8 gain 0.06, 0.11 and
        0.01 dB in 0.3, 0.4 and 0.7 % fewer bytes. At 3.8 bytes, weights 1 and 3 gain no PSNR, in
        0.3 and 0.6 % fewer bytes.
    prefix_weight : float
        Weight of the relative error of prefixes against that of the whole scene, in quantised
        training. Measured on a captured room of 170 kB, in 200 more steps: 0.3 gains 0.2 dB in the
        first 64 and 128 KiB at no loss of the whole; 2 gains 0.65 and 0.8 dB and loses 0.4 dB; 10
        gains 1.1 and 1.15 dB and loses 1.5 dB.
    seconds : float or None
        Time limit. Steps of rounds are shortened to meet it, steps after them also extended; the
        result then depends on the speed of the machine.
    preset : str
        Key of `presets.PRESETS`: effort of scoring. Order and compensation have that of ``best``.
    profile : str
        ``transform`` or ``vq``. With ``vq``, codebooks train with the splats: each encode starts
        k-means from the last codebooks and assigns each splat to the nearest row (after Niedermayr
        et al. 2024, section 3.3, with trained means).
    preview : float or None
        Share of the file spent on preview splats, as in `EncodeConfig`.
    train : TrainConfig
        Loss, learning rates, seed and threads.
    """

    keep: float | None = None
    round_keep: float = 0.6
    round_steps: int = 100
    recovery_steps: int = 1500
    quantised_steps: int = 600
    encode_interval: int = 10
    rate_weight: float = 3.0
    prefix_weight: float = 0.0
    seconds: float | None = None
    preset: str = "fast"
    profile: str = "transform"
    preview: float | None = None
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        require_finite(self)
        if self.keep is not None and not 0.0 < self.keep <= 1.0:
            raise ValueError(f"keep {self.keep}, expected above 0 and at most 1")
        if not 0.0 < self.round_keep < 1.0:
            raise ValueError(f"round_keep {self.round_keep}, expected between 0 and 1")
        steps = (self.round_steps, self.recovery_steps, self.quantised_steps, self.encode_interval)
        if min(steps) < 1:
            raise ValueError(f"steps {steps}, expected at least 1 each")
        if not self.rate_weight >= 0:
            raise ValueError(f"rate_weight {self.rate_weight}, expected 0 or more")
        if not self.prefix_weight >= 0:
            raise ValueError(f"prefix_weight {self.prefix_weight}, expected 0 or more")
        if self.seconds is not None and not self.seconds > 0:
            raise ValueError(f"{self.seconds} seconds, expected more than 0")
        if self.preview is not None and not 0.0 < self.preview < 1.0:
            raise ValueError(f"preview {self.preview}, expected above 0 and below 1")
        if self.preset not in PRESETS:
            raise ValueError(f"preset {self.preset!r}, expected one of {tuple(PRESETS)}")
        if self.profile not in _PROFILES:
            raise ValueError(f"profile {self.profile!r}, expected one of {_PROFILES}")


@dataclass(frozen=True, eq=False)
class TuneRequest:
    """Inputs of tuning, except the scene.

    Parameters
    ----------
    views : TuningViews
        Views to train, score and measure in (`tuning_views.choose_tuning_views`).
    target : Target
        PSNR against renders of the source in the test views, or size of the file.
    config : TuneConfig
        Steps of each phase, preset and profile.
    photos : sequence of (H, W, 3) float32, optional
        Ground truth of the given cameras, 0 to 1, one photo per camera in its size. Renders of the
        source by default.
    background : tuple of float
        RGB behind the splats in training and in measurements.
    device : str
        Device of `RenderConfig` for the ground truth and for training.

    Raises
    ------
    ValueError
        Photos for planned views.
    """

    views: TuningViews
    target: Target = DEFAULT_TARGET
    config: TuneConfig = field(default_factory=TuneConfig)
    photos: Sequence[NDArray[np.float32]] | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.photos is not None and self.views.planned:
            raise ValueError("photos for planned views, expected the cameras of the photos")
