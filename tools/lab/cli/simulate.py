"""``cogsplat lab simulate``: what visitors see while a client chooses what to fetch next."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.tools.cli.serve import BitRate
from cogsplat.tools.lab.streaming.client import Link
from cogsplat.tools.lab.streaming.comparison import (
    PEER,
    POLICIES,
    SHARES,
    Moment,
    Simulation,
    bytes_until,
    moments_behind,
)
from cogsplat.tools.lab.streaming.curves import picture_strips, psnr_chart
from cogsplat.tools.lab.streaming.goal_bytes import bytes_to_hold_goal
from cogsplat.tools.lab.streaming.streamed_sog import BUDGET_SPLATS, streamed_sog_client
from cogsplat.tools.lab.streaming.traces import Trace, dolly_trace, orbital_trace, recorded_trace
from cogsplat.tools.pictures.png import write_png
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.option_groups import GroupedCommand
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    print_table,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, WRITTEN_PATH
from cogsplat.tools.terminal.values import FiniteNumber, number_of_bytes
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    input_source,
    is_cogs_input,
    load_cameras,
    read_any,
)
from cogsplat.tools.workflow.output_files import check_outputs

# Moments in a film strip at most; more do not fit on a page.
_STRIP_PICTURES: Final = 6


# `--help` shows the first group.
_GROUPS: Final = {
    "Most used": (
        "--cameras",
        "--trace",
        "--bandwidth",
        "--latency",
        "--policy",
        "--moments",
        "--source",
        "--goal",
        "--csv",
        "--plot",
        "--force",
        "--config",
        "--json",
        "--help-all",
        "--help",
    ),
}


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog="\b\nExample:\n"
    "  cogsplat lab simulate scene.cogs --cameras scene.cameras.json\n"
    "  cogsplat lab simulate house.cogs --cameras views.json --trace walk.json",
)
@click.argument("path", type=INPUT, metavar="IN.cogs")
@click.option("--cameras", type=PATH, required=True, metavar="PATH", help="Cameras of the scene.")
@click.option(
    "--trace",
    default="orbital",
    show_default=True,
    metavar="orbital|dolly|PATH",
    help="Path of the visitor: to 40 of the test views, 2 s each; from the first test view to the "
    "second in 20 s; or through the cameras of a file.",
)
@click.option(
    "--pose-seconds",
    type=FiniteNumber(0.0, min_open=True),
    default=0.5,
    show_default=True,
    metavar="S",
    help="Time between two cameras of a --trace file, seconds.",
)
@click.option(
    "--bandwidth",
    type=BitRate(),
    metavar="BITS",
    help="Bandwidth, bits per second, such as 10M; by default the whole file arrives within the "
    "trace.",
)
@click.option(
    "--as-large-as",
    type=number_of_bytes,
    metavar="SIZE",
    help="Scale the bandwidth down so that the file takes as long as a file of SIZE would, such as "
    "734MB.",
)
@click.option(
    "--latency",
    type=FiniteNumber(0.0),
    default=20.0,
    show_default=True,
    metavar="MS",
    help="Time from a request to the first byte of its answer, milliseconds.",
)
@click.option(
    "--requests",
    "most_requests",
    type=click.IntRange(1, 1024),
    default=6,
    show_default=True,
    metavar="N",
    help="Requests at a time, at most, of the policy visit. Browsers send 6 over HTTP/1.1; the npm "
    "package sends 24 over HTTP/2 and HTTP/3.",
)
@click.option(
    "--policy",
    "policies",
    type=click.Choice(POLICIES),
    multiple=True,
    metavar="NAME",
    help=f"Fetch order of the client. Repeatable, by default all: {', '.join(POLICIES)}.",
)
@click.option(
    "--budget",
    type=click.IntRange(1),
    metavar="N",
    help="Splats in memory at most, for the policy visit, which evicts others, by default "
    "unlimited; and for --peer, by default 4 million.",
)
@click.option(
    "--source",
    type=INPUT,
    metavar="SCENE",
    help="Compare with renders of this scene instead of renders of the whole file.",
)
@click.option(
    "--peer",
    type=PATH,
    metavar="PATH/lod-meta.json",
    help=f"Streamed SOG of --source, fetched by PlayCanvas' rules as the policy {PEER}.",
)
@click.option(
    "--moments",
    type=click.IntRange(1, 1000),
    default=12,
    show_default=True,
    metavar="N",
    help="Number of measured pictures along the trace.",
)
@click.option(
    "--eval-every",
    type=click.IntRange(2),
    default=8,
    show_default=True,
    metavar="N",
    help="Hold out every N-th camera as a test view; contributions of chunks are known in "
    "the others.",
)
@click.option(
    "--compensate/--as-stored",
    default=True,
    show_default=True,
    help="Whether clients apply prefix compensation.",
)
@click.option(
    "--goal",
    type=FiniteNumber(0.0, 100.0),
    default=50.0,
    show_default=True,
    metavar="DB",
    help="PSNR whose bytes are reported: the least from which the trace stays above it.",
)
@click.option(
    "--wait",
    is_flag=True,
    help="Also report the bytes a viewer must fetch to hold --goal dB at every moment, ignoring "
    "bandwidth.",
)
@click.option(
    "--csv",
    "csv_path",
    type=WRITTEN_PATH,
    metavar="OUT.csv",
    help="Write the results of every moment.",
)
@click.option(
    "--plot",
    "plot_path",
    type=WRITTEN_PATH,
    metavar="OUT.svg",
    help="Write a chart of PSNR over time.",
)
@click.option(
    "--strip",
    "strip_path",
    type=WRITTEN_PATH,
    metavar="OUT.png",
    help="Write pictures of up to six moments, one row per policy.",
)
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
    as_large_as: int | None,
    latency: float,
    most_requests: int,
    policies: tuple[str, ...],
    budget: int | None,
    source: Path | None,
    peer: Path | None,
    moments: int,
    eval_every: int,
    compensate: bool,
    goal: float,
    wait: bool,
    csv_path: Path | None,
    plot_path: Path | None,
    strip_path: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Simulate clients that fetch by the view of a visitor.

    Received splats are compared with the whole scene, along the trace and in test views at rest.
    Files encoded with --cells gain most.

    Policies that fetch segments: whole and file use the order of the file, whole without showing
    parts; distance fetches whole chunks by distance, sgss by the priority of SGSS. frustum, views
    and oracle delay chunks with little contribution, estimated from bounding boxes, from the view
    table or other cameras, or from the true view. visit is the policy of the npm package: by the
    view table, along the predicted path, within --budget.

    antimatter and sgss-cells fetch single splats, by volume times opacity or by cells of SGSS, each
    splat at the file's mean bytes. --peer adds a client of Streamed SOG on the same link.
    """
    if not is_cogs_input(path):
        raise click.UsageError(f"{path}: is no COGS file, expected one")
    if as_large_as is not None and bandwidth is None:
        raise click.UsageError("--as-large-as without --bandwidth, expected both")
    if peer is not None and source is None:
        raise click.UsageError("--peer without --source, expected the common source scene")
    check_outputs(csv_path, plot_path, strip_path, force=force)
    chosen = (policies or POLICIES) + (() if peer is None else (PEER,))
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            known, tests = hold_out(load_cameras(cameras), eval_every)
            if not known:
                raise click.UsageError(f"{cameras}: {len(tests)} cameras, expected two at least")
            walked = _trace(trace, tests, pose_seconds)
            file = cogsplat.open(
                input_source(path), partial=partial_accepted(), limits=current_limits()
            )
            drawn = None
            if source is not None:
                drawn = drop_invalid_splats(read_any(source, threads=threads).splats, source)
            other = None
            if peer is not None:
                other = streamed_sog_client(peer, budget or BUDGET_SPLATS, limits=current_limits())
        with file:
            simulation = Simulation(
                file,
                known,
                threads=threads,
                compensate=compensate,
                source=drawn,
                peer=other,
                progress=stages,
            )
            bits = _bits_for(simulation, walked, bandwidth, as_large_as)
            link = Link(bits, latency / 1000.0, most_requests)
            film = _StripPictures(moments if strip_path is not None else 0)
            measured = simulation.run_trace(
                walked, link, chosen, moments, stages, film.add, budget_splats=budget or 0
            )
            waited = (
                bytes_to_hold_goal(simulation, walked, chosen, moments, goal, stages)
                if wait
                else {}
            )
            at_rest = simulation.at_rest(tests, chosen, stages)
    if csv_path is not None:
        _write_csv(measured, csv_path, force=force)
    against = "the whole" if source is None else display_name(source)
    title = f"{display_name(path)}, {trace} at {bits / 1e6:.3g} Mbit/s"
    if plot_path is not None:
        with atomic_write(plot_path, force=force) as opened:
            opened.write(psnr_chart(measured, title).encode())
    if strip_path is not None:
        pages = picture_strips(film.pictures, film.kept_moments(measured), title)
        write_png(pages, strip_path, force=force)
    results = _Results(simulation, measured, at_rest, waited, goal)
    if as_json:
        print_json(
            {
                "source": display_name(path),
                "bytes": int(simulation.units.size_bytes.sum()),
                "chunks": simulation.chunks,
                "known_views": simulation.known_views,
                "views": len(tests),
                "trace_s": walked.seconds,
                "bits_per_second": bits,
                "latency_s": link.latency,
                "most_requests": link.most_requests,
                "compensated": compensate,
                "goal_db": goal,
                "compared_with": display_name(path if source is None else source),
                "policies": [_policy_report(results, name) for name in chosen],
                "seconds": stages.rounded_seconds(),
            }
        )
        return
    if quiet:
        return
    print_line(
        f"{walked.seconds:.1f} s of {trace} at {bits / 1e6:.3g} Mbit/s: mean PSNR (dB) and SSIM of "
        f"the trace against {against}; share of the bytes from which PSNR stays at {goal:g} dB; "
        "share of the bytes fetched without showing; "
        + (f"share fetched to hold {goal:g} dB at each moment; " if wait else "")
        + "PSNR in test views at rest after shares of the bytes"
    )
    waiting = ("waited",) if wait else ()
    shares = (f"{share:.0%}" for share in SHARES)
    print_table(
        ("policy", "trace", "SSIM", f"{goal:g} dB", "waste", *waiting, *shares),
        [_policy_row(results, name) for name in chosen],
    )
    print_facts(
        ("file", f"{simulation.chunks} chunks"),
        ("known", f"contributions of each chunk to {simulation.known_views} views"),
        ("time", stages.summary()),
    )


