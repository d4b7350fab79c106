"""Training settings: losses, learning rates, levels and their request. It imports no kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.threads import thread_count

LOSS_NAMES: Final = ("squared", "photo", "structure")
"""Losses: ``squared`` for renders, ``photo`` for photos, ``structure`` for levels."""

RATES: Final[Mapping[str, float]] = MappingProxyType(
    {
        "means": 0.01,
        "scales": 0.005,
        "quats": 0.002,
        "opacities": 0.03,
        "sh0": 0.005,
        "shN": 0.0015,
    }
)
"""Learning rates by array, as in 3DGS except for means.

The unit of means is the middle axis of each splat: large splats move further than small ones, and
the scale of the scene does not matter."""


@dataclass(frozen=True)
class TrainConfig:
    """Settings of scene training.

    Parameters
    ----------
    loss : str
        One of `LOSS_NAMES`.
    noise : bool
        Whether quantisation errors get a random sign per value and step: additive noise (Ballé et
        al. 2017) in place of straight-through gradients. For comparisons; measured to be worse.
    rates : mapping of str to float
        Learning rates by array; arrays without one are not trained.
    seed : int
        Seed of the order of views.
    threads : int
        Number of threads; 0 uses all cores. The result does not depend on it.
    """

    loss: str = "squared"
    noise: bool = False
    rates: Mapping[str, float] = field(default_factory=lambda: RATES)
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        if self.loss not in LOSS_NAMES:
            raise ValueError(f"loss {self.loss!r}, expected one of {LOSS_NAMES}")
        unknown = self.rates.keys() - RATES.keys()
        if unknown:
            raise ValueError(f"learning rates of {sorted(unknown)}, expected some of {list(RATES)}")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed}, expected 0 or more")
        thread_count(self.threads)


@dataclass(frozen=True)
class LevelsConfig:
    """Settings of a scene with levels: their resolutions, sizes and training, and their encoding.

    Parameters
    ----------
    scales : tuple of int
        Downscaling of the pictures of each level, per axis, descending.
    shares : tuple of float
        Cumulative share of the scene's splats up to each level, ascending to at most 1.
    steps : int
        Training steps per level; each step renders one view.
    loss : str
        One of `LOSS_NAMES`; ``structure`` is the loss of LapisGS.
    quality_db : float
        Nominal quality, dB, 10 to 90.
    opacity_step : float
        Maximum quantiser step of opacities of later levels, in logits.
    chunk_splats : int
        Maximum number of splats per chunk.
    seed : int
        Seed of the order of views.
    threads : int
        Number of threads; 0 uses all cores. The result does not depend on it.
    """

    scales: tuple[int, ...] = (8, 4, 2, 1)
    shares: tuple[float, ...] = (0.08, 0.25, 0.6, 1.0)
    steps: int = 400
    loss: str = "structure"
    quality_db: float = 40.0
    opacity_step: float = 0.1
    chunk_splats: int = 4096
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        if not self.scales or min(self.scales) < 1 or any(a <= b for a, b in pairwise(self.scales)):
            raise ValueError(f"scales {self.scales}, expected whole numbers above 0 that fall")
        if len(self.shares) != len(self.scales):
            raise ValueError(
                f"{len(self.shares)} shares, expected one of {len(self.scales)} levels"
            )
        shares = (0.0, *self.shares)
        if self.shares[-1] > 1 or any(a >= b for a, b in pairwise(shares)):
            raise ValueError(f"shares {self.shares}, expected to rise from above 0 to at most 1")
        if self.steps < 0 or self.seed < 0:
            raise ValueError(f"steps {self.steps}, seed {self.seed}, expected 0 or more")
        if not self.opacity_step > 0:
            raise ValueError(f"opacity step {self.opacity_step}, expected more than 0")
        if self.loss not in LOSS_NAMES:
            raise ValueError(f"loss {self.loss!r}, expected one of {LOSS_NAMES}")
        # The encoder's own checks, before training.
        self.encode_config()

    def encode_config(self) -> EncodeConfig:
        """Return the configuration of the encoder; chunks hold one object label each."""
        return EncodeConfig(
            quality_db=self.quality_db,
            order="contribution",
            ordering=OrderConfig(by_object=True),
            chunk_splats=self.chunk_splats,
            refine=False,
            prune=None,
            compensate=False,
            threads=self.threads,
        )


@dataclass(frozen=True, eq=False)
class LevelsRequest:
    """Inputs of a scene with levels, except its splats.

    Parameters
    ----------
    cameras : sequence of Camera
        Training views at full resolution, in which splats are scored as well.
    config : LevelsConfig
        Levels and their encoding.
    pictures : sequence of (H, W, 3) float32, optional
        Ground truth of each camera at full resolution, 0 to 1. Renders of the splats by default.
    max_splats : int, optional
        Maximum number of splats of all levels, where splats from structure-from-motion points are
        trained. None for a trained scene.
    planned : bool
        Whether the cameras were planned because none were given.

    Raises
    ------
    ValueError
        A maximum below 1, or without pictures.
    """

    cameras: Sequence[Camera]
    config: LevelsConfig = field(default_factory=LevelsConfig)
    pictures: Sequence[NDArray[np.float32]] | None = None
    max_splats: int | None = None
    planned: bool = False

    def __post_init__(self) -> None:
        if self.max_splats is not None and self.max_splats < 1:
            raise ValueError(f"{self.max_splats} splats, expected at least 1")
        if self.max_splats is not None and self.pictures is None:
            raise ValueError("points without pictures, expected the photos of the cameras")
