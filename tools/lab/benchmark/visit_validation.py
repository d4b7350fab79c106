"""Validation of the simulated `visit` policy against a real browser.

Run ``python -m cogsplat.tools.lab.benchmark.visit_validation SCENE.cogs --trace WALK.json`` from a
checkout, after ``npm ci && npm run build`` in ``tools/web``.

Headless Chromium follows the path with the npm package over a slow link and records which chunks
it has decoded at given times. The recorded and the simulated chunks are rendered afterwards by the
Python renderer, so software WebGL does not affect the result. The page keeps the rows of the
chunks, as one that draws them would. The simulation uses the browser's measured start times of the
first request and of decoding.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final, TypedDict

import click
import numpy as np

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.delivery import slow_server
from cogsplat.tools.delivery.slow_server import Reply, SlowServer, running
from cogsplat.tools.lab.scheduling.poses import Pose
from cogsplat.tools.lab.streaming.client import CHUNK_KINDS, Link, Units
from cogsplat.tools.lab.streaming.comparison import Moment, Simulation
from cogsplat.tools.lab.streaming.curves import picture_strips
from cogsplat.tools.lab.streaming.traces import Trace, recorded_trace
from cogsplat.tools.lab.streaming.visit_client import Browser
from cogsplat.tools.pictures.png import write_png
from cogsplat.tools.terminal.values import FiniteNumber

from .chromium import opened_page

_WEB: Final = Path(__file__).resolve().parents[2] / "web"
_PAGE: Final = b'<!doctype html><title>visit</title><script type="module" src="visits.js"></script>'
_SCENE: Final = "scene.cogs"
# The page may measure its memory only where no other origin shares its process; without the
# argument the browser waits for its next garbage collection.
_ISOLATION: Final = {
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
}
_ARGUMENTS: Final = ("--enable-blink-features=ForceEagerMeasureMemory",)
_FRAME_SECONDS: Final = 1 / 30
"""Time between two poses sent to the page."""


class PageState(TypedDict):
    """Chunks that the page had decoded at one time.

    `seconds` is the time since the scene was opened. A chunk is a tuple of its number, whether it
    is refined, and whether its tail is decoded.
    """

    seconds: float
    chunks: list[tuple[int, bool, bool]]


@dataclass(frozen=True)
class Visit:
    """Record of one browser's visit along a path.

    Parameters
    ----------
    browser : Browser
        Its delays.
    noted : list of PageState
        Chunks that it had decoded at given times.
    traffic : list of (int, int)
        Bytes of the scene sent, and requests made, until each of these times.
    first_rows : float
        Time of the first decoded rows, s.
    page_bytes, worker_bytes : int
        Memory of the page and of its workers at the last moment, bytes.
    """

    browser: Browser
    noted: list[PageState]
    traffic: list[tuple[int, int]]
    first_rows: float
    page_bytes: int
    worker_bytes: int


class _IsolatedServer(SlowServer):
    """Server whose pages may measure their memory, with a log of the requests for the scene."""

    def __init__(self, files: dict[str, bytes], cached: dict[str, bytes]) -> None:
        super().__init__(files, cached=cached)
        self.requested_at: list[float] = []

    def reply(self, name: str, range_header: str | None) -> Reply:
        """Return the response to a request."""
        if name == _SCENE:
            self.requested_at.append(time.monotonic())
        reply = super().reply(name, range_header)
        return replace(reply, headers={**reply.headers, **_ISOLATION})


@dataclass(frozen=True)
class Comparison:
    """Browser and simulation compared at one time.

    Parameters
    ----------
    seconds : float
        Time since the scene was opened.
    splats, simulated_splats : int
        Splats in memory, in the browser and in the simulation.
    size_bytes, simulated_bytes : int
        Bytes of the chunks in memory, in the browser and in the simulation.
    fetched_bytes, simulated_fetched : int
        Bytes received, in the browser and in the simulation, which counts whole segments.
    requests, simulated_requests : int
        Requests made.
    psnr_db, simulated_db : float
        PSNR of both pictures against the full scene, or the source, at the pose.
    """

    seconds: float
    splats: int
    simulated_splats: int
    size_bytes: int
    simulated_bytes: int
    fetched_bytes: int
    simulated_fetched: int
    requests: int
    simulated_requests: int
    psnr_db: float
    simulated_db: float


def run_browser(
    scene: Path,
    trace: Trace,
    link: Link,
    moments: list[float],
    budget_splats: int,
    splats_per_second: float,
) -> Visit:
    """Follow a camera path in Chromium.

    Parameters
    ----------
    scene : Path
    trace : Trace
    link : Link
    moments : list of float
        Times since the scene was opened, s.
    budget_splats : int
        Memory limit, splats; 0 for no limit.
    splats_per_second : float
        Decoding throughput of this machine's workers.
    """
    files = {"index.html": _PAGE, "visits.js": (_WEB / "scripts" / "visits.js").read_bytes()}
    for name in ("cogsplat.js", "worker.js", "visit.js"):
        files[name] = (_WEB / "dist" / name).read_bytes()
    times = np.arange(0.0, trace.seconds + _FRAME_SECONDS, _FRAME_SECONDS)
    visit = {
        "url": f"/{_SCENE}",
        "poses": [_pose(Pose.from_camera(trace.camera_at(float(seconds)))) for seconds in times],
        "interval": _FRAME_SECONDS,
        "budget": budget_splats,
        "moments": moments,
    }
    programs = dict(files)
    files[_SCENE] = scene.read_bytes()
    server = _IsolatedServer(files, programs)
    with (
        running(server),
        opened_page(server.url, "window.visit !== undefined", _ARGUMENTS) as page,
    ):
        # Warm-up without a slow link: compiles the programs and starts the workers.
        page.evaluate("(visit) => window.visit(visit)", {**visit, "moments": [0.5]})
        server.link = slow_server.Link(link.bits_per_second, link.latency)
        server.requested_at.clear()
        server.traffic.rows.clear()
        result = page.evaluate("(visit) => window.visit(visit)", visit)
    begin = server.requested_at[0] - result["started"]
    ends = [begin + entry["seconds"] for entry in result["noted"]]
    return Visit(
        Browser(result["started"], splats_per_second, result["decoding"]),
        result["noted"],
        [
            (server.traffic.size_bytes(_SCENE, end), sum(at <= end for at in server.requested_at))
            for end in ends
        ],
        result["rows"],
        *result["memory"],
    )


def _pose(pose: Pose) -> dict[str, object]:
    """Return a pose as the JSON object that the page's script takes."""
    return {
        "position": pose.position.tolist(),
        "rotation": np.asarray(pose.rotation).ravel().tolist(),
        "tanX": pose.tan_x,
        "tanY": pose.tan_y,
    }


