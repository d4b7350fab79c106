"""Settings of a scoring pass."""

from __future__ import annotations

from dataclasses import dataclass

from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.render.cuda_device import require_device
from cogsplat.codec.threads import thread_count

TOP_K = 20
"""Number of a pixel's largest weights that count (PRoGS, section 3.1, Zoomers et al. 2024)."""

LEAST_WEIGHT = 0.01
"""Value of `ScoreConfig.least_weight` for scoring without top K. Top K drops no weight above 1/20,
because the weights of a pixel sum to at most 1.

Ordered by either contribution, a captured room differs by less than 0.2 dB in its first 16 to 256
KiB, and files of three scenes by less than 0.5 % in bytes at equal PSNR.
"""


@dataclass(frozen=True)
class ScoreConfig:
    """Settings of `score`.

    Parameters
    ----------
    top_k : int
        Number of the largest weights of each pixel that count in the contribution. 0 counts all
        weights of at least `least_weight`, which is faster.
    least_weight : float
        Minimum of the weights that count in the contribution, 0 to 1; ignored unless `top_k` is 0.
    jitter : bool
        Whether to score jittered copies of the cameras too (`roam_views.jitter`), so that splats
        hidden from the capture path do not score 0.
    jitter_copies : int
        Jittered copies of each camera: 2 for both kinds, 1 for alternating kinds.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    threads : int
        Number of threads; 0 for every core this process may use. Scores do not depend on it.
    sensitivity_every : int
        Interval of the tiles of each view in which `Sensitivities` are measured: one in n tiles,
        others in the next view; 0 for none. At 1 they double the run time.
    colour_sensitivity : bool
        Whether to compute `Scores.colour_sensitivity`, which takes 128 bytes per splat.
    device : str
        ``cpu``, or ``cuda`` to draw the views with gsplat on a CUDA device (extra ``train``). CUDA
        scores differ by rounding, from run to run too, and so does the order of splats with nearly
        equal scores.
    """

    top_k: int = TOP_K
    least_weight: float = 0.0
    jitter: bool = True
    jitter_copies: int = 2
    near_plane: float = NEAR
    threads: int = 0
    sensitivity_every: int = 0
    colour_sensitivity: bool = True
    device: str = "cpu"

    def __post_init__(self) -> None:
        require_finite(self)
        if self.top_k < 0:
            raise ValueError(f"top_k {self.top_k}, expected 0 (all) or more")
        if not 0.0 <= self.least_weight <= 1.0:
            raise ValueError(f"least_weight {self.least_weight}, expected 0 to 1")
        if self.jitter_copies not in (1, 2):
            raise ValueError(f"jitter_copies {self.jitter_copies}, expected 1 or 2")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        thread_count(self.threads)
        require_device(self.device)
        if self.sensitivity_every < 0:
            raise ValueError(
                f"sensitivity_every {self.sensitivity_every}, expected 0 (none) or more"
            )
