"""The table of profiles: from a scene in its chunks to what encodes one chunk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from cogsplat.codec.encode.encoded import EncodedCodebook
from cogsplat.codec.encode.prepared import LaidOutScene
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate import allocation, segment_order
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.segments.payloads import Payloads

from . import near_lossless, transform, vq


def _no_chunk(run: slice) -> Payloads:
    raise ValueError(f"rows {run.start}:{run.stop} of a scene without rows, expected none")


@dataclass(frozen=True, eq=False)
class PlannedScene:
    """What all chunks of a scene share, and what encodes one of them.

    Parameters
    ----------
    codebooks : sequence of EncodedCodebook
    encode_chunk : callable
        Takes the rows of a chunk as a slice of the ordered scene; several threads call it.
    """

    codebooks: Sequence[EncodedCodebook] = ()
    encode_chunk: Callable[[slice], Payloads] = _no_chunk


class Profile(Protocol):
    """Plans a scene of at least one row at a nominal quality, dB."""

    def __call__(self, scene: LaidOutScene, quality_db: float, progress: Progress) -> PlannedScene:
        """Return the codebooks of the scene and what encodes its chunks."""
        ...


def _near_lossless(scene: LaidOutScene, quality_db: float, progress: Progress) -> PlannedScene:
    ordered, config = scene.ordered.without_extras(), scene.config
    bound = near_lossless.mean_bound(ordered, config.near_lossless)
    return PlannedScene(
        encode_chunk=lambda run: near_lossless.encode_chunk(
            ordered.take(run), bound, config.near_lossless, config.morton
        )
    )


def _transform(scene: LaidOutScene, quality_db: float, progress: Progress) -> PlannedScene:
    ordered, config = vq.clip_strays(scene.ordered.without_extras()), scene.config
    scores = (
        scene.scores if config.ablation.sensitivities else replace(scene.scores, sensitivities=None)
    )
    known = replace(scores, sensitivities=None).take(scene.rows)
    energy, contribution = rate_costs.floor_energy(known), known.contribution

    def own_costs(run: slice) -> Costs:
        return rate_costs.costs(ordered.take(run), scores.take(scene.rows[run]), energy[run])

    costs_of: Callable[[slice], Costs] = own_costs
    if not config.ablation.chunk_steps:
        level = own_costs(slice(0, len(scene.rows))).levelled()
        energy, costs_of = level.energy, level.take
    plan = transform.plan(
        ordered,
        costs_of,
        energy,
        scene.scores.basis_spread,
        allocation.lagrangian(scene.scores, quality_db),
        scene.slices,
        config.ablation,
        contribution if config.refine else None,
        segment_order.MISSING_COMPENSATED if config.compensate else segment_order.MISSING_ALL,
    )
    codebooks = []
    if plan.basis is not None:
        codebooks = [EncodedCodebook("colour", len(plan.basis.rows), plan.basis_payloads)]
    return PlannedScene(
        codebooks, lambda run: transform.encode_chunk(ordered, plan, run, config.morton)
    )


def _vq(scene: LaidOutScene, quality_db: float, progress: Progress) -> PlannedScene:
    ordered, config = vq.clip_strays(scene.ordered.without_extras()), scene.config
    plan = vq.plan(
        ordered,
        rate_costs.floor_energy(scene.scores)[scene.rows],
        allocation.lagrangian(scene.scores, quality_db),
        training=config.training,
        threads=config.threads,
        progress=progress,
    )
    codebooks = [EncodedCodebook("shape", plan.shape_rows, (plan.shape_payload,))]
    if plan.colour_rows:
        codebooks.append(EncodedCodebook("colour", plan.colour_rows, plan.colour_payloads))
    return PlannedScene(
        codebooks,
        lambda run: vq.encode_chunk(ordered, plan, np.arange(run.start, run.stop), config.morton),
    )


PROFILES: Final[Mapping[str, Profile]] = MappingProxyType(
    {"transform": _transform, "vq": _vq, "near-lossless": _near_lossless}
)
"""The profiles by the names that `EncodeConfig.profile` takes."""
