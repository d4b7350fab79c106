"""How a scene is encoded: the options of the pipeline."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles.near_lossless import NearLosslessBounds
from cogsplat.codec.order import chunks as chunking
from cogsplat.codec.order.orders import OrderConfig, require_order
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.streams import limits
from cogsplat.codec.threads import thread_count

from .ablation import Ablation

PROFILES: Final = ("transform", "vq", "near-lossless")
MIN_QUALITY_DB: Final = 10.0
MAX_QUALITY_DB: Final = 90.0


@dataclass(frozen=True)
class EncodeConfig:
    """How a scene is encoded.

    Parameters
    ----------
    profile : str
        One of `PROFILES`.
    quality_db : float
        Nominal PSNR, dB, of the profiles for viewing: sets all their steps.
    order : str
        One of `orders.ORDERS`, alone or with one of `orders.POSE_RULES`.
    ordering : OrderConfig
        Parameters of the order; chunks of one object each.
    chunk_splats : int
        Most splats in a chunk.
    morton : bool
        Whether to sort by Morton code inside the chunk.
    refine : bool
        Whether the heads of the `transform` profile are coarse and refinements bring the rest
        later.
    prune : PruneConfig or None
        What may be dropped; None keeps every splat, as `near-lossless` always does.
    near : NearBounds
        Error bounds of the `near-lossless` profile.
    compensate : bool
        Whether the order is made for prefixes that are drawn with compensation. Fitting that
        takes what is encoded, and views: `compensation_fit.compensated`.
    training : TrainingConfig
    threads : int
        0 uses all cores; the bytes do not depend on it.
    ablation : Ablation
        What the `transform` profile does without, for measuring.
    """

    profile: str = "transform"
    quality_db: float = 40.0
    order: str = "gain"
    ordering: OrderConfig = field(default_factory=OrderConfig)
    chunk_splats: int = chunking.DEFAULT_LARGEST
    morton: bool = True
    refine: bool = True
    prune: PruneConfig | None = field(default_factory=PruneConfig)
    near_lossless: NearLosslessBounds = field(default_factory=NearLosslessBounds)
    compensate: bool = True
    training: TrainingConfig = field(default_factory=TrainingConfig)
    threads: int = 0
    ablation: Ablation = field(default_factory=Ablation)

    def __post_init__(self) -> None:
        if self.profile not in PROFILES:
            raise ValueError(f"profile {self.profile!r}, expected one of {PROFILES}")
        require_order(self.order, self.ordering)
        if not 1 <= self.chunk_splats <= limits.MAX_CHUNK_SPLATS:
            raise ValueError(
                f"chunks of {self.chunk_splats} splats, expected 1 to {limits.MAX_CHUNK_SPLATS}"
            )
        thread_count(self.threads)
        require_quality(self.quality_db)

    def dropping(self) -> PruneConfig | None:
        """Return what may be dropped; an archive keeps all: what is not there has no bound."""
        return None if self.profile == "near-lossless" else self.prune


def require_quality(quality_db: float) -> None:
    """Refuse a nominal quality outside what the profiles can reach."""
    if not MIN_QUALITY_DB <= quality_db <= MAX_QUALITY_DB:
        raise ValueError(
            f"quality {quality_db} dB, expected {MIN_QUALITY_DB:g} to {MAX_QUALITY_DB:g}"
        )
