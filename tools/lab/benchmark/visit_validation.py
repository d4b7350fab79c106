"""Validation of the simulated `visit` policy against a real browser.

Run ``python -m cogsplat.tools.lab.benchmark.visit_validation SCENE.cogs --cameras PATH --trace
WALK.json`` from a checkout, after ``npm ci && npm run build`` in ``tools/web``.

Headless Chromium follows the path with the npm package over a slow link and records which chunks
it has decoded at given times. The recorded and the simulated chunks are rendered afterwards by the
Python renderer, so software WebGL does not affect the result. The simulation uses the browser's
measured start times of the first request and of decoding.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, TypedDict

import click
import numpy as np

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.delivery import slow_server
from cogsplat.tools.delivery.slow_server import SlowServer, running
from cogsplat.tools.lab.scheduling.poses import Pose
from cogsplat.tools.lab.streaming.client import Link, Units
from cogsplat.tools.lab.streaming.comparison import Moment, Simulation
from cogsplat.tools.lab.streaming.curves import picture_strips
from cogsplat.tools.lab.streaming.traces import Trace, recorded_trace
from cogsplat.tools.lab.streaming.visit_client import Browser
from cogsplat.tools.pictures.png import write_png
from cogsplat.tools.terminal.values import FiniteNumber

from .chromium import opened_page

_WEB: Final = Path(__file__).resolve().parents[2] / "web"
_PAGE: Final = b'<!doctype html><title>visit</title><script type="module" src="visits.js"></script>'
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
    psnr_db, simulated_db : float
        PSNR of both pictures against the full scene at the pose.
    """

    seconds: float
    splats: int
    simulated_splats: int
    size_bytes: int
    simulated_bytes: int
    psnr_db: float
    simulated_db: float


def run_browser(
    scene: Path,
    trace: Trace,
    link: Link,
    moments: list[float],
    budget_splats: int,
    splats_per_second: float,
) -> tuple[Browser, list[PageState]]:
    """Follow a camera path in Chromium; return its delays, and the chunks decoded at given times.

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

    Returns
    -------
    tuple of Browser and list of PageState
    """
    files = {"index.html": _PAGE, "visits.js": (_WEB / "scripts" / "visits.js").read_bytes()}
    for name in ("cogsplat.js", "worker.js", "visit.js"):
        files[name] = (_WEB / "dist" / name).read_bytes()
    times = np.arange(0.0, trace.seconds + _FRAME_SECONDS, _FRAME_SECONDS)
    visit = {
        "url": "/scene.cogs",
        "poses": [_pose(Pose.from_camera(trace.camera_at(float(seconds)))) for seconds in times],
        "interval": _FRAME_SECONDS,
        "budget": budget_splats,
        "moments": moments,
    }
    programs = dict(files)
    files["scene.cogs"] = scene.read_bytes()
    with (
        running(SlowServer(files, cached=programs)) as server,
        opened_page(server.url, "window.visit !== undefined") as page,
    ):
        # Warm-up without a slow link: compiles the programs and starts the workers.
        page.evaluate("(visit) => window.visit(visit)", {**visit, "moments": [0.5]})
        server.link = slow_server.Link(link.bits_per_second, link.latency)
        result = page.evaluate("(visit) => window.visit(visit)", visit)
    browser = Browser(result["started"], splats_per_second, result["decoding"])
    return browser, result["noted"]


def _pose(pose: Pose) -> dict[str, object]:
    """Return a pose as the JSON object that the page's script takes."""
    return {
        "position": pose.position.tolist(),
        "rotation": np.asarray(pose.rotation).ravel().tolist(),
        "tanX": pose.tan_x,
        "tanY": pose.tan_y,
    }


def units_of_chunks(units: Units, chunks: list[tuple[int, bool, bool]]) -> list[int]:
    """Return the numbers of the units that a page had decoded: heads, refinements and tails."""
    found = []
    for chunk, refined, tail in chunks:
        kinds = {SegmentKind.HEAD: True, SegmentKind.REFINEMENT: refined, SegmentKind.TAIL: tail}
        present = [kind for kind, is_present in kinds.items() if is_present]
        found += np.flatnonzero((units.chunk == chunk) & np.isin(units.kind, present)).tolist()
    return found


