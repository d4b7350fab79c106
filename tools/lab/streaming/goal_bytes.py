"""Bytes needed to hold a PSNR along a trace, independent of the link."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent

from .client import fetch_order
from .comparison import Simulation
from .traces import Trace


def bytes_to_hold_goal(
    simulation: Simulation,
    trace: Trace,
    policies: Sequence[str],
    moments: int,
    goal_db: float,
    progress: Progress = silent,
) -> dict[str, list[int]]:
    """Return the bytes a client must fetch to hold a PSNR along a trace, ignoring bandwidth.

    At each sampled pose the client fetches in the order of its policy until the picture reaches the
    goal. Units are kept for later poses.

    Parameters
    ----------
    simulation : Simulation
    trace : Trace
    policies : sequence of str
        Names in `comparison.POLICIES`.
    moments : int
        Number of poses, spread evenly from the start to the end of the trace; at least 1.
    goal_db : float
        PSNR against the reference picture, dB.
    progress : Progress
        Called with the stage ``waiting``.

    Returns
    -------
    dict of str to list of int
        Bytes fetched until each pose, by policy.
    """
    clients = {name: simulation.client(name) for name in policies}
    present: dict[str, list[int]] = {name: [] for name in policies}
    found: dict[str, list[int]] = {name: [] for name in policies}
    for number, seconds in enumerate(np.linspace(0.0, trace.seconds, moments).tolist()):
        progress("waiting", number, moments)
        camera = trace.camera_at(seconds)
        reference = simulation.reference(camera)
        for name, client in clients.items():
            held = present[name]
            missing = fetch_order(client.units, client.priorities, camera, held)

            def is_enough(count: int) -> bool:
                splats = client.splats_of([*held, *missing[:count]], camera)  # noqa: B023
                return psnr(simulation.picture(camera, splats), reference) >= goal_db  # noqa: B023

            # Tested first: most poses need no more units. All units together are taken as enough.
            count = 0
            if not is_enough(0):
                count = bisect_left(range(len(missing)), True, lo=1, key=is_enough)
            present[name] = held + missing[:count]
            found[name].append(int(client.units.size_bytes[present[name]].sum()))
    progress("waiting", moments, moments)
    return found
