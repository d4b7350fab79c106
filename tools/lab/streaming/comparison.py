"""Policies beside each other: what a visitor sees as bytes come, along a trace and at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import sample_evenly
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import by_boxes, by_view_table
from cogsplat.tools.lab.scheduling.poses import Pose

from .client import Arrivals, Link, Priorities, Units, fetch, units_of, waited_for
from .policies import by_pose, by_ratios, file_order, nearest_boxes, sgss, table_of
from .row_clients import RowClient, by_antimatter, by_sgss_cells
from .shown import ShownScene
from .streamed_sog import StreamedSogClient
from .traces import Trace
from .visits import Browser, visit

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

POLICIES: Final = (
    "file",
    "whole",
    "distance",
    "antimatter",
    "sgss",
    "sgss-cells",
    "frustum",
    "views",
    "visit",
    "oracle",
)
"""Names of the policies. ``file`` is the order of the file, ``whole`` the same shown once all of it
is there. ``distance`` and ``sgss`` fetch whole chunks by their distance and by SGSS' priority.
``antimatter`` and ``sgss-cells`` fetch splats by volume times opacity, and as SGSS does, in cells
and an order of its own. ``frustum``, ``views`` and ``oracle`` put the file's order off by boxes, by
what the nearest views show, and by what the pose itself shows. ``visit`` is `views` as the npm
package does it: several requests at a time, for a path, stopped and resumed, within a budget."""

PEER: Final = "streamed-sog"
"""Name of the client of another file: by the rules of PlayCanvas' viewer (`streamed_sog`)."""

SHARES: Final = (0.2, 0.3, 0.5, 0.7)
"""Shares of the bytes after which a view at rest is judged."""

TABLE_VIEWS: Final = 64
"""Views, at most, whose contributions `views` knows."""

Shown = Callable[[str, float, F32], None]
"""Takes a picture: the policy, empty for the whole scene, and the second of the trace."""


@dataclass(frozen=True)
class Moment:
    """What a visitor sees at a moment.

    Parameters
    ----------
    seconds : float
    bytes : int
        Of segments that have arrived.
    psnr_db : float
        Against the picture of the whole file, or of the source; 100 at most.
    ssim : float
        Likewise.
    wasted_bytes : int
        Of `bytes`, those of chunks that no moment so far has shown anything of.
    """

    seconds: float
    bytes: int
    psnr_db: float
    ssim: float
    wasted_bytes: int


def bytes_until(moments: Sequence[Moment], goal_db: float) -> int | None:
    """Return the bytes at the first moment from which on a PSNR is kept; None where none is."""
    found = None
    for moment in reversed(moments):
        if moment.psnr_db < goal_db:
            break
        found = moment.bytes
    return found