def _trace(name: str, tests: list[cogsplat.Camera], pose_seconds: float) -> Trace:
    """Return the path that ``--trace`` names."""
    if name == "orbital":
        return orbital_trace(tests)
    if name == "dolly":
        return dolly_trace(tests)
    return recorded_trace(load_cameras(Path(name)), pose_seconds)


def _bits_for(
    simulation: Simulation, trace: Trace, bandwidth: float | None, as_large_as: int | None
) -> float:
    """Return the bandwidth, bits per second; by default the whole file arrives within the trace."""
    total = float(simulation.units.size_bytes.sum()) + simulation.units.index_bytes
    if bandwidth is None:
        return 8.0 * total / (trace.seconds or 1.0)
    return bandwidth if as_large_as is None else bandwidth * total / as_large_as


@dataclass(frozen=True, eq=False)
class _Results:
    """Results of all simulated clients, by policy.

    Parameters
    ----------
    simulation : Simulation
        Simulation of the file.
    along : dict of str to list of Moment
        Moments along the trace.
    at_rest : dict of str to list of float
        PSNR in the test views after `SHARES` of the bytes, dB.
    waited : dict of str to list of int
        Bytes fetched to hold the goal at each moment; empty without ``--wait``.
    goal_db : float
        PSNR of ``--goal``, dB.
    """

    simulation: Simulation
    along: dict[str, list[Moment]]
    at_rest: dict[str, list[float]]
    waited: dict[str, list[int]]
    goal_db: float

    def mean_db(self, policy: str) -> float:
        """Return the mean PSNR of a policy along the trace, dB."""
        return float(np.mean([moment.psnr_db for moment in self.along[policy]]))


