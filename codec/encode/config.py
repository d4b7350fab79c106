"""The configuration of the encoder, and what can be switched off in it for measuring."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles.near_lossless import NearLosslessBounds
from cogsplat.codec.order import chunk_plan
from cogsplat.codec.order.orders import OrderConfig, require_order
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.streams import limits
from cogsplat.codec.threads import thread_count

PROFILE_NAMES: Final = ("transform", "vq", "near-lossless")
"""Names of the profiles; `profiles.dispatch.PROFILES` holds what they do."""

MIN_QUALITY_DB: Final = 10.0
MAX_QUALITY_DB: Final = 90.0


@dataclass(frozen=True)
class Ablation:
    """Techniques of the `transform` profile, each of which can be switched off for measuring.

    Files of any combination are valid and decode as all others do; only their size and their
    quality differ. The other profiles use none of these techniques.

    Parameters
    ----------
    sensitivities : bool
        What errors of positions, shapes and opacities cost comes from the scoring pass; otherwise
        it is guessed from each splat's energy alone.
    chunk_steps : bool
        Every chunk has steps of its own, by what errors cost there; otherwise one step of each
        attribute serves all chunks.
    fine_means : bool
        Means are quantised as finely as each splat is small; otherwise with one step a chunk.
    fine_rotations : bool
        Rotations are quantised as finely as each shape asks; otherwise with one step a chunk.
    areas : bool
        The longest axis and the opacity make up for areas that coarse scales change.
    colour_basis : bool
        shN is stored by its principal axes; otherwise by its own coefficients.
    view_metric : bool
        Errors of shN are weighed by the directions that it is seen from; otherwise all directions
        count alike.
    sh0_makes_up : bool
        sh0 makes up for what shN loses, as its views see it on average.
    digits : bool
        Planes of few symbols put several of them into a byte before zstd.
    """

    sensitivities: bool = True
    chunk_steps: bool = True
    fine_means: bool = True
    fine_rotations: bool = True
    areas: bool = True
    colour_basis: bool = True
    view_metric: bool = True
    sh0_makes_up: bool = True
    digits: bool = True


@dataclass(frozen=True)
class EncodeConfig:
    """How a scene is encoded.

    Parameters
    ----------
    profile : str
        One of `PROFILE_NAMES`.
    quality_db : float
        Nominal PSNR, dB, of the profiles for viewing: sets all their steps. Where views are
        planned, the steps are corrected to what is measured in planned test views.
    order : str
        One of `orders.ORDERS`, alone or with one of `orders.POSE_RULES`.
    ordering : OrderConfig
        Parameters of the order, and whether chunks hold one object each.
    chunk_splats : int
        Most splats in a chunk.
    cells : bool
        Whether chunks are cut by cells of space as well, finer from layer to layer, so that a
        client can fetch what it looks at; `partition.nested_cells.DEFAULT_CELL_SPLATS` splats in a
        chunk cost hardly more bytes than chunks that are not cut.
    view_table : bool
        Whether scenes that are cut into cells get a table of what the pictures of some viewpoints
        show of each chunk (SPEC 5.12), where they have cameras, given or planned.
    morton : bool
        Whether to sort by Morton code inside the chunk.
    refine : bool
        Whether the heads of the `transform` profile are coarse and refinements bring the rest
        later.
    prune : PruneConfig or None
        What may be dropped; None keeps every splat, as `near-lossless` always does.
    near_lossless : NearLosslessBounds
        Error bounds of the `near-lossless` profile.
    compensate : bool
        Whether the order is made for prefixes that are drawn with compensation, and compensation
        is fitted to the scene's own pictures; the `near-lossless` profile has none.
    training : TrainingConfig
        How the codebooks of the `vq` profile are trained.
    threads : int
        0 uses all cores; the bytes do not depend on it.
    ablation : Ablation
        Techniques of the `transform` profile that are switched off.
    """

    profile: str = "transform"
    quality_db: float = 40.0
    order: str = "gain"
    ordering: OrderConfig = field(default_factory=OrderConfig)
    chunk_splats: int = chunk_plan.DEFAULT_CHUNK_SPLATS
    cells: bool = False
    view_table: bool = True
    morton: bool = True
    refine: bool = True
    prune: PruneConfig | None = field(default_factory=PruneConfig)
    near_lossless: NearLosslessBounds = field(default_factory=NearLosslessBounds)
    compensate: bool = True
    training: TrainingConfig = field(default_factory=TrainingConfig)
    threads: int = 0
    ablation: Ablation = field(default_factory=Ablation)

    def __post_init__(self) -> None:
        if self.profile not in PROFILE_NAMES:
            raise ValueError(f"profile {self.profile!r}, expected one of {PROFILE_NAMES}")
        require_order(self.order, self.ordering)
        if not 1 <= self.chunk_splats <= limits.MAX_CHUNK_SPLATS:
            raise ValueError(
                f"chunks of {self.chunk_splats} splats, expected 1 to {limits.MAX_CHUNK_SPLATS}"
            )
        if self.cells and self.chunk_splats < 2:
            raise ValueError("cells with chunks of 1 splat, expected at least 2")
        if self.cells and self.ordering.by_object:
            raise ValueError("chunks by cell and by object, expected one of them")
        thread_count(self.threads)
        require_quality(self.quality_db)

    def dropping(self) -> PruneConfig | None:
        """Return what may be dropped; `near-lossless` keeps every splat, for it bounds errors."""
        return None if self.profile == "near-lossless" else self.prune


def require_quality(quality_db: float) -> None:
    """Refuse a nominal quality outside what the profiles can reach."""
    if not MIN_QUALITY_DB <= quality_db <= MAX_QUALITY_DB:
        raise ValueError(
            f"quality {quality_db} dB, expected {MIN_QUALITY_DB:g} to {MAX_QUALITY_DB:g}"
        )
