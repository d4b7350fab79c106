"""A visit in a real browser beside its simulation: what is seen at moments along a path.

Run ``python -m cogsplat.tools.lab.benchmark.visits SCENE.cogs --cameras PATH --trace
WALK.json`` from a checkout, after ``npm ci && npm run build`` in ``tools/web``.

Headless Chromium visits the scene with the npm package over a slow link; which chunks it has
decoded at each moment is noted, and drawn afterwards by our renderer, as is what
``cogsplat lab simulate --policy visit`` predicts: the speed of this machine's software WebGL does
not count. The simulation makes its first request and starts to decode when the browser did.
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

from .chromium import opened_page

_WEB: Final = Path(__file__).resolve().parents[2] / "web"
_PAGE: Final = b'<!doctype html><title>visit</title><script type="module" src="visits.js"></script>'
_LOOK_SECONDS: Final = 1 / 30
"""Between two pictures of a browser."""


class Noted(TypedDict):
    """What the page had at a moment.

    A chunk is its number, whether it is refined, and whether it has its tail.
    """

    seconds: float
    chunks: list[tuple[int, bool, bool]]


@dataclass(frozen=True)
class Comparison:
    """A moment of a visit.

    Parameters
    ----------
    seconds : float
        From the opening of the scene on.
    splats, simulated_splats : int
        That were in memory.
    size_bytes, simulated_bytes : int
        Of the chunks that were in memory.
    psnr_db, simulated_db : float
        Of the picture from the visitor's pose, against that of the whole scene.
    """

    seconds: float
    splats: int
    simulated_splats: int
    size_bytes: int
    simulated_bytes: int
    psnr_db: float
    simulated_db: float


def in_browser(
    scene: Path,
    trace: Trace,
    link: Link,
    moments: list[float],
    budget_splats: int,
    splats_per_second: float,
) -> tuple[Browser, list[Noted]]:
    """Visit a scene in Chromium: what that adds to the link's times, and what it had at moments.

    Parameters
    ----------
    scene : Path
    trace : Trace
    link : Link
    moments : list of float
        Seconds from the opening of the scene on.
    budget_splats : int
        Most splats in memory; 0 for any number.
    splats_per_second : float
        That this machine's workers decode.

    Returns
    -------
    tuple of Browser and list of Noted
    """
    files = {"index.html": _PAGE, "visits.js": (_WEB / "scripts" / "visits.js").read_bytes()}
    for name in ("cogsplat.js", "worker.js", "visit.js"):
        files[name] = (_WEB / "dist" / name).read_bytes()
    times = np.arange(0.0, trace.seconds + _LOOK_SECONDS, _LOOK_SECONDS)
    visit = {
        "url": "/scene.cogs",
        "poses": [_pose(Pose.from_camera(trace.camera_at(float(seconds)))) for seconds in times],
        "interval": _LOOK_SECONDS,
        "budget": budget_splats,
        "moments": moments,
    }
    programs = dict(files)
    files["scene.cogs"] = scene.read_bytes()
    with (
        running(SlowServer(files, cached=programs)) as server,
        opened_page(server.url, "window.visit !== undefined") as page,
    ):
        # Once without a link: programs are compiled, and workers have been started.
        page.evaluate("(visit) => window.visit(visit)", {**visit, "moments": [0.5]})
        server.link = slow_server.Link(link.bits_per_second, link.latency)
        result = page.evaluate("(visit) => window.visit(visit)", visit)
    browser = Browser(result["started"], splats_per_second, result["decoding"])
    return browser, result["noted"]


def _pose(pose: Pose) -> dict[str, object]:
    return {
        "position": pose.position.tolist(),
        "rotation": np.asarray(pose.rotation).ravel().tolist(),
        "tanX": pose.tan_x,
        "tanY": pose.tan_y,
    }


def units_there(units: Units, chunks: list[tuple[int, bool, bool]]) -> list[int]:
    """Return the units of chunks as a page noted them."""
    found = []
    for chunk, refined, tail in chunks:
        kinds = {SegmentKind.HEAD: True, SegmentKind.REFINEMENT: refined, SegmentKind.TAIL: tail}
        wanted = [kind for kind, is_there in kinds.items() if is_there]
        found += np.flatnonzero((units.chunk == chunk) & np.isin(units.kind, wanted)).tolist()
    return found


def compare(
    simulation: Simulation,
    trace: Trace,
    link: Link,
    noted: list[Noted],
    budget_splats: int,
    browser: Browser,
) -> tuple[list[Comparison], dict[str, list[np.ndarray]]]:
    """Return moments of a visit beside their simulation, and the pictures, by what they show."""
    client = simulation.client("visit")
    arrivals = simulation.arrivals(
        "visit", client, trace, link, budget_splats=budget_splats, browser=browser
    )
    rows = []
    pictures: dict[str, list[np.ndarray]] = {"": [], "browser": [], "simulated": []}
    for entry in noted:
        seconds = entry["seconds"]
        camera = trace.camera_at(seconds)
        whole = simulation.picture(camera)
        held = [units_there(simulation.units, entry["chunks"]), arrivals.present_at(seconds)]
        of_chunks = np.where(simulation.units.chunk >= 0, simulation.units.size_bytes, 0)
        sizes = [int(of_chunks[there].sum()) for there in held]
        drawn = [client.splats_of(there, camera) for there in held]
        shown = [simulation.picture(camera, splats) for splats in drawn]
        rows.append(
            Comparison(
                seconds,
                len(drawn[0]),
                len(drawn[1]),
                sizes[0],
                sizes[1],
                psnr(shown[0], whole),
                psnr(shown[1], whole),
            )
        )
        for name, picture in zip(pictures, (whole, *shown), strict=True):
            pictures[name].append(picture)
    return rows, pictures


@click.command()
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--cameras", type=click.Path(exists=True, path_type=Path), required=True)
@click.option("--trace", type=click.Path(exists=True, path_type=Path), required=True)
@click.option("--pose-seconds", default=0.5, show_default=True)
@click.option("--mbit", default=2.0, show_default=True, help="Of the link, 10⁶ bits a second.")
@click.option("--latency", default=20.0, show_default=True, help="Milliseconds.")
@click.option("--budget", default=0, show_default=True, help="Most splats; 0 for any number.")
@click.option("--moments", default=12, show_default=True)
@click.option("--seconds", type=float, help="Of the trace that are walked; all by default.")
@click.option(
    "--splats-per-second",
    default=2e6,
    show_default=True,
    help="That this machine's workers decode.",
)
@click.option("--pictures", type=click.Path(path_type=Path), help="PNG of up to six moments.")
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
    browser, noted = in_browser(scene, walked, link, times, budget, splats_per_second)
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
    click.echo(f"apart by {away.mean():.2f} dB on average, {away.max():.2f} at most")


if __name__ == "__main__":
    main()
