"""Openings: first chunks that stand for the whole scene until more of it has come (SPEC 5.10)."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from cogsplat.codec.progress import Progress
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.attributes import pack_attributes

from .encoded import EncodedScene


class Opening(Protocol):
    """Makes the first chunks of a scene whose other chunks are encoded."""

    def added(
        self,
        encoded: EncodedScene,
        references: ReferenceViews,
        effective_splats: int,
        *,
        progress: Progress,
    ) -> EncodedScene:
        """Return the scene with them, before its compensation is fitted.

        Parameters
        ----------
        encoded : EncodedScene
        references : ReferenceViews
            Pictures of what was encoded.
        effective_splats : int
            Of the source (`prefix_inflation.effective_splats`).
        progress : Progress
        """
        ...

    def foreseen(self, encoded: EncodedScene) -> EncodedScene:
        """Return a scene with chunks that take the room of those that `added` will make."""
        ...


def with_first_chunks(encoded: EncodedScene, opening: EncodedScene, until: int) -> EncodedScene:
    """Return an encoded scene with the chunks of another before its own, which end.

    Parameters
    ----------
    encoded : EncodedScene
        Without compensation.
    opening : EncodedScene
        Of SH degree 0; its chunks are heads that need no codebook.
    until : int
        Prefixes of so many of the new scene's chunks, and of more, do not draw it.
    """
    own = len(opening.chunks)
    chunks = [
        replace(chunk, until=until, contribution=0.0, attributes=_attributes(encoded, chunk.splats))
        for chunk in opening.chunks
    ]
    prefix_mse = encoded.prefix_mse
    if prefix_mse is not None:
        # The other segments keep the order that they have without an opening.
        prefix_mse = np.concatenate([np.full(own, prefix_mse[0]), prefix_mse])
    first, later = opening.decoded, encoded.decoded
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
        splats=encoded.splats + opening.splats,
        box=np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)]),
        chunks=[*chunks, *encoded.chunks],
        decoded=decoded,
        prefix_mse=prefix_mse,
    )


def _attributes(encoded: EncodedScene, splats: int) -> bytes | None:
    """Return extra attributes of splats that the scene itself does not have: zeros."""
    extras = encoded.scene.extras
    if not extras:
        return None
    return pack_attributes(
        {
            name: np.zeros((splats, *values.shape[1:]), values.dtype)
            for name, values in extras.items()
        }
    )