def compare(
    simulation: Simulation,
    trace: Trace,
    link: Link,
    noted: list[PageState],
    budget_splats: int,
    browser: Browser,
) -> tuple[list[Comparison], dict[str, list[np.ndarray]]]:
    """Compare the chunks that a browser had decoded with the simulated chunks.

    Parameters
    ----------
    simulation : Simulation
    trace : Trace
        Camera path of the visit.
    link : Link
    noted : list of PageState
        Chunks recorded in the browser.
    budget_splats : int
        Memory limit, splats; 0 for no limit.
    browser : Browser
        Delays of the browser.

    Returns
    -------
    tuple of list of Comparison and dict of str to list of pictures
        One row per recorded time, and pictures by source: ``""`` for the reference, ``browser``,
        ``simulated``.
    """
    client = simulation.client("visit")
    arrivals = simulation.arrivals(
        "visit", client, trace, link, budget_splats=budget_splats, browser=browser
    )
    rows = []
    pictures: dict[str, list[np.ndarray]] = {"": [], "browser": [], "simulated": []}
    for entry in noted:
        seconds = entry["seconds"]
        camera = trace.camera_at(seconds)
        reference = simulation.picture(camera)
        held = [units_of_chunks(simulation.units, entry["chunks"]), arrivals.present_at(seconds)]
        of_chunks = np.where(simulation.units.chunk >= 0, simulation.units.size_bytes, 0)
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
                psnr(pair[0], reference),
                psnr(pair[1], reference),
            )
        )
        for name, picture in zip(pictures, (reference, *pair), strict=True):
            pictures[name].append(picture)
    return rows, pictures


@click.command()
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--cameras", type=click.Path(exists=True, path_type=Path), required=True)
@click.option("--trace", type=click.Path(exists=True, path_type=Path), required=True)
@click.option("--pose-seconds", default=0.5, show_default=True)
@click.option("--mbit", default=2.0, show_default=True, help="Bandwidth of the link, Mbit/s.")
@click.option("--latency", default=20.0, show_default=True, help="Latency of the link, ms.")
@click.option(
    "--budget", default=0, show_default=True, help="Memory limit, splats; 0 for no limit."
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
    cameras: Path,
    trace: Path,
    pose_seconds: float,
    mbit: float,
    latency: float,
    budget: int,
    moments: int,
    seconds: float | None,
    splats_per_second: float,
    pictures: Path | None,
    as_json: bool,
) -> None:
    """Compare a visit in Chromium with its simulation."""
    walked = recorded_trace(read_cameras(trace), pose_seconds)
    known, _ = hold_out(read_cameras(cameras), 8)
    end = min(seconds or walked.seconds, walked.seconds)
    times = [end * (k + 1) / moments for k in range(moments)]
    link = Link(1e6 * mbit, latency / 1000.0)
    browser, noted = run_browser(scene, walked, link, times, budget, splats_per_second)
    with cogsplat.open(scene) as file:
        simulation = Simulation(file, known, compensate=True)
    rows, shown = compare(simulation, walked, link, noted, budget, browser)
    if pictures is not None:
        kept = np.unique(np.linspace(0, moments - 1, min(moments, 6)).round().astype(int)).tolist()
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
        click.echo(json.dumps([asdict(row) for row in rows]))
        return
    for row in rows:
        click.echo(
            f"{row.seconds:6.2f} s  {row.splats:8,} splats {row.psnr_db:6.2f} dB  simulated "
            f"{row.simulated_splats:8,} {row.simulated_db:6.2f} dB"
        )
    starts = [round(1000.0 * s) for s in (browser.start_seconds, browser.decoder_seconds)]
    click.echo(f"first request after {starts[0]} ms, first worker after {starts[1]} ms")
    away = np.array([abs(row.psnr_db - row.simulated_db) for row in rows])
    click.echo(f"differences: {away.mean():.2f} dB on average, {away.max():.2f} at most")


if __name__ == "__main__":
    main()
