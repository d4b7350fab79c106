"""Encoder configuration: profile, quality, order and contents of a file, without numba."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles.near_lossless import NearLosslessBounds
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.order import chunk_plan
from cogsplat.codec.order.orders import OrderConfig, split_name
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS
from cogsplat.codec.threads import thread_count

PROFILE_NAMES: Final = ("transform", "vq", "near-lossless")
"""Names of the profiles; `profiles.dispatch.PROFILES` holds what they do."""

MIN_QUALITY_DB: Final = 10.0
MAX_QUALITY_DB: Final = 90.0
MIN_PSNR_DB: Final = 5.0
"""Lowest target PSNR; the highest is `MAX_QUALITY_DB`."""


@dataclass(frozen=True)
class Ablation:
    """Techniques of the profiles for viewing, each of which can be switched off for an ablation.

    Every combination gives a valid file that decodes as usual; only size and quality differ. The
    profile `near-lossless` uses none of these techniques.

    Parameters
    ----------
    sensitivities : bool
        Measure the cost of position, shape and opacity errors in the scoring pass; otherwise
        estimate it from each splat's energy.
    chunk_steps : bool
        Choose quantiser steps per chunk from its error costs; otherwise one step per attribute.
    fine_means : bool
        Quantise each mean in proportion to its splat's size; otherwise one step per chunk.
    fine_rotations : bool
        Quantise each rotation by the anisotropy of its splat; otherwise one step per chunk.
    areas : bool
        Correct the longest axis and the opacity for the area change of coarse scales.
    colour_basis : bool
        Store shN in its principal axes; otherwise store its own coefficients.
    view_metric : bool
        Weigh shN errors by the directions of the scoring views; otherwise all directions equally.
    sh0_makes_up : bool
        Add the mean shN error over the scoring views to sh0.
    digits : bool
        Pack several symbols of a small alphabet into one byte before zstd.
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
class Target:
    """Target of an encode: either a PSNR or a file size.

    Parameters
    ----------
    psnr_db : float or None
        Mean PSNR against renders of the source in the test views, dB, 5 to 90.
    size_bytes : int or None
        File size in bytes, never exceeded.
    """

    psnr_db: float | None = None
    size_bytes: int | None = None

    def __post_init__(self) -> None:
        require_finite(self)
        if (self.psnr_db is None) == (self.size_bytes is None):
            raise ValueError(f"{self}, expected either a PSNR or a size")
        if self.psnr_db is not None and not MIN_PSNR_DB <= self.psnr_db <= MAX_QUALITY_DB:
            raise ValueError(
                f"a PSNR of {self.psnr_db} dB, expected {MIN_PSNR_DB:g} to {MAX_QUALITY_DB:g}"
            )
        if self.size_bytes is not None and self.size_bytes < 1:
            raise ValueError(f"a size of {self.size_bytes}, expected at least 1 byte")


@dataclass(frozen=True)
class EncodeConfig:
    """Encoder settings that decide what a file contains.

    Parameters
    ----------
    profile : str
        One of `PROFILE_NAMES`.
    quality_db : float
        Nominal PSNR, dB, of the profiles for viewing; sets all quantiser steps. With planned views
        the steps are corrected to the PSNR measured in planned test views.
    order : str
        One of `orders.ORDERS`, alone or with one of `orders.POSE_RULES`.
    ordering : OrderConfig
        Parameters of the order; also whether each chunk holds a single object.
    chunk_splats : int
        Splats per chunk at most.
    cells : bool
        Cut chunks by nested cells of space, finer from layer to layer, so that a client can fetch
        the cells in view. Regions that views tell apart, such as rooms, have layers of their own.
        Chunks of `partition.nested_cells.DEFAULT_CELL_SPLATS` splats cost hardly more bytes than
        chunks without cells.
    view_table : bool
        Store what is seen of each chunk all around some viewpoints (SPEC 5.12), where views tell
        regions apart; needs `cells`.
    morton : bool
        Sort the splats of each chunk by Morton code.
    refine : bool
        Write coarse heads, and refinements later in the file; not with `near-lossless`.
    prune : PruneConfig or None
        Settings of pruning, which drops splats that hardly change the pictures. None keeps all
        splats, as `near-lossless` always does.
    near_lossless : NearLosslessBounds
        Error bounds of the profile `near-lossless`.
    compensate : bool
        Fit prefix compensation to renders of the source, and order for compensated prefixes. The
        profile `near-lossless` has no compensation.
    preview : float or None
        Share of the file, above 0 and below 1, spent on preview splats: few trained splats at the
        front that show the whole scene until more of it has loaded. None for no preview.
    training : TrainingConfig
        Codebook training of the profile `vq`.
    threads : int
        Number of threads, 0 for all cores; the bytes do not depend on it.
    ablation : Ablation
        Techniques of the profiles for viewing that are switched off.
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
    preview: float | None = None
    training: TrainingConfig = field(default_factory=TrainingConfig)
    threads: int = 0
    ablation: Ablation = field(default_factory=Ablation)

    def __post_init__(self) -> None:
        require_finite(self)
        if self.profile not in PROFILE_NAMES:
            raise ValueError(f"profile {self.profile!r}, expected one of {PROFILE_NAMES}")
        split_name(self.order)
        if not 1 <= self.chunk_splats <= MAX_CHUNK_SPLATS:
            raise ValueError(
                f"chunks of {self.chunk_splats} splats, expected 1 to {MAX_CHUNK_SPLATS}"
            )
        if self.cells and self.chunk_splats < 2:
            raise ValueError("cells with chunks of 1 splat, expected at least 2")
        if self.cells and self.ordering.by_object:
            raise ValueError("chunks by cell and by object, expected one of them")
        if self.preview is not None:
            if not 0.0 < self.preview < 1.0:
                raise ValueError(f"preview {self.preview}, expected above 0 and below 1")
            if not self.compensates:
                raise ValueError(
                    "a preview without compensation, expected a profile that compensates"
                )
            if self.cells or self.ordering.by_object:
                raise ValueError("a preview with cells or objects, expected one of them")
        thread_count(self.threads)
        require_quality(self.quality_db)

    @property
    def compensates(self) -> bool:
        """Whether prefix compensation is fitted where the scene has views."""
        return self.compensate and self.profile != "near-lossless"

    @property
    def pruning(self) -> PruneConfig | None:
        """Pruning settings; None for `near-lossless`, which keeps every splat."""
        return None if self.profile == "near-lossless" else self.prune


def require_quality(quality_db: float) -> None:
    """Refuse a nominal quality outside the range of the profiles.

    Parameters
    ----------
    quality_db : float
        Nominal PSNR, dB.
    """
    if not MIN_QUALITY_DB <= quality_db <= MAX_QUALITY_DB:
        raise ValueError(
            f"quality {quality_db} dB, expected {MIN_QUALITY_DB:g} to {MAX_QUALITY_DB:g}"
        )
