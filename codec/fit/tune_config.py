"""The configuration of `tuning.tune`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.encode.presets import PRESETS

from .trainer import TrainConfig

# Profiles whose quantisers a scene can be trained through; `near-lossless` bounds errors instead.
_PROFILES: Final = ("transform", "vq")


@dataclass(frozen=True)
class TuneConfig:
    """How a scene is tuned.

    Parameters
    ----------
    keep : float or None
        Share of the splats that is kept; None for what the target allows.
    round_keep : float
        Share that one round of leaving out and training keeps.
    round_steps, recovery_steps, quantised_steps : int
        Steps of training in each round, after the last of them, and through the quantisers.
    refresh : int
        Steps of training through the quantisers between two encodes of the scene.
    rate_weight : float
        How much it counts, while the scene trains through the quantisers, in how many bits its
        values are coded: at 1 a bit is weighed against the error that it would remove elsewhere
        (`bit_slopes.ERROR_PER_BIT`), at 0 it counts nothing. Of a captured room at 1.59 bytes for
        each splat of the source, 1, 3 and 8 bring 0.06, 0.11 and 0.01 dB in 0.3, 0.4 and 0.7 %
        fewer bytes; at 3.8 bytes 1 and 3 bring nothing in 0.3 and 0.6 % fewer.
    prefix_weight : float
        What one per cent less error of prefixes counts, while the scene trains through the
        quantisers, in per cent less error of the whole. 200 more steps with 0.3 brought a captured
        room of 170 kB 0.2 dB in its first 64 and 128 KiB and no loss in the whole, with 2 they
        brought 0.65 and 0.8 dB and took 0.4, with 10 1.1 and 1.15 dB and took 1.5.
    seconds : float or None
        Time that all this may take. Steps after the last round then become fewer or more, and those
        of rounds fewer; the result depends on how fast the machine is.
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
    round_steps: int = 100
    recovery_steps: int = 1000
    quantised_steps: int = 600
    refresh: int = 10
    rate_weight: float = 3.0
    prefix_weight: float = 0.0
    seconds: float | None = None
    preset: str = "fast"
    profile: str = "transform"
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        if self.keep is not None and not 0.0 < self.keep <= 1.0:
            raise ValueError(f"keep {self.keep}, expected above 0 and at most 1")
        if not 0.0 < self.round_keep < 1.0:
            raise ValueError(f"round_keep {self.round_keep}, expected between 0 and 1")
        steps = (self.round_steps, self.recovery_steps, self.quantised_steps, self.refresh)
        if min(steps) < 1:
            raise ValueError(f"steps {steps}, expected at least 1 each")
        if not self.rate_weight >= 0:
            raise ValueError(f"rate_weight {self.rate_weight}, expected 0 or more")
        if not self.prefix_weight >= 0:
            raise ValueError(f"prefix_weight {self.prefix_weight}, expected 0 or more")
        if self.seconds is not None and not self.seconds > 0:
            raise ValueError(f"{self.seconds} seconds, expected more than 0")
        if self.preset not in PRESETS:
            raise ValueError(f"preset {self.preset!r}, expected one of {tuple(PRESETS)}")
        if self.profile not in _PROFILES:
            raise ValueError(f"profile {self.profile!r}, expected one of {_PROFILES}")
