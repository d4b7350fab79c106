"""Table of profiles: each plans a scene and encodes its chunks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.prepared import ChunkedScene
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate import segment_order
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.segments.codebooks import ColourCodebook, EncodedCodebook, ShapeCodebook
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats

from . import colour_codebook, near_lossless, outliers, shape_codebook, transform
from .shapes import ShapeSource


def _no_chunk(run: slice) -> Payloads:
    """Refuse to encode a chunk of a scene without rows."""
    raise ValueError(f"rows {run.start}:{run.stop} of a scene without rows, expected none")


@dataclass(frozen=True, eq=False)
class PlannedScene:
    """Codebooks of a scene, and the encoder of its chunks.

    Parameters
    ----------
    codebooks : sequence of EncodedCodebook
        Codebooks that the chunks share.
    encode_chunk : callable
        Encodes a chunk, given as a slice of the ordered scene. Its payloads are not compressed yet
        (`Payloads.compress`); several threads call it.
    """

    codebooks: Sequence[EncodedCodebook] = ()
    encode_chunk: Callable[[slice], Payloads] = _no_chunk


class Profile(Protocol):
    """Planner of a profile: prepares the codebooks and chunk encoder of a scene."""

    def __call__(self, scene: ChunkedScene, quality_db: float, progress: Progress) -> PlannedScene:
        """Return the codebooks of the scene and the encoder of its chunks.

        Parameters
        ----------
        scene : ChunkedScene
            Scene of at least one row.
        quality_db : float
            Nominal PSNR, dB.
        progress : Progress
            Called with ``codebooks`` where they are trained.
        """
        ...


def _near_lossless(scene: ChunkedScene, quality_db: float, progress: Progress) -> PlannedScene:
    """Plan the profile `near-lossless`."""
    config = scene.config
    bound = near_lossless.means_bound_of(scene.source.scales[scene.rows], config.near_lossless)
    return PlannedScene(
        encode_chunk=lambda run: near_lossless.encode_chunk(
            scene.part(run).without_extras(), bound, config.near_lossless, config.morton
        )
    )


def _transform(scene: ChunkedScene, quality_db: float, progress: Progress) -> PlannedScene:
    """Plan the profile `transform`, and `vq`: the same, with codebooks where they gain."""
    source, config, workspace = scene.source.without_extras(), scene.config, scene.workspace
    scores = (
        scene.scores if config.ablation.sensitivities else replace(scene.scores, sensitivities=None)
    )
    energy = rate_costs.positive_energy(scores, scene.rows)
    lagrangian, coarsest = scene.lagrangian, rate_costs.coarsest_colour(scores)

    def part(run: slice) -> Splats:
        """Return the splats of a range of rows, with outliers clipped."""
        return outliers.clip_outliers(workspace.take(source, scene.rows[run]))

    def coefficients_of(run: slice) -> NDArray[np.float32]:
        """Return the SH coefficients of a range of rows, with outliers clipped."""
        return outliers.clip_coefficients(workspace.gather(source.shN, scene.rows[run]))

    def own_costs(run: slice) -> Costs:
        """Return the costs of a range of rows, with no colour step beyond the coarsest."""
        rows = scene.rows[run]
        found = rate_costs.costs(part(run), scores.take(rows, workspace.gather), energy[run])
        limited = rate_costs.limit_colour_steps(found.energy, lagrangian, coarsest)
        return replace(found, energy=limited)

    costs_of: Callable[[slice], Costs] = own_costs
    colour_costs = rate_costs.limit_colour_steps(energy, lagrangian, coarsest)
    if not config.ablation.chunk_steps:
        level = own_costs(slice(0, len(scene.rows))).equalise()
        colour_costs, costs_of = level.energy, level.take
    plan = transform.plan(
        source.sh_degree,
        coefficients_of,
        costs_of,
        colour_costs,
        scene.scores.basis_spread,
        lagrangian,
        scene.slices,
        config.ablation,
        scores.contribution[scene.rows] if config.refine else None,
        segment_order.MISSING_COMPENSATED if config.compensate else segment_order.MISSING_ALL,
        scene.basis,
    )
    if config.profile == "vq":
        # A basis has at most one row per coefficient; the codebook of shN stands behind it.
        earlier = {book.attribute: book for book in scene.codebooks}
        shapes, colours = (
            earlier[name].decode(source.sh_degree) if name in earlier else None
            for name in ("shape", "colour")
        )
        if plan.basis is not None:
            codebook = colour_codebook.fit(
                plan.basis,
                coefficients_of,
                colour_costs,
                lagrangian,
                scene.slices,
                config.training,
                colours.shN if isinstance(colours, ColourCodebook) else None,
            )
            if codebook is not None:
                plan = plan.with_codebook(codebook, len(scene.slices))
        plan = replace(
            plan,
            shapes=shape_codebook.fit(
                lambda run: ShapeSource.of(part(run), costs_of(run), lagrangian),
                lagrangian,
                scene.slices,
                config.training,
                shapes if isinstance(shapes, ShapeCodebook) else None,
            ),
        )
        progress("codebooks", 1, 1)
    return PlannedScene(
        plan.codebooks, lambda run: transform.encode_chunk(part(run), plan, run, config.morton)
    )


PROFILES: Final[Mapping[str, Profile]] = MappingProxyType(
    {"transform": _transform, "vq": _transform, "near-lossless": _near_lossless}
)
"""Profiles by the names of `EncodeConfig.profile`."""
