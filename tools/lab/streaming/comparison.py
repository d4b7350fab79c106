"""Comparison of fetch policies: picture quality along a trace and at fixed poses."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.view_shares import MAX_VIEWS, ViewTable, encode_shares
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import sample_evenly
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.index_ratios import IndexRatios
from cogsplat.tools.lab.scheduling.poses import Pose
from cogsplat.tools.lab.scheduling.scene_rows import scene_rows

from .client import (
    CHUNK_KINDS,
    PAGE,
    Arrivals,
    Link,
    Priorities,
    Units,
    fetch_order,
    simulate_fetch,
    units_of,
)
from .partial_renderer import PartialRenderer
from .policies import (
    ClientRatios,
    by_true_contribution,
    by_urgency,
    file_order,
    nearest_chunks,
    sgss_chunks,
)
from .row_clients import RowClient, antimatter_client, sgss_client
from .streamed_sog import StreamedSogClient
from .traces import Trace
from .visit_client import Browser, simulate_visit

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
"""Names of the policies.

- ``file``: order of the file. ``whole``: the same, drawn only when complete.
- ``distance``, ``sgss``: complete chunks by distance, and by SGSS' priority.
- ``antimatter``: splats by volume times opacity. ``sgss-cells``: cells and order of SGSS.
- ``frustum``, ``views``, ``oracle``: by urgency, with visibility ratios from boxes, from the view
  table, and from the true contributions to the current view.
- ``visit``: `views` as in the npm package, with concurrent requests, pose extrapolation, aborts,
  resumption and a memory budget.
