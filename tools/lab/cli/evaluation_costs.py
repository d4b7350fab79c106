"""Expected costs of the stages of ``cogsplat lab evaluate``, for its progress bar."""

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

# Approximate bytes per splat of a COGS file; sets the expected number of prefixes.
_BYTES_A_SPLAT: Final = 9
# Cost of writing and reading a splat in another format, in the unit of `codec.encode.stage_costs`.
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
    """Return the expected costs of the stages after scoring.

    Parameters
    ----------
    splats : Splats
        Scene.
    scored_on, test_views : sequence of Camera
        Cameras that splats are scored in, and test views.
    orders : sequence of str
        Order of every curve.
    sorts : bool
        Whether the orders themselves are measured, rather than files alone.
    shares : int
        Number of prefixes of each order.
    objects : tuple of int or None
        Labels of the objects that are measured; empty for all.
    files : int
        Number of files given; with 0, each order is encoded.
    cut : bool
        Whether files are measured at all.
    lengths : int or None
        Number of prefixes of each file; None for doubled lengths.
    codecs : int
        Number of other formats that each order is written in.
    quality_db : float
        Nominal PSNR of encoded files, dB.
    target_psnr : float or None
        Target PSNR of encoded files, dB.
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
