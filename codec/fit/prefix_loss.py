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

# Keeps ratios of errors finite: that of a PSNR of 60 dB.
_LEAST_ERROR: Final = 1e-6


@dataclass(frozen=True, eq=False)
class PrefixLoss:
    """PrefixLoss that are drawn beside the whole scene while it is trained.

    Parameters
    ----------
    rows : sequence of (n,) int64
        The splats of each.
    inflations : sequence of Inflation
        With what each is drawn: what is usual for the splats that it lacks.
    weight : float
        What one per cent less error of a prefix counts, in per cent less error of the whole scene.
    """

    rows: Sequence[NDArray[np.int64]]
    inflations: Sequence[Inflation]
    weight: float

    @classmethod
    def for_layers(
        cls, chunk_rows: Sequence[NDArray[np.int64]], effective_splats: int, weight: float
    ) -> PrefixLoss:
        """Return the prefixes that the layers of a compensation are made for.

        Parameters
        ----------
        chunk_rows : sequence of (n,) int64
            The splats of each chunk.
        effective_splats : int
            Of the scene (`prefix_inflation.effective_splats`).
        weight : float
            As the class takes it.
        """
        layers = plan_layers([len(rows) for rows in chunk_rows], effective_splats)
        prefixes = [np.concatenate(chunk_rows[:chunks]) for chunks in layers]
        parts = [len(rows) / effective_splats for rows in prefixes]
        return cls(prefixes, [prefix_inflation.typical(part) for part in parts], weight)

    def add_gradients(
        self,
        shown: Splats,
        camera: Camera,
        config: RenderConfig,
        picture: NDArray[np.float32],
        *,
        loss: str,
        error: float,
        rng: np.random.Generator,
        gradients: Gradients,
    ) -> None:
        """Draw one of the prefixes; add what its picture asks for to the gradients.

        Parameters
        ----------
        shown : Splats
            The whole scene, as it is drawn.
        camera : Camera
        config : RenderConfig
        picture : (H, W, 3) float32
            What the prefix should look like.
        loss : str
            One of `losses.LOSSES`.
        error : float
            Mean squared error of the whole scene in this view.
        rng : Generator
            Decides which is drawn.
        gradients : Gradients
            Of the whole scene; changed in place.
        """
        if not self.rows:
            return
        number = int(rng.integers(len(self.rows)))
        rows = self.rows[number]
        prefix = prefix_inflation.inflate(shown.take(rows), self.inflations[number])
        drawing = render_forward(prefix, camera, config)
        own, by_picture = LOSSES[loss](drawing.picture, picture)
        by_picture *= np.float32(self.weight * error / max(own, _LEAST_ERROR))
        found = Gradients.zeros(prefix)
        drawing.backward(by_picture, found)
        gradients.add(found, rows)