def _policy_report(results: _Results, policy: str) -> dict[str, object]:
    """Return the results of a policy for JSON output."""
    along = results.along[policy]
    in_file_order = results.along.get("file")
    return {
        "policy": policy,
        "psnr_db": results.mean_db(policy),
        "goal_bytes": bytes_until(along, results.goal_db),
        "behind_file": (
            None if in_file_order is None else moments_behind(along, in_file_order, results.goal_db)
        ),
        "waited_bytes": results.waited.get(policy),
        "moments": [
            {
                "time_s": moment.seconds,
                "bytes": moment.bytes,
                "psnr_db": moment.psnr_db,
                "ssim": moment.ssim,
                "wasted_bytes": moment.wasted_bytes,
                "requests": moment.requests,
            }
            for moment in along
        ],
        "at_rest": [
            {"share": share, "psnr_db": quality}
            for share, quality in zip(SHARES, results.at_rest[policy], strict=True)
        ],
    }


def _policy_row(results: _Results, policy: str) -> tuple[str, ...]:
    """Return the results of a policy as a row of the table."""
    along, simulation = results.along[policy], results.simulation
    waited = results.waited.get(policy)
    return (
        policy,
        f"{results.mean_db(policy):.2f}",
        f"{np.mean([moment.ssim for moment in along]):.3f}",
        _share(bytes_until(along, results.goal_db), simulation),
        _share(along[-1].wasted_bytes, simulation),
        *(() if waited is None else (_share(waited[-1], simulation),)),
        *(f"{quality:.2f}" for quality in results.at_rest[policy]),
    )


