"""Preview chunks: few splats at the front of a file that show the whole scene (SPEC 5.10)."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from cogsplat.codec.progress import Progress
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.attributes import pack_attributes

from .encoded import EncodedScene


class PreviewMaker(Protocol):
    """Interface of a maker of preview chunks for an encoded scene."""

    def add(
        self,
        encoded: EncodedScene,
        references: ReferenceViews,
        effective_splats: int,
        *,
        progress: Progress,
    ) -> EncodedScene:
        """Return the scene with preview chunks prepended; its compensation is fitted later.

        Parameters
        ----------
        encoded : EncodedScene
            Scene without compensation.
        references : ReferenceViews
            Ground truth: renders of the source.
        effective_splats : int
            Effective number of splats of the source (`prefix_inflation.effective_splats`).
        progress : Progress
            Receives the stage ``preview``.
        """
        ...

    def reserve(self, encoded: EncodedScene) -> EncodedScene:
        """Return the scene with placeholder chunks of the preview's largest size.

        Parameters
        ----------
        encoded : EncodedScene
            Scene without preview.
        """
        ...


def prepend_preview(encoded: EncodedScene, preview: EncodedScene, until: int) -> EncodedScene:
    """Return an encoded scene with preview chunks before its own chunks.

    Parameters
    ----------
    encoded : EncodedScene
        Scene without compensation.
    preview : EncodedScene
        Preview splats of SH degree 0, in chunks that have heads only and use no codebook.
    until : int
        Chunk count, preview included, from which on a prefix no longer draws the preview.
    """
    own = len(preview.chunks)
    chunks = [
        replace(chunk, until=until, contribution=0.0, attributes=_attributes(encoded, chunk.splats))
        for chunk in preview.chunks
    ]
    prefix_mse = encoded.prefix_mse
    if prefix_mse is not None:
        # The other segments keep the order that they have without a preview.
        prefix_mse = np.concatenate([np.full(own, prefix_mse[0]), prefix_mse])
    first, later = preview.decoded, encoded.decoded
    without = np.zeros((len(first), *later.shN.shape[1:]), np.float32)
    decoded = replace(
        later,
        means=np.concatenate([first.means, later.means]),
        scales=np.concatenate([first.scales, later.scales]),
        quats=np.concatenate([first.quats, later.quats]),
        opacities=np.concatenate([first.opacities, later.opacities]),
        sh0=np.concatenate([first.sh0, later.sh0]),
        shN=np.concatenate([without, later.shN]),
    )
    boxes = np.array([encoded.box, *(chunk.box for chunk in chunks)])
    return replace(
        encoded,
        splats=encoded.splats + preview.splats,
        box=np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)]),
        chunks=[*chunks, *encoded.chunks],
        decoded=decoded,
        prefix_mse=prefix_mse,
    )


def _attributes(encoded: EncodedScene, splats: int) -> bytes | None:
    """Return the attribute payload of preview splats: zeros; None without extra attributes."""
    extras = encoded.scene.extras
    if not extras:
        return None
    return pack_attributes(
        {
            name: np.zeros((splats, *values.shape[1:]), values.dtype)
            for name, values in extras.items()
        }
    )