"""

PEER: Final = "streamed-sog"
"""Name of the policy of the Streamed SOG client (`streamed_sog`)."""

SHARES: Final = (0.2, 0.3, 0.5, 0.7)
"""Shares of the bytes at which pictures from fixed poses are compared."""

PictureCallback = Callable[[str, float, F32], None]
"""Receives the policy (empty for the reference), the time in the trace, s, and a picture."""


@dataclass(frozen=True)
class Moment:
    """Bytes received and picture quality at one time of a trace.

    Parameters
    ----------
    seconds : float
        Time in the trace.
    bytes : int
        Bytes of segments received.
    psnr_db : float
        PSNR against the picture of the full file, or of the source; 100 at most.
    ssim : float
        SSIM against the same picture.
    wasted_bytes : int
        Part of `bytes` in chunks that contributed to no picture so far.
    requests : int
        Requests made.
    """

    seconds: float
    bytes: int
    psnr_db: float
    ssim: float
    wasted_bytes: int
    requests: int = 0


def bytes_until(moments: Sequence[Moment], goal_db: float) -> int | None:
    """Return the bytes received when a PSNR is reached for good; None if it is not."""
    found = None
    for moment in reversed(moments):
        if moment.psnr_db < goal_db:
            break
        found = moment.bytes
    return found


def moments_behind(moments: Sequence[Moment], others: Sequence[Moment], goal_db: float) -> int:
    """Count the moments at which one policy is below a PSNR that another policy reaches.

    The first second is left out.

    Parameters
    ----------
    moments : sequence of Moment
        Moments of the policy.
    others : sequence of Moment
        Moments of the other policy, at the same times.
    goal_db : float
        PSNR, dB.
    """
    return sum(
        moment.seconds > 1.0 and moment.psnr_db < goal_db <= other.psnr_db
        for moment, other in zip(moments, others, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Client:
    """Client of one policy: units, fetch order and drawn splats.

    Parameters
    ----------
    units : Units
        Fetchable units.
    priorities : Priorities
        Urgency of each unit at a pose.
    rows : list of slice or (n,) int64
        Rows of `scene` in each unit; empty for codebooks.
    splats_of : callable
        Function from received units and a camera to the splats drawn.
    scene : callable
        Function that returns the splats of all units; for most policies it decodes the whole file.
    """

    units: Units
    priorities: Priorities
    rows: Sequence[slice | I64]
    splats_of: Callable[[Sequence[int], Camera], Splats]
    scene: Callable[[], Splats]


def _stored_tables(file: CogsFile) -> dict[tuple[int, ...], ViewTable]:
    """Return the view tables of a file that are there, by the path of their index."""
    tables: dict[tuple[int, ...], ViewTable] = {}
    for path, row in file.view_table_rows.items():
        table = file.view_table(path) if file.is_present(row) else None
        if table is not None:
            tables[path] = table
    return tables


class Simulation:
    """Simulation of clients of one file under several policies.

    Parameters
    ----------
    file : CogsFile
    known : sequence of Camera
        Cameras at whose positions a view table is measured if the file has none; at most
        `MAX_VIEWS`, sampled evenly.
    threads : int
        Threads for rendering and scoring.
    compensate : bool
        Whether clients apply compensation for missing chunks (SPEC 8.5).
    source : Splats, optional
        Scene of the reference pictures; by default the decoded file.
    peer : StreamedSogClient, optional
        Client of the policy `PEER`, which fetches the scene as Streamed SOG.
    progress : Progress
        Called with the stage ``table`` while a view table is measured.
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
        self._renderer = PartialRenderer(file, threads, compensate=compensate)
        self._known = sample_evenly(known, MAX_VIEWS)
        self._rows = scene_rows(file.indices, file.parents())
        stored = _stored_tables(file)
        # `visit` uses only information in the file, never a measured table.
        self._visit_ratios = self._stored_ratios(file, stored)
        self._boxes = IndexRatios(file.indices, {})
        self._is_known = () in stored
        self.known_views = len(stored[()].positions if self._is_known else self._known)
        self._file, self._progress = file, progress

    @cached_property
    def _ratios(self) -> ClientRatios:
        """Ratios from the file's view tables, or else from tables measured when first needed."""
        if self._is_known:
            return self._visit_ratios
        measured = IndexRatios(self._file.indices, self._measured_tables())
        return lambda pose, _: measured.at(pose)

    def _stored_ratios(
        self, file: CogsFile, tables: dict[tuple[int, ...], ViewTable]
    ) -> ClientRatios:
        """Return the ratios for a client that has some of the view tables."""
        ratios, units = IndexRatios(file.indices, tables), self.units
        starts = {int(file.offsets[row]): path for path, row in file.view_table_rows.items()}
        unit_starts = (units.end - units.size_bytes).tolist()
        path_of = {
            unit: starts[unit_starts[unit]]
            for unit in np.flatnonzero(units.kind == SegmentKind.VIEW_TABLE).tolist()
        }
        paths = {index.start: index.path for index in file.indices}
        pages = {
            unit: paths[unit_starts[unit]] for unit in np.flatnonzero(units.kind == PAGE).tolist()
        }

        def of_client(pose: Pose, present: Collection[int]) -> F64:
            arrived = {path_of[unit] for unit in present if unit in path_of}
            read = {pages[unit] for unit in present if unit in pages}
            return ratios.at(pose, arrived, {(), *read})

        return of_client

    def _measured_tables(self) -> dict[tuple[int, ...], ViewTable]:
        """Measure the view tables of all indices from the known views."""
        positions = np.stack([camera.position for camera in self._known]).astype(np.float32)
        of_chunks = self._renderer.panorama_shares(
            positions, lambda _, done, pictures: self._progress("table", done, pictures)
        )
        columns = np.stack([self._rows.with_sums(shares) for shares in of_chunks])
        tables = {}
        page = self._rows.chunks
        for node in self._file.indices:
            end, pages = node.first_chunk + len(node.tables.chunks), len(node.tables.pages)
            of_node = [*range(node.first_chunk, end), *range(page, page + pages)]
            tables[node.path] = ViewTable(positions, encode_shares(columns[:, of_node]))
            page += pages
        return tables

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self._renderer.chunks

    def policy(self, name: str) -> Priorities:
        """Return a policy by its name in `POLICIES`."""
        units, rows = self.units, self._rows
        makers: dict[str, Callable[[], Priorities]] = {
            "file": lambda: file_order(units),
            "distance": lambda: nearest_chunks(units, rows.box),
            "sgss": lambda: sgss_chunks(units, rows.box, rows.splats.astype(np.float64)),
            "frustum": lambda: by_urgency(units, lambda pose, _: self._boxes.at(pose)),
            "views": lambda: by_urgency(units, self._ratios),
            "visit": lambda: by_urgency(units, self._visit_ratios),
            "oracle": lambda: by_true_contribution(units, self._renderer.chunk_contributions, rows),
        }
        return makers[name]()

    def client(self, name: str) -> Client:
        """Create the client of a policy, by its name in `POLICIES` or `PEER`."""
        if name == PEER:
            peer = self._peer
            if peer is None:
                raise ValueError(f"{name}: no other file was given")
            return Client(
                peer.units, peer.priorities, peer.rows, peer.splats_of, lambda: peer.scene
            )
        units = self.units
        if name in ("antimatter", "sgss-cells"):
            splats, size = self._renderer.splats, int(units.size_bytes.sum())
            made: RowClient = (
                antimatter_client(splats, size, units.index_bytes)
                if name == "antimatter"
                else sgss_client(splats, self._known, size, units.index_bytes)
            )
            rows = made.rows

            def splats_of_pieces(present: Sequence[int], _: Camera) -> Splats:
                return splats.take(
                    np.concatenate([np.zeros(0, np.int64), *(rows[u] for u in present)])
                )

            return Client(made.units, made.priorities, rows, splats_of_pieces, lambda: splats)
        rows_of_units = [
            self._renderer.rows(chunk) if kind in CHUNK_KINDS else slice(0, 0)
            for kind, chunk in zip(units.kind.tolist(), units.row.tolist(), strict=True)
        ]

        def splats_of_segments(present: Sequence[int], camera: Camera) -> Splats:
            if name == "whole" and len(present) < len(units):
                present = ()
            ratios = self._visit_ratios if name == "visit" else self._ratios
            at_pose = ratios(Pose.from_camera(camera), present)
            return self._renderer.splats_of_units(units, present, at_pose)

        priorities = self.policy("file" if name == "whole" else name)
        return Client(
            units, priorities, rows_of_units, splats_of_segments, lambda: self._renderer.splats
        )

    def picture(self, camera: Camera, splats: Splats | None = None) -> F32:
        """Render splats, by default the full file, to an (H, W, 3) picture of values 0 to 1."""
        return self._renderer.picture(camera, splats)

    def reference(self, camera: Camera) -> F32:
        """Render the reference picture: (H, W, 3), 0 to 1."""
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
        until: float | None = None,
    ) -> Arrivals:
        """Simulate the arrival of a client's units.

        Parameters
        ----------
        name : str
            Name of the client's policy.
        client : Client
        trace : Trace
        link : Link
        budget_splats : int
            Memory limit of ``visit``, splats; 0 for no limit.
        browser : Browser, optional
            Machine that ``visit`` runs on; by default one without delays.
        until : float, optional
            Time at which the simulation of ``visit`` ends, s; by default 600 s after the trace.
        """
        if name != "visit":
            return simulate_fetch(client.units, trace, link, client.priorities)
        return simulate_visit(
            client.units,
            self._rows.budget_splats,
            self._rows.contribution,
            self._visit_ratios,
            trace,
            link,
            budget_splats=budget_splats,
            browser=browser,
            until=until,
        )

    def run_trace(
        self,
        trace: Trace,
        link: Link,
        policies: Sequence[str],
        moments: int,
        progress: Progress = silent,
        on_picture: PictureCallback | None = None,
        *,
        budget_splats: int = 0,
    ) -> dict[str, list[Moment]]:
        """Simulate policies along a trace and measure the pictures.

        Parameters
        ----------
        trace : Trace
        link : Link
        policies : sequence of str
        moments : int
            Number of measurements, spread evenly over the trace, or over the download if that is
            shorter.
        progress : Progress
            Called with the stage ``trace``.
        on_picture : PictureCallback, optional
            Called with every picture.
        budget_splats : int
            Memory limit of ``visit``, splats; 0 for no limit.
        """
        clients = {name: self.client(name) for name in policies}
        arrivals = {
            name: self.arrivals(name, client, trace, link, budget_splats=budget_splats)
            for name, client in clients.items()
        }
        # Arrival of the last unit. Computed from bytes it would differ by rounding.
        ends = [float(arrived.seconds[-1]) for arrived in arrivals.values() if arrived.units]
        download = max(ends, default=link.latency)
        end = min(trace.seconds, download) if trace.seconds > 0.0 else download
        # The last time equals the end exactly, so that it includes the last arrival.
        times = np.linspace(0.0, end, moments + 1)[1:]
        measured: dict[str, list[Moment]] = {name: [] for name in policies}
        scene_of = {name: client.scene() for name, client in clients.items()}
        scenes = {id(scene): scene for scene in scene_of.values()}
        is_seen = {key: np.zeros(len(scene), np.bool_) for key, scene in scenes.items()}
        for number, seconds in enumerate(times.tolist()):
            progress("trace", number, moments)
            camera = trace.camera_at(seconds)
            reference = self.reference(camera)
            for key, scene in scenes.items():
                is_seen[key] |= self._renderer.splat_contributions(camera, scene) > 0.0
            if on_picture is not None:
                on_picture("", seconds, reference)
            for name, arrived in arrivals.items():
                client = clients[name]
                fetched = arrived.fetched_by(seconds)
                sizes = client.units.size_bytes[fetched]
                rows_seen = is_seen[id(scene_of[name])]
                unseen = [
                    client.units.kind[unit] in CHUNK_KINDS
                    and not rows_seen[client.rows[unit]].any()
                    for unit in fetched
                ]
                splats = client.splats_of(arrived.present_at(seconds), camera)
                picture = self._renderer.picture(camera, splats)
                if on_picture is not None:
                    on_picture(name, seconds, picture)
                moment = Moment(
                    seconds,
                    int(sizes.sum()),
                    psnr(picture, reference),
                    ssim(picture, reference),
                    int(sizes[np.array(unseen, np.bool_)].sum()),
                    arrived.requests_by(seconds),
                )
                measured[name].append(moment)
        progress("trace", moments, moments)
        return measured

    def at_rest(
        self, views: Sequence[Camera], policies: Sequence[str], progress: Progress = silent
    ) -> dict[str, list[float]]:
        """Return the mean PSNR of fixed views after `SHARES` of the bytes, by policy.

        Each view is a separate client that starts empty. The shares always refer to the size of
        this file, also for `PEER`.

        Parameters
        ----------
        views : sequence of Camera
        policies : sequence of str
        progress : Progress
            Called with the stage ``views``.
        """
        total = int(self.units.size_bytes.sum())
        clients = {name: self.client(name) for name in policies}
        found: dict[str, list[list[float]]] = {name: [] for name in policies}
        for number, camera in enumerate(views):
            progress("views", number, len(views))
            reference = self.reference(camera)
            for name, client in clients.items():
                order = fetch_order(client.units, client.priorities, camera)
                sizes = np.cumsum(client.units.size_bytes[order])
                counts = [int(np.searchsorted(sizes, share * total, "right")) for share in SHARES]
                pictures = (
                    self._renderer.picture(camera, client.splats_of(order[:count], camera))
                    for count in counts
                )
                found[name].append([psnr(picture, reference) for picture in pictures])
        progress("views", len(views), len(views))
        return {name: np.mean(rows, axis=0).tolist() for name, rows in found.items()}
