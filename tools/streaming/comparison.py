"""Policies beside each other: what a visitor sees as bytes come, along a trace and at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.views.view_sets import evenly
from cogsplat.formats.cogs.reader import CogsFile

from .client import Link, Priorities, Units, fetch, units_of
from .policies import by_pose, by_views, file_order, frustum, nearest_boxes, sgss
from .shown import ShownScene
from .traces import Trace

F64 = NDArray[np.float64]

POLICIES: Final = ("file", "distance", "sgss", "frustum", "views", "oracle")
"""Names of the policies: the order of the file; whole chunks by distance; SGSS' priority; the
file's order put off by boxes, by what the nearest views show, and by what the pose itself shows."""

SHARES: Final = (0.2, 0.3, 0.5, 0.7)
"""Shares of the bytes after which a view at rest is judged."""

TABLE_VIEWS: Final = 64
"""Views, at most, whose contributions `views` knows."""


@dataclass(frozen=True)
class Moment:
    """What a visitor sees at a moment.

    Parameters
    ----------
    seconds : float
    bytes : int
        Of segments that have arrived.
    psnr_db : float
        Against the picture of the whole; 100 at most.
    """

    seconds: float
    bytes: int
    psnr_db: float


class Simulation:
    """A scene in a client's hands.

    Parameters
    ----------
    file : CogsFile
    known : sequence of Camera
        Views whose contributions `views` knows; at most `TABLE_VIEWS` of them, evenly chosen.
    threads : int
    progress : Progress
        Called with the stage ``table``.
    """

    def __init__(
        self,
        file: CogsFile,
        known: Sequence[Camera],
        *,
        threads: int = 0,
        progress: Progress = silent,
    ) -> None:
        self.units: Units = units_of(file)
        self._shown = ShownScene(file, threads)
        self._known = evenly(known, TABLE_VIEWS)
        count = len(self._known)
        rows = []
        for number, camera in enumerate(self._known):
            progress("table", number, count)
            rows.append(self._shown.contributions(camera))
        progress("table", count, count)
        self._table = np.stack(rows)
        chunks = slice(0, self._shown.chunks)
        self._boxes = file.chunks.box[chunks].astype(np.float64)
        self._splats = file.chunks.splats[chunks].astype(np.float64)
        self._contribution = file.chunks.contribution[chunks].astype(np.float64)

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self._shown.chunks

    @property
    def known_views(self) -> int:
        """Number of views whose contributions are known."""
        return len(self._known)

    def policy(self, name: str) -> Priorities:
        """Return a policy by its name in `POLICIES`."""
        units, boxes, contribution = self.units, self._boxes, self._contribution
        makers: dict[str, Callable[[], Priorities]] = {
            "file": lambda: file_order(units),
            "distance": lambda: nearest_boxes(units, boxes),
            "sgss": lambda: sgss(units, boxes, self._splats),
            "frustum": lambda: frustum(units, boxes, contribution),
            "views": lambda: by_views(units, self._table, self._known, contribution),
            "oracle": lambda: by_pose(units, self._shown.contributions, contribution),
        }
        return makers[name]()

    def along(
        self,
        trace: Trace,
        link: Link,
        policies: Sequence[str],
        moments: int,
        progress: Progress = silent,
    ) -> dict[str, list[Moment]]:
        """Return what a visitor sees along a trace, by policy.

        Parameters
        ----------
        trace : Trace
        link : Link
        policies : sequence of str
        moments : int
            How many, evenly over the time that the trace or, where that is shorter, the download
            of the whole takes.
        progress : Progress
            Called with the stage ``trace``.
        """
        total = float(self.units.size_bytes.sum() + self.units.opening_bytes)
        download = link.latency + 8.0 * total / link.bits_per_second
        end = min(trace.seconds, download) if trace.seconds > 0.0 else download
        times = end * np.arange(1, moments + 1) / moments
        arrivals = {name: fetch(self.units, trace, link, self.policy(name)) for name in policies}
        seen: dict[str, list[Moment]] = {name: [] for name in policies}
        for number, seconds in enumerate(times.tolist()):
            progress("trace", number, moments)
            pose = trace.at(seconds)
            whole = self._shown.picture(pose)
            for name, arrived in arrivals.items():
                there = arrived.units[: int(np.searchsorted(arrived.seconds, seconds, "right"))]
                size = int(self.units.size_bytes[there].sum())
                quality = self._shown.psnr_db(self.units, there, pose, whole)
                seen[name].append(Moment(seconds, size, quality))
        progress("trace", moments, moments)
        return seen

    def at_rest(
        self, views: Sequence[Camera], policies: Sequence[str], progress: Progress = silent
    ) -> dict[str, list[float]]:
        """Return the mean PSNR of views after `SHARES` of the bytes, by policy.

        Each view is looked from alone, by somebody who waits. Progress is called with the stage
        ``views``.
        """
        total = int(self.units.size_bytes.sum())
        found: dict[str, list[list[float]]] = {name: [] for name in policies}
        for number, camera in enumerate(views):
            progress("views", number, len(views))
            whole = self._shown.picture(camera)
            trace = Trace([camera], np.zeros(1))
            for name in policies:
                # The pose stays: what it wants is worked out once.
                wanted = self.policy(name)(camera)
                arrived = fetch(self.units, trace, Link(1e9, 0.0), _always(wanted))
                sizes = np.cumsum(self.units.size_bytes[arrived.units])
                counts = [int(np.searchsorted(sizes, share * total, "right")) for share in SHARES]
                found[name].append(
                    [
                        self._shown.psnr_db(self.units, arrived.units[:count], camera, whole)
                        for count in counts
                    ]
                )
        progress("views", len(views), len(views))
        return {name: np.mean(rows, axis=0).tolist() for name, rows in found.items()}


def _always(priorities: F64) -> Priorities:
    return lambda _: priorities