def units_of_chunks(units: Units, chunks: list[tuple[int, bool, bool]]) -> list[int]:
    """Return the numbers of the units behind a page's chunks.

    They are the segments of the chunks, and the index pages and view tables that list the chunks.
    Pages and view tables of indices that list none of the chunks do not change what is drawn.
    """
    found: list[int] = []
    for chunk, refined, tail in chunks:
        kinds = {SegmentKind.HEAD: True, SegmentKind.REFINEMENT: refined, SegmentKind.TAIL: tail}
        present = [kind for kind, is_present in kinds.items() if is_present]
        found += np.flatnonzero((units.row == chunk) & np.isin(units.kind, present)).tolist()
    if units.page_of is None:
        return found
    pages = {-1, *units.page_of[found].tolist()}
    for page in sorted(pages - {-1}):
        while page >= 0:
            pages.add(page)
            page = int(units.page_of[page])
    is_table = (units.kind == SegmentKind.VIEW_TABLE) & np.isin(units.page_of, list(pages))
    return [*sorted(pages - {-1}), *np.flatnonzero(is_table).tolist(), *found]


def compare(
    simulation: Simulation,
    trace: Trace,
    link: Link,
    visit: Visit,
    budget_splats: int,
) -> tuple[list[Comparison], dict[str, list[np.ndarray]]]:
    """Compare the chunks that a browser had decoded with the simulated chunks.

    Parameters
    ----------
    simulation : Simulation
    trace : Trace
        Camera path of the visit.
    link : Link
    visit : Visit
        Record of the browser's visit.
    budget_splats : int
        Memory limit, splats; 0 for no limit.

    Returns
    -------
    tuple of list of Comparison and dict of str to list of pictures
        One row per recorded time, and pictures by source: ``""`` for the reference, ``browser``,
        ``simulated``.
    """
    client = simulation.client("visit")
    arrivals = simulation.arrivals(
        "visit",
        client,
        trace,
        link,
        budget_splats=budget_splats,
        browser=visit.browser,
        until=visit.noted[-1]["seconds"],
    )
    rows = []
    pictures: dict[str, list[np.ndarray]] = {"": [], "browser": [], "simulated": []}
    for entry, (fetched_bytes, requests) in zip(visit.noted, visit.traffic, strict=True):
        seconds = entry["seconds"]
        camera = trace.camera_at(seconds)
        reference = simulation.reference(camera)
        held = [units_of_chunks(simulation.units, entry["chunks"]), arrivals.present_at(seconds)]
        sizes_of = simulation.units.size_bytes
        of_chunks = np.where(np.isin(simulation.units.kind, CHUNK_KINDS), sizes_of, 0)
        fetched = simulation.units.index_bytes + sizes_of[arrivals.fetched_by(seconds)].sum()
        sizes = [int(of_chunks[present].sum()) for present in held]
        drawn = [client.splats_of(present, camera) for present in held]
        pair = [simulation.picture(camera, splats) for splats in drawn]
        rows.append(
            Comparison(
                seconds,
                len(drawn[0]),
                len(drawn[1]),
                sizes[0],
                sizes[1],
                fetched_bytes,
                int(fetched),
                requests,
                arrivals.requests_by(seconds),
                psnr(pair[0], reference),
                psnr(pair[1], reference),
            )
        )
        for name, picture in zip(pictures, (reference, *pair), strict=True):
            pictures[name].append(picture)
    return rows, pictures


