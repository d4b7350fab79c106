"""Visitors who wait along a trace until they see enough: what each policy makes them fetch."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent

from .client import waited_for
from .comparison import Simulation
from .traces import Trace


def fetched_by_waiting(
    simulation: Simulation,
    trace: Trace,
    policies: Sequence[str],
    moments: int,
    goal_db: float,
    progress: Progress = silent,
) -> dict[str, list[int]]:
    """Return the bytes that have been fetched when each moment of a trace is seen well enough.

    At every moment a visitor fetches, in the order that the policy chooses for the pose, until the
    picture reaches the goal, and goes on with what is there. So the bytes depend on no link, and
    those at the last moment are what the trace takes at that quality.

    Parameters
    ----------
    simulation : Simulation
    trace : Trace
    policies : sequence of str
    moments : int
        How many, evenly over the trace, its beginning and its end among them; at least 1.
    goal_db : float
        PSNR against the reference.
    progress : Progress
        Called with the stage ``waiting``.

    Returns
    -------
    dict of str to list of int
        By policy: bytes of segments at each moment, ascending.
    """
    clients = {name: simulation.client(name) for name in policies}
    there: dict[str, list[int]] = {name: [] for name in policies}
    found: dict[str, list[int]] = {name: [] for name in policies}
    for number, seconds in enumerate(np.linspace(0.0, trace.seconds, moments).tolist()):
        progress("waiting", number, moments)
        camera = trace.at(seconds)
        whole = simulation.reference(camera)
        for name, client in clients.items():
            had = there[name]
            more = waited_for(client.units, client.wanted(camera), had)

            def is_enough(count: int) -> bool:
                drawn = client.drawn([*had, *more[:count]], camera)  # noqa: B023
                return psnr(simulation.picture(camera, drawn), whole) >= goal_db  # noqa: B023

            # Nothing more is the most frequent answer; all that there is has to be enough.
            count = 0 if is_enough(0) else bisect_left(range(len(more)), True, lo=1, key=is_enough)
            there[name] = had + more[:count]
            found[name].append(int(client.units.size_bytes[there[name]].sum()))
    progress("waiting", moments, moments)
    return found