def _share(size: int | None, simulation: Simulation) -> str:
    """Return bytes as a share of the file, as text."""
    return "" if size is None else f"{size / simulation.units.size_bytes.sum():.0%}"


class _StripPictures:
    """Pictures for the film strip: some moments of each policy, evenly spaced up to the last.

    Parameters
    ----------
    moments : int
        Number of moments along the trace; 0 to keep no picture.
    """

    def __init__(self, moments: int) -> None:
        kept = min(moments, _STRIP_PICTURES)
        self._kept = [round((k + 1) * moments / kept) - 1 for k in range(kept)]
        self._counts: dict[str, int] = {}
        self.pictures: dict[str, list[NDArray[np.float32]]] = {}

    def add(self, policy: str, _: float, picture: NDArray[np.float32]) -> None:
        """Keep the picture of a policy's next moment if that moment is in the strip."""
        number = self._counts.get(policy, 0)
        self._counts[policy] = number + 1
        if number in self._kept:
            self.pictures.setdefault(policy, []).append(picture)

    def kept_moments(self, along: dict[str, list[Moment]]) -> dict[str, list[Moment]]:
        """Return the moments whose pictures are kept, by policy."""
        return {name: [seen[number] for number in self._kept] for name, seen in along.items()}


def _write_csv(along: dict[str, list[Moment]], path: Path, *, force: bool) -> None:
    """Write all moments as CSV."""
    page = io.StringIO()
    lines = csv.writer(page, lineterminator="\n")
    lines.writerow(("policy", "time_s", "bytes", "psnr_db", "ssim", "wasted_bytes", "requests"))
    for name, seen in along.items():
        for m in seen:
            figures = f"{m.seconds:.4f}", m.bytes, f"{m.psnr_db:.3f}", f"{m.ssim:.4f}"
            lines.writerow((name, *figures, m.wasted_bytes, m.requests))
    with atomic_write(path, force=force) as file:
        file.write(page.getvalue().encode())
