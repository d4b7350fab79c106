"""Training loss of prefixes: each prefix of a scene should look like the whole scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.compensation_fit import plan_layers
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.order.prefix_inflation import Inflation
from cogsplat.codec.render.rasteriser import RenderConfig
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients, render_forward
from .image_losses import LOSSES

# Lower bound of a prefix's mean squared error (60 dB PSNR): keeps error ratios finite.
_MIN_ERROR: Final = 1e-6


@dataclass(frozen=True, eq=False)
class PrefixLoss:
    """Loss of randomly chosen prefixes, one per training step.

    Parameters
    ----------
    rows : sequence of (n,) int64
        Splats of each prefix.
    inflations : sequence of Inflation
        Inflation that each prefix is rendered with, as a stand-in for compensation.
    weight : float
        Weight of the relative error of a prefix against the relative error of the whole scene.
    """

    rows: Sequence[NDArray[np.int64]]
    inflations: Sequence[Inflation]
    weight: float

    @classmethod
    def for_layers(
        cls, chunk_rows: Sequence[NDArray[np.int64]], effective_splats: int, weight: float
    ) -> PrefixLoss:
        """Make the loss of the prefixes that compensation layers are fitted for.

        Parameters
        ----------
        chunk_rows : sequence of (n,) int64
            Splats of each chunk.
        effective_splats : int
            Effective number of splats of the scene (`prefix_inflation.effective_splats`).
        weight : float
            Parameter `weight` of the class.
        """
        layers = plan_layers([len(rows) for rows in chunk_rows], effective_splats)
        prefixes = [np.concatenate(chunk_rows[:chunks]) for chunks in layers]
        shares = [len(rows) / effective_splats for rows in prefixes]
        return cls(prefixes, [prefix_inflation.best_inflation(share) for share in shares], weight)

    def add_gradients(
        self,
        scene: Splats,
        camera: Camera,
        config: RenderConfig,
        picture: NDArray[np.float32],
        *,
        loss: str,
        error: float,
        rng: np.random.Generator,
        gradients: Gradients,
    ) -> None:
        """Render one randomly chosen prefix in a view and add the gradients of its loss.

        Parameters
        ----------
        scene : Splats
            Whole scene, with decoded values where training is quantised.
        camera : Camera
            View that is rendered.
        config : RenderConfig
            Render settings of the view.
        picture : (H, W, 3) float32
            Ground truth of the view.
        loss : str
            Key of `image_losses.LOSSES`.
        error : float
            Mean squared error of the whole scene in this view; scales the gradients.
        rng : Generator
            Chooses the prefix.
        gradients : Gradients
            Gradients of the whole scene, changed in place.
        """
        if not self.rows:
            return
        number = int(rng.integers(len(self.rows)))
        rows = self.rows[number]
        prefix = prefix_inflation.inflate(scene.take(rows), self.inflations[number])
        forward = render_forward(prefix, camera, config)
        prefix_error, by_picture = LOSSES[loss](forward.picture, picture)
        by_picture *= np.float32(self.weight * error / max(prefix_error, _MIN_ERROR))
        prefix_gradients = Gradients.zeros(prefix)
        forward.backward(by_picture, prefix_gradients)
        gradients.add(prefix_gradients, rows)