def moments_behind(moments: Sequence[Moment], others: Sequence[Moment], goal_db: float) -> int:
    """Return at how many moments, after the first second, others show a PSNR and these do not.

    Parameters
    ----------
    moments, others : sequence of Moment
        At the same times.
    goal_db : float
    """
    return sum(
        moment.seconds > 1.0 and moment.psnr_db < goal_db <= other.psnr_db
        for moment, other in zip(moments, others, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Client:
    """Somebody who fetches a scene.

    Parameters
    ----------
    units : Units
        What may be fetched.
    wanted : Priorities
    rows : list of slice or (n,) int64
        Rows of `scene` that each unit is about; none for codebooks.
    drawn : callable
        What is drawn of units that are there, from a pose.
    scene : Splats
        All that there is to fetch.
    """

    units: Units
    wanted: Priorities
    rows: Sequence[slice | I64]
    drawn: Callable[[Sequence[int], Camera], Splats]
    scene: Splats


class Simulation:
    """A scene in a client's hands.

    Parameters
    ----------
    file : CogsFile
    known : sequence of Camera
        Views whose contributions `views` knows where the file has no view table; at most
        `TABLE_VIEWS` of them, evenly chosen.
    threads : int
    compensate : bool
        Whether clients of the file change what they have to make up for what is missing.
    source : Splats, optional
        Whose pictures all others are compared with; by default the whole file's.
    peer : StreamedSogClient, optional
        The client of the policy `PEER`, of the same scene in another file.
    progress : Progress
        Called with the stage ``table``, of a file without a view table.
    """

    def __init__(
        self,
        file: CogsFile,
        known: Sequence[Camera],
        *,
        threads: int = 0,
        compensate: bool = False,
        source: Splats | None = None,
        peer: StreamedSogClient | None = None,
        progress: Progress = silent,
    ) -> None:
        self.units: Units = units_of(file)
        self._source, self._peer = source, peer
        self._shown = ShownScene(file, threads, compensate=compensate)
        self._known = sample_evenly(known, TABLE_VIEWS)
        chunks = slice(0, self._shown.chunks)
        row = file.view_table_row
        stored = file.view_table() if row is not None and file.is_present(row) else None
        if stored is None:
            self._table = self._measured_table(progress)
        else:
            self._table = replace(stored, codes=stored.codes[:, chunks])
        self._boxes = file.chunks.box[chunks].astype(np.float64)
        self._splats = file.chunks.splats[chunks].astype(np.float64)
        self._contribution = file.chunks.contribution[chunks].astype(np.float64)
        self._ratios = by_view_table(self._table, self._boxes, self._contribution)
        # A visitor knows what the file says, and no pictures besides.
        self._visitors_ratios = (
            by_boxes(self._boxes, self._contribution) if stored is None else self._ratios
        )

    def _measured_table(self, progress: Progress) -> ViewTable:
        """Return what the known views show, of a file that does not say."""
        count = len(self._known)
        rows = []
        for number, camera in enumerate(self._known):
            progress("table", number, count)
            rows.append(self._shown.contributions(camera))
        progress("table", count, count)
        return table_of(self._known, np.stack(rows))

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self._shown.chunks

    @property
    def known_views(self) -> int:
        """Number of viewpoints whose shares are known."""
        return len(self._table.positions)

    def policy(self, name: str) -> Priorities:
        """Return a policy by its name in `POLICIES`."""
        units, boxes, contribution = self.units, self._boxes, self._contribution
        makers: dict[str, Callable[[], Priorities]] = {
            "file": lambda: file_order(units),
            "distance": lambda: nearest_boxes(units, boxes),
            "sgss": lambda: sgss(units, boxes, self._splats),
            "frustum": lambda: by_ratios(units, by_boxes(boxes, contribution)),
            "views": lambda: by_ratios(units, self._ratios),
            "visit": lambda: by_ratios(units, self._visitors_ratios),
            "oracle": lambda: by_pose(units, self._shown.contributions, contribution),
        }
        return makers[name]()

    def client(self, name: str) -> Client:
        """Return the client of a policy."""
        if name == PEER:
            peer = self._peer
            if peer is None:
                raise ValueError(f"{name}: no other file was given")
            return Client(peer.units, peer.wanted, peer.rows, peer.drawn, peer.scene)
        splats, units = self._shown.splats, self.units
        size = int(units.size_bytes.sum())
        if name in ("antimatter", "sgss-cells"):
            made: RowClient = (
                by_antimatter(splats, size, units.opening_bytes)
                if name == "antimatter"
                else by_sgss_cells(splats, self._known, size, units.opening_bytes)
            )
            rows = made.rows

            def of_rows(there: Sequence[int], _: Camera) -> Splats:
                return splats.take(
                    np.concatenate([np.zeros(0, np.int64), *(rows[u] for u in there)])
                )

            return Client(made.units, made.wanted, rows, of_rows, splats)
        of_units = [
            self._shown.rows(chunk) if chunk >= 0 else slice(0, 0) for chunk in units.chunk.tolist()
        ]

        def of_segments(there: Sequence[int], camera: Camera) -> Splats:
            if name == "whole" and len(there) < len(units):
                return splats.take(slice(0, 0))
            ratios = self._visitors_ratios if name == "visit" else self._ratios
            return self._shown.drawn(units, there, ratios(Pose.of_camera(camera)))

        wanted = self.policy("file" if name == "whole" else name)
        return Client(units, wanted, of_units, of_segments, splats)

    def picture(self, camera: Camera, splats: Splats | None = None) -> F32:
        """Return the picture of the whole file, or of other splats: (H, W, 3), 0 to 1."""
        return self._shown.picture(camera, splats)

    def reference(self, camera: Camera) -> F32:
        """Return the picture that others are compared with: (H, W, 3), 0 to 1."""
        return self.picture(camera, self._source)

    def arrivals(
        self,
        name: str,
        client: Client,
        trace: Trace,
        link: Link,
        *,
        budget_splats: int = 0,
        browser: Browser | None = None,
    ) -> Arrivals:
        """Return when a client's units come.

        Parameters
        ----------
        name : str
            Of the client's policy.
        client : Client
        trace : Trace
        link : Link
        budget_splats : int
            Most splats in memory of ``visit``; 0 for any number.
        browser : Browser, optional
            In which ``visit`` runs.
        """
        if name != "visit":
            return fetch(client.units, trace, link, client.wanted)
        return visit(
            client.units,
            self._splats.astype(np.int64).tolist(),
            self._visitors_ratios,
            trace,
            link,
            budget_splats=budget_splats,
            browser=browser,
        )

    def along(
        self,
        trace: Trace,
        link: Link,
        policies: Sequence[str],
        moments: int,
        progress: Progress = silent,
        shown: Shown | None = None,
        *,
        budget_splats: int = 0,
    ) -> dict[str, list[Moment]]:
        """Return what a visitor sees along a trace, by policy.

        Parameters
        ----------
        trace : Trace
        link : Link
        policies : sequence of str
        moments : int
            How many, evenly over the time that the trace or, where that is shorter, the download
            of the whole takes. So the mean over them is the area under a curve over time.
        progress : Progress
            Called with the stage ``trace``.
        shown : callable, optional
            Called with every picture.
        budget_splats : int
            Most splats in memory of ``visit``; 0 for any number.
        """
        clients = {name: self.client(name) for name in policies}
        arrivals = {
            name: self.arrivals(name, client, trace, link, budget_splats=budget_splats)
            for name, client in clients.items()
        }
        # When the last unit has come: sums of times round, so that it is not reckoned from bytes.
        ends = [float(arrived.seconds[-1]) for arrived in arrivals.values() if arrived.units]
        download = max(ends, default=link.latency)
        end = min(trace.seconds, download) if trace.seconds > 0.0 else download
        # The last moment is the end to the bit: what comes then is there.
        times = np.linspace(0.0, end, moments + 1)[1:]
        seen: dict[str, list[Moment]] = {name: [] for name in policies}
        scenes = {id(client.scene): client.scene for client in clients.values()}
        is_seen = {key: np.zeros(len(scene), np.bool_) for key, scene in scenes.items()}
        for number, seconds in enumerate(times.tolist()):
            progress("trace", number, moments)
            pose = trace.at(seconds)
            whole = self.reference(pose)
            for key, scene in scenes.items():
                is_seen[key] |= self._shown.contributions_of_splats(pose, scene) > 0.0
            if shown is not None:
                shown("", seconds, whole)
            for name, arrived in arrivals.items():
                client = clients[name]
                came = arrived.came(seconds)
                sizes = client.units.size_bytes[came]
                rows_seen = is_seen[id(client.scene)]
                unseen = [
                    client.units.chunk[unit] >= 0 and not rows_seen[client.rows[unit]].any()
                    for unit in came
                ]
                picture = self._shown.picture(pose, client.drawn(arrived.there(seconds), pose))
                if shown is not None:
                    shown(name, seconds, picture)
                moment = Moment(
                    seconds,
                    int(sizes.sum()),
                    psnr(picture, whole),
                    ssim(picture, whole),
                    int(sizes[np.array(unseen, np.bool_)].sum()),
                )
                seen[name].append(moment)
        progress("trace", moments, moments)
        return seen

    def at_rest(
        self, views: Sequence[Camera], policies: Sequence[str], progress: Progress = silent
    ) -> dict[str, list[float]]:
        """Return the mean PSNR of views after `SHARES` of the bytes, by policy.

        The bytes are shares of the file's, also for a client of another. Each view is looked from
        alone, by somebody who waits. Progress is called with the stage ``views``.
        """
        total = int(self.units.size_bytes.sum())
        clients = {name: self.client(name) for name in policies}
        found: dict[str, list[list[float]]] = {name: [] for name in policies}
        for number, camera in enumerate(views):
            progress("views", number, len(views))
            whole = self.reference(camera)
            for name, client in clients.items():
                order = waited_for(client.units, client.wanted(camera))
                sizes = np.cumsum(client.units.size_bytes[order])
                counts = [int(np.searchsorted(sizes, share * total, "right")) for share in SHARES]
                pictures = (
                    self._shown.picture(camera, client.drawn(order[:count], camera))
                    for count in counts
                )
                found[name].append([psnr(picture, whole) for picture in pictures])
        progress("views", len(views), len(views))
        return {name: np.mean(rows, axis=0).tolist() for name, rows in found.items()}
