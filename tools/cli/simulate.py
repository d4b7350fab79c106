"""``cogsplat simulate``: what visitors see while a client chooses what to fetch next."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import click
import numpy as np

import cogsplat
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.storage.atomic import atomic_write, check_output
from cogsplat.tools.streaming.client import Link
from cogsplat.tools.streaming.comparison import POLICIES, SHARES, Moment, Simulation
from cogsplat.tools.streaming.traces import Trace, dolly, orbital, recorded
from cogsplat.tools.terminal.limits import current_limits, limits_option
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import facts, name_of, say, say_json, table
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH

from .inputs import given_cameras, given_files, input_source, is_cogs_input
from .serve import BitRate


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat simulate scene.cogs --cameras scene.cameras.json\n"
    "  cogsplat simulate house.cogs --cameras views.json --trace house.walk.json"
)
@click.argument("path", type=INPUT, metavar="IN.cogs")
@click.option("--cameras", type=PATH, required=True, metavar="PATH", help="Views of the scene.")
@click.option(
    "--trace",
    default="orbital",
    show_default=True,
    metavar="orbital|dolly|PATH",
    help="Where a visitor goes: to 40 of the test views, 2 s each; from the first test view to "
    "the second in 20 s; or through the cameras of a file.",
)
@click.option(
    "--pose-seconds",
    type=click.FloatRange(0.0, min_open=True),
    default=0.5,
    show_default=True,
    metavar="S",
    help="From one camera of such a file to the next.",
)
@click.option(
    "--bandwidth",
    type=BitRate(),
    metavar="BITS",
    help="Bits a second, such as 10M; by default so many that the whole takes as long as the "
    "trace.",
)
@click.option(
    "--latency",
    type=click.FloatRange(0.0),
    default=20.0,
    show_default=True,
    metavar="MS",
    help="Milliseconds from a request to the first byte of its answer.",
)
@click.option(
    "--policy",
    "policies",
    type=click.Choice(POLICIES),
    multiple=True,
    help="How the client chooses; several times for several, by default all.",
)
@click.option(
    "--moments",
    type=click.IntRange(1, 1000),
    default=12,
    show_default=True,
    metavar="N",
    help="Pictures along the trace that are judged.",
)
@click.option(
    "--eval-every",
    type=click.IntRange(2),
    default=8,
    show_default=True,
    metavar="N",
    help="Every so many cameras are the test views; what chunks contribute is known of others.",
)
@click.option("--csv", "csv_path", type=PATH, metavar="OUT.csv", help="Write every moment.")
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def simulate(
    path: Path,
    cameras: Path,
    trace: str,
    pose_seconds: float,
    bandwidth: float | None,
    latency: float,
    policies: tuple[str, ...],
    moments: int,
    eval_every: int,
    csv_path: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Simulate clients that fetch IN.cogs by what a visitor looks at.

    Each policy fetches the same segments in another order: the file's, whole chunks by distance,
    by the priority of SGSS, and the file's order put off where boxes, the contributions to the
    nearest views, or those to the pose itself (which no client knows) say that a chunk shows
    little. Pictures of what has arrived are compared with those of the whole, along the trace and
    in test views at rest. Files that were encoded with --cells gain most.
    """
    if not is_cogs_input(path):
        raise click.UsageError(f"{path}: is no COGS file, expected one")
    if csv_path is not None:
        check_output(csv_path, force=force, inputs=given_files(path, cameras))
    chosen = policies or POLICIES
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            known, tests = hold_out(given_cameras(cameras), eval_every)
            if not known:
                raise click.UsageError(f"{cameras}: {len(tests)} cameras, expected two at least")
            walked = _trace(trace, tests, pose_seconds)
            file = cogsplat.open(
                input_source(path), partial=partial_accepted(), limits=current_limits()
            )
        with file:
            simulation = Simulation(file, known, threads=threads, progress=stages)
        bits = bandwidth or _bits_for(simulation, walked)
        link = Link(bits, latency / 1000.0)
        along = simulation.along(walked, link, chosen, moments, stages)
        at_rest = simulation.at_rest(tests, chosen, stages)
    if csv_path is not None:
        _write_csv(along, csv_path, force=force)
    means = {name: float(np.mean([m.psnr_db for m in seen])) for name, seen in along.items()}
    if as_json:
        say_json(
            {
                "source": name_of(path),
                "bytes": int(simulation.units.size_bytes.sum()),
                "chunks": simulation.chunks,
                "known_views": simulation.known_views,
                "views": len(tests),
                "trace_s": walked.seconds,
                "bits_per_second": bits,
                "latency_s": link.latency,
                "policies": [
                    {
                        "policy": name,
                        "psnr_db": means[name],
                        "moments": [
                            {"time_s": m.seconds, "bytes": m.bytes, "psnr_db": m.psnr_db}
                            for m in along[name]
                        ],
                        "at_rest": [
                            {"share": share, "psnr_db": quality}
                            for share, quality in zip(SHARES, at_rest[name], strict=True)
                        ],
                    }
                    for name in chosen
                ],
                "seconds": stages.rounded(),
            }
        )
        return
    if quiet:
        return
    say(
        f"{walked.seconds:.1f} s of {trace} at {bits / 1e6:.3g} Mbit/s: PSNR against the whole, "
        "dB, mean of the trace, and in test views at rest after shares of the bytes"
    )
    rows = [
        (name, f"{means[name]:.2f}", *(f"{quality:.2f}" for quality in at_rest[name]))
        for name in chosen
    ]
    table(("policy", "trace", *(f"{share:.0%}" for share in SHARES)), rows)
    facts(
        ("file", f"{simulation.chunks} chunks"),
        ("known", f"what each chunk contributes to {simulation.known_views} views"),
        ("time", stages.line()),
    )


def _trace(name: str, tests: list[cogsplat.Camera], pose_seconds: float) -> Trace:
    if name == "orbital":
        return orbital(tests)
    if name == "dolly":
        return dolly(tests)
    return recorded(given_cameras(Path(name)), pose_seconds)


def _bits_for(simulation: Simulation, trace: Trace) -> float:
    """Return the bandwidth at which the whole takes as long as the trace, or a second."""
    total = float(simulation.units.size_bytes.sum()) + simulation.units.opening_bytes
    return 8.0 * total / (trace.seconds or 1.0)


def _write_csv(along: dict[str, list[Moment]], path: Path, *, force: bool) -> None:
    page = io.StringIO()
    lines = csv.writer(page, lineterminator="\n")
    lines.writerow(("policy", "time_s", "bytes", "psnr_db"))
    for name, seen in along.items():
        for moment in seen:
            lines.writerow((name, f"{moment.seconds:.4f}", moment.bytes, f"{moment.psnr_db:.3f}"))
    with atomic_write(path, force=force) as file:
        file.write(page.getvalue().encode())
