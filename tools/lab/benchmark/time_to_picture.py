"""Time until a browser has decoded splats that give a certain PSNR, by format.

Run ``python -m cogsplat.tools.lab.benchmark.time_to_picture SCENE --cameras PATH --out DIR`` from a
checkout, after ``npm ci && npm run build`` in ``tools/web``.

Headless Chromium fetches each file over the same slow link and decodes it: COGS with ``tools/web``,
other formats with the decoders of Spark, ``.splat`` also progressively by rows. The splats decoded
at each time are rendered afterwards by the Python renderer in held-out views, so software WebGL
does not affect the result. Programs are loaded and warmed up before the measurement.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import statistics
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.metrics import psnr
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.scenes.registry import FORMATS
from cogsplat.formats.scenes.spz.spz_scene import SPZ_AXES, write_spz
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.tools.delivery.slow_server import SlowServer, running
from cogsplat.tools.pictures.svg_charts import Series, line_chart

from .chromium import opened_page
from .packed_splats import unpack, words_of_band

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Page

_WEB: Final = Path(__file__).resolve().parents[2] / "web"
_PEERS: Final = ("spz", "sog", "compressed ply", "splat")
_TITLES: Final = {"sog": "SOG", "compressed ply": "compressed PLY", "splat": ".splat"}
# Spark 2.2 does not read version 4.
_SPZ_VERSION: Final = 3
_SPLAT_BYTES: Final = 32
"""Bytes per splat of a .splat file."""

# PSNR of a recognisable and of a good picture, dB; the times until both are reported.
_THRESHOLDS_DB: Final = (24.0, 30.0)
_LATENCY_SECONDS: Final = 0.04
_HELD_OUT: Final = 8

_PAGE: Final = b"""<!doctype html><title>arrivals</title>
<script type="importmap">{"imports": {
  "three": "./three.module.js", "three/addons/postprocessing/Pass.js": "./Pass.js"
}}</script>
<script type="module" src="arrivals.js"></script>"""


@dataclass(frozen=True)
class Contender:
    """A file of a compared format, and the decoder that the browser uses for it.

    Parameters
    ----------
    name : str
        Format.
    way : str
        Decoder: ``cogs``, ``spark`` or ``bytes``, a key of ``WAYS`` in
        ``tools/web/scripts/arrivals.js``.
    path : Path
    axes : str
        Axes of the decoder's output.
    """

    name: str
    way: str
    path: Path
    axes: str = "RDF"


@dataclass(frozen=True)
class Arrival:
    """Quality over time while one file is loaded over one link.

    Parameters
    ----------
    name : str
        Format.
    mbit : float
        Bandwidth of the link, Mbit/s.
    size_bytes : int
        Size of the file.
    seconds : tuple of float
        Times since the request at which new splats were decoded.
    quality_db : tuple of float
        Mean PSNR of the views at these times, against renders of the source.
    """

    name: str
    mbit: float
    size_bytes: int
    seconds: tuple[float, ...]
    quality_db: tuple[float, ...]

    def seconds_to(self, least_db: float) -> float | None:
        """Return the time at which a PSNR is first reached, s; None if it is never reached."""
        found = (at for at, db in zip(self.seconds, self.quality_db, strict=True) if db >= least_db)
        return next(found, None)

    def report(self) -> dict[str, object]:
        """Return the figures of the table row by column name."""
        return {
            "format": self.name,
            "mbit": self.mbit,
            "bytes": self.size_bytes,
            "first_s": self.seconds[0],
            **{f"to_{db:g}_db_s": self.seconds_to(db) for db in _THRESHOLDS_DB},
            "last_s": self.seconds[-1],
            "final_db": self.quality_db[-1],
        }


def contenders(splats: Splats, ours: Path, folder: Path) -> list[Contender]:
    """Write a scene in the compared formats; return the written files and the given COGS file.

    Parameters
    ----------
    splats : Splats
    ours : Path
        Path of the scene as COGS.
    folder : Path
        Output folder.
    """
    found = [Contender("COGS", "cogs", ours)]
    for name in _PEERS:
        format_ = next(format_ for format_ in FORMATS if format_.name == name)
        path = folder / f"scene{format_.extensions[0]}"
        if name == "spz":
            write_spz(splats, path, version=_SPZ_VERSION, precision="usual", force=True)
            found.append(Contender("SPZ", "spark", path, SPZ_AXES))
            continue
        if format_.write is None:
            raise ValueError(f"format {name!r} is not written")
        format_.write(splats, path, force=True)
        found.append(Contender(_TITLES[name], "spark", path))
    rows = next(contender for contender in found if contender.path.suffix == ".splat")
    return [*found, Contender(".splat by rows", "bytes", rows.path)]


class PictureComparison:
    """Comparison of decoded scenes with renders of a source in fixed views.

    Parameters
    ----------
    source : Splats
        Scene of the reference renders.
    cameras : sequence of Camera
        Views to compare in.
    """

    def __init__(self, source: Splats, cameras: Sequence[Camera]) -> None:
        self._cameras = list(cameras)
        self._references = self._draw(source)

    def _draw(self, splats: Splats) -> list[NDArray[np.float32]]:
        """Render a scene in all views, clipped to 0 to 1."""
        from cogsplat.codec.render.rasteriser import render_views

        return [np.clip(picture, 0, 1) for picture in render_views(splats, self._cameras)]

    def quality_db(self, splats: Splats) -> float:
        """Return the mean PSNR of a scene over the views, against the reference renders, dB."""
        pairs = zip(self._draw(splats), self._references, strict=True)
        return statistics.fmean(psnr(picture, reference) for picture, reference in pairs)


def load_median(page: Page, server: SlowServer, contender: Contender, runs: int) -> list[float]:
    """Load a file repeatedly until the last load takes about the median time of all loads.

    The page keeps the snapshots of the last load, which are then measured. A snapshot is the splats
    decoded at one time.

    Parameters
    ----------
    page : Page
        Page of `page_files`.
    server : SlowServer
        Server of the page, with its link.
    contender : Contender
    runs : int
        Minimum number of loads.

    Returns
    -------
    list of float
        Time since the request of each snapshot of the last load, s.
    """
    ends: list[float] = []
    for _ in range(runs):
        copies = _load(page, server, contender)
        ends.append(copies[-1])
    while abs(copies[-1] - statistics.median(ends)) > max(0.05, 0.05 * statistics.median(ends)):
        copies = _load(page, server, contender)
        ends.append(copies[-1])
    return copies


def _load(page: Page, server: SlowServer, contender: Contender) -> list[float]:
    """Load a file once; return the time since the request of each snapshot, s."""
    name = f"scene/{contender.path.name}"
    server.files[name] = contender.path.read_bytes()
    copies = page.evaluate("([way, url]) => window.arrive(way, url)", [contender.way, f"/{name}"])
    return [float(copy["seconds"]) for copy in copies]


def measure(
    page: Page,
    server: SlowServer,
    contender: Contender,
    comparison: PictureComparison,
    mbit: float,
    runs: int,
) -> Arrival:
    """Load a file over the server's link and measure the quality of each snapshot.

    Parameters
    ----------
    page : Page
        Page of `page_files`.
    server : SlowServer
        Server of the page, with its link.
    contender : Contender
    comparison : PictureComparison
    mbit : float
        Bandwidth of the link, Mbit/s, for the result.
    runs : int
        Minimum number of loads of the file.
    """
    seconds = load_median(page, server, contender, runs)
    kept = _sample_snapshots(seconds) if contender.way == "bytes" else range(len(seconds))
    qualities = [comparison.quality_db(_snapshot(page, contender, number)) for number in kept]
    size = contender.path.stat().st_size
    times = tuple(round(seconds[number], 4) for number in kept)
    return Arrival(contender.name, mbit, size, times, tuple(round(db, 3) for db in qualities))


def _sample_snapshots(seconds: Sequence[float], count: int = 24) -> list[int]:
    """Return the numbers of `count` evenly spaced snapshots that include the last one.

    A progressive load by rows has too many snapshots to render each.
    """
    return sorted({round(i * (len(seconds) - 1) / count) for i in range(1, count + 1)})


def _snapshot(page: Page, contender: Contender, number: int) -> Splats:
    """Return the splats that the page had decoded at the time of one snapshot."""
    if contender.way == "bytes":
        size = page.evaluate("(number) => window.bytes(number)", number)
        return _first_rows(contender.path, int(size) // _SPLAT_BYTES)
    found = page.evaluate("(number) => window.arrays(number)", number)
    words = np.frombuffer(base64.b64decode(found["words"]), np.uint32).reshape(-1, 4)
    bands = [
        np.frombuffer(base64.b64decode(band), np.uint32).reshape(-1, words_of_band(degree))
        for degree, band in enumerate(found["sh"], 1)
    ]
    encoding = found["encoding"]
    colours = (float(encoding["rgbMin"]), float(encoding["rgbMax"]))
    info = SceneInfo(axes=contender.axes)
    return convert_axes(unpack(words, bands, colours, encoding["shMax"], info), "RDF")


def _first_rows(path: Path, rows: int) -> Splats:
    """Read the first rows of a .splat file."""
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / path.name
        part.write_bytes(path.read_bytes()[: rows * _SPLAT_BYTES])
        return cogsplat.read(part)


def page_files(node_modules: Path) -> dict[str, bytes]:
    """Return the files of the test page by name.

    Parameters
    ----------
    node_modules : Path
        Folder with ``@sparkjsdev/spark`` and ``three``; without it only COGS can be loaded.
    """
    files = {"index.html": _PAGE, "arrivals.js": (_WEB / "scripts" / "arrivals.js").read_bytes()}
    for name in ("cogsplat.js", "worker.js"):
        files[name] = (_WEB / "dist" / name).read_bytes()
    spark = node_modules / "@sparkjsdev" / "spark" / "dist" / "spark.module.min.js"
    three = node_modules / "three"
    if spark.is_file():
        files[spark.name] = spark.read_bytes()
        files["Pass.js"] = (three / "examples" / "jsm" / "postprocessing" / "Pass.js").read_bytes()
        for name in ("three.module.js", "three.core.js"):
            files[name] = (three / "build" / name).read_bytes()
    return files


def run(
    source: Splats,
    files: Sequence[Contender],
    cameras: Sequence[Camera],
    rates_mbit: Sequence[float],
    node_modules: Path,
    runs: int,
) -> list[Arrival]:
    """Measure the quality over time of each file over each link, in one browser.

    Parameters
    ----------
    source : Splats
        Scene of the reference renders.
    files : sequence of Contender
    cameras : sequence of Camera
        Test views.
    rates_mbit : sequence of float
        Bandwidths of the links, Mbit/s.
    node_modules : Path
        Folder with ``@sparkjsdev/spark`` and ``three``.
    runs : int
        Minimum number of loads of each file; the load of about the median time counts.
    """
    comparison = PictureComparison(source, cameras)
    arrivals = []
    # The browser caches programs, so that the links only carry scenes.
    programs = page_files(node_modules)
    with (
        running(SlowServer(programs, cached=programs)) as server,
        opened_page(server.url, "window.arrive !== undefined") as page,
    ):
        for contender in files:
            _load(page, server, contender)
        server.link.latency_seconds = _LATENCY_SECONDS
        for mbit in rates_mbit:
            server.link.bits_per_second = 1e6 * mbit
            for contender in files:
                arrivals.append(measure(page, server, contender, comparison, mbit, runs))
                click.echo(json.dumps(arrivals[-1].report()))
    return arrivals


def chart(arrivals: Sequence[Arrival], what: str) -> str:
    """Return an SVG chart of quality over time for one link.

    Parameters
    ----------
    arrivals : sequence of Arrival
        Results of one link.
    what : str
        Description of the scene.
    """
    series = []
    for look, arrival in enumerate(arrivals):
        points = [(at, db) for at, db in zip(arrival.seconds, arrival.quality_db, strict=True)]
        name = f"{arrival.name}, {arrival.size_bytes / 1e6:.1f} MB"
        series.append(Series(name, tuple(points), look))
    return line_chart(
        f"Time to picture, {arrivals[0].mbit:g} Mbit/s",
        "seconds from the request",
        "PSNR, dB",
        series,
        note=f"{what}; held-out views against the source; decoded in Chromium, 40 ms latency",
    )


@click.command()
@click.argument("scene", type=click.Path(path_type=Path, exists=True))
@click.option("--cameras", type=click.Path(path_type=Path, exists=True), required=True)
@click.option(
    "--cogs",
    type=click.Path(path_type=Path, exists=True),
    help="The scene as COGS; by default it is encoded with every eighth camera held out.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for figures.")
@click.option("--mbit", default="5,20", show_default=True, help="Bandwidths of the links, Mbit/s.")
@click.option("--runs", default=3, show_default=True, help="Loads of each file.")
@click.option(
    "--node-modules",
    type=click.Path(path_type=Path),
    default=_WEB / "node_modules",
    help="Folder with @sparkjsdev/spark and three.  [default: tools/web/node_modules]",
)
def main(
    scene: Path, cameras: Path, cogs: Path | None, out: Path, mbit: str, runs: int,
    node_modules: Path,
) -> None:  # fmt: skip
    """Measure the time until SCENE is visible, by format."""
    source = cogsplat.read(scene)
    given, held_out = hold_out(read_cameras(cameras), _HELD_OUT)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        if cogs is None:
            cogs = Path(folder) / "scene.cogs"
            cogsplat.encode(source, cogs, cameras=given)
        files = contenders(source, cogs, Path(folder))
        rates = [float(rate) for rate in mbit.split(",")]
        arrivals = run(source, files, held_out, rates, node_modules, runs)
    rows = [arrival.report() for arrival in arrivals]
    table = io.StringIO()
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    _write(out / "time-to-picture.csv", table.getvalue())
    full = [asdict(arrival) for arrival in arrivals]
    _write(out / "time-to-picture.json", json.dumps({"rows": rows, "arrivals": full}, indent=1))
    for rate in rates:
        at_rate = [arrival for arrival in arrivals if arrival.mbit == rate]
        svg = chart(at_rate, f"{len(source):,} splats")
        _write(out / f"time-to-picture-{rate:g}.svg", svg)


def _write(path: Path, text: str) -> None:
    with atomic_write(path, force=True) as file:
        file.write(text.encode())


if __name__ == "__main__":
    main()
