"""What the stages of ``cogsplat lab evaluate`` will cost, for one bar over the whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.objects import ATTRIBUTE
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.progress import StageCost
from cogsplat.codec.splats import Splats
from cogsplat.tools.evaluation.measuring_costs import objects_cost, versions_cost
from cogsplat.tools.lab.evaluation.progs_protocol import SHARES, sizes_of

# Bytes of a splat in a file of ours, roughly: they decide how many prefixes are measured.
_BYTES_A_SPLAT: Final = 9
# Writing and reading a splat in another format, as `codec.encode.stage_costs` counts.
_CODEC: Final = 1e-5


def eval_costs(
    splats: Splats,
    scored_on: Sequence[Camera],
    test_views: Sequence[Camera],
    orders: Sequence[str],
    *,
    sorts: bool,
    shares: int,
    objects: tuple[int, ...] | None,
    files: int,
    cut: bool,
    lengths: int | None,
    codecs: int,
    quality_db: float,
    target_psnr: float | None,
) -> list[StageCost]:
    """Return what comes after scoring.

    Parameters
    ----------
    splats : Splats
    scored_on, test_views : sequence of Camera
        At least one of each.
    orders : sequence of str
        Of every curve.
    sorts : bool
        Whether the orders themselves are measured, rather than files alone.
    shares : int
        Prefixes of each order.
    objects : tuple of int or None
        Objects that are measured; empty for all.
    files : int
        That were given; without any, each order is encoded.
    cut : bool
        Whether files are measured at all.
    lengths : int or None
        Prefixes of each file; None for doubled lengths.
    codecs : int
        Other formats that each order is written in.
    quality_db : float
        Of the files that are encoded.
    target_psnr : float or None
        Of the same.
    """
    from cogsplat.codec.encode.config import EncodeConfig, Target
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.encode.stage_costs import order_costs, stage_costs

    count = len(splats)

    def measured(versions: int, *more: StageCost) -> tuple[StageCost, ...]:
        return *more, StageCost("measure", versions_cost(count, test_views, versions))

    costs: list[StageCost] = []
    if sorts:
        parts = tuple(measured(shares, *order_costs(count, order, scored_on)) for order in orders)
        costs.append(StageCost("orders", 0.0, parts=parts))
    if objects is not None:
        labels = splats.extras.get(ATTRIBUTE)
        several = len(objects) or (0 if labels is None else len(np.unique(labels)))
        versions = len(orders) * (several + 1) * shares
        costs.append(StageCost("objects", objects_cost(count, test_views, versions)))
    if cut:
        cuts = len(sizes_of(count * _BYTES_A_SPLAT)) if lengths is None else lengths
        target = None if target_psnr is None else Target(psnr_db=target_psnr)
        encodes = [
            stage_costs(
                count,
                EncodeRequest(
                    cameras=scored_on,
                    config=EncodeConfig(order=split_name(order)[0], quality_db=quality_db),
                    target=target,
                ),
                scored=True,
            )
            for order in orders
        ]
        parts = tuple(measured(cuts, *encode) for encode in ([[]] * files or encodes))
        costs.append(StageCost("files", 0.0, parts=parts))
    if codecs:
        versions = shares or len(SHARES)
        once = StageCost("write", versions * _CODEC * count)
        costs.append(
            StageCost("codecs", 0.0, parts=(measured(versions, once),) * codecs * len(orders))
        )
    return costs