@click.command()
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--trace", type=click.Path(exists=True, path_type=Path), required=True)
@click.option("--pose-seconds", default=0.5, show_default=True)
@click.option("--mbit", default=2.0, show_default=True, help="Bandwidth of the link, Mbit/s.")
@click.option("--latency", default=20.0, show_default=True, help="Latency of the link, ms.")
@click.option(
    "--budget", default=0, show_default=True, help="Memory limit, splats; 0 for no limit."
)
@click.option("--source", type=click.Path(exists=True, path_type=Path), help="Compare with it.")
@click.option(
    "--at",
    type=FiniteNumber(0.0),
    multiple=True,
    help="Moment, seconds; repeatable, in place of --moments.",
)
@click.option("--moments", default=12, show_default=True)
@click.option(
    "--seconds", type=FiniteNumber(), help="Part of the trace to follow; by default all of it."
)
@click.option(
    "--splats-per-second",
    default=2e6,
    show_default=True,
    help="Decoding throughput of this machine's workers.",
)
@click.option(
    "--pictures",
    type=click.Path(path_type=Path),
    help="Write pictures of up to six moments as PNG.",
)
@click.option("--json", "as_json", is_flag=True)
def main(
    scene: Path,
    trace: Path,
    pose_seconds: float,
    mbit: float,
    latency: float,
    budget: int,
    source: Path | None,
    at: tuple[float, ...],
    moments: int,
    seconds: float | None,
    splats_per_second: float,
    pictures: Path | None,
    as_json: bool,
) -> None:
    """Compare a visit in Chromium with its simulation."""
    walked = recorded_trace(read_cameras(trace), pose_seconds)
    end = min(seconds or walked.seconds, walked.seconds)
    times = sorted(at) or [end * (k + 1) / moments for k in range(moments)]
    link = Link(1e6 * mbit, latency / 1000.0)
    visit = run_browser(scene, walked, link, times, budget, splats_per_second)
    drawn = None if source is None else cogsplat.read(source)
    with cogsplat.open(scene) as file:
        simulation = Simulation(file, [], compensate=True, source=drawn)
        rows, shown = compare(simulation, walked, link, visit, budget)
    if pictures is not None:
        kept = np.unique(
            np.linspace(0, len(times) - 1, min(len(times), 6)).round().astype(int)
        ).tolist()
        judged = {
            "browser": [
                Moment(rows[k].seconds, rows[k].size_bytes, rows[k].psnr_db, 0.0, 0) for k in kept
            ],
            "simulated": [
                Moment(rows[k].seconds, rows[k].simulated_bytes, rows[k].simulated_db, 0.0, 0)
                for k in kept
            ],
        }
        chosen = {name: [found[k] for k in kept] for name, found in shown.items()}
        write_png(picture_strips(chosen, judged, scene.name), pictures, force=True)
    if as_json:
        click.echo(
            json.dumps(
                {
                    "rows": [asdict(row) for row in rows],
                    "first_rows_s": visit.first_rows,
                    "page_bytes": visit.page_bytes,
                    "worker_bytes": visit.worker_bytes,
                }
            )
        )
        return
    for row in rows:
        click.echo(
            f"{row.seconds:6.2f} s  {row.splats:8,} splats {row.psnr_db:6.2f} dB "
            f"{row.fetched_bytes:10,} B {row.requests:4} requests  simulated "
            f"{row.simulated_splats:8,} {row.simulated_db:6.2f} dB {row.simulated_fetched:10,} B "
            f"{row.simulated_requests:4}"
        )
    browser = visit.browser
    starts = [round(1000.0 * s) for s in (browser.start_seconds, browser.decoder_seconds)]
    click.echo(f"first request after {starts[0]} ms, first worker after {starts[1]} ms")
    click.echo(
        f"first rows after {1000 * visit.first_rows:.0f} ms, memory of the page "
        f"{visit.page_bytes / 1e6:.1f} MB, of its workers {visit.worker_bytes / 1e6:.1f} MB"
    )
    away = np.array([abs(row.psnr_db - row.simulated_db) for row in rows])
    click.echo(f"differences: {away.mean():.2f} dB on average, {away.max():.2f} at most")


if __name__ == "__main__":
    main()
