"""Time and memory of encoding and decoding as a function of scene size.

Run ``python -m cogsplat.tools.lab.benchmark.size_scaling --splats 100000,1000000 --out scaling``.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import click
import numpy as np

import cogsplat
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.scenes.ply.ply_scene import write_ply_parts
from cogsplat.formats.storage.atomic import atomic_write, check_output, storage_errors
from cogsplat.formats.storage.source import FileSource
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.pictures.svg_charts import Series, line_chart
from cogsplat.tools.terminal.options import force_option, json_option, threads_option
from cogsplat.tools.terminal.output import print_json, print_line, print_table
from cogsplat.tools.terminal.standard_streams import WRITTEN_PATH
from cogsplat.tools.terminal.values import number_of_bytes

_STATUS: Final = Path("/proc/self/status")

_TIME_CHART: Final = "scaling-time.svg"
_MEMORY_CHART: Final = "scaling-memory.svg"


@dataclass(frozen=True)
class Step:
    """Time and memory of one operation, run in a separate process.

    Parameters
    ----------
    what : str
        Name of the operation: ``synth``, ``encode`` or ``decode``.
    splats : int
        Splats of the scene.
    seconds : float
        Wall-clock time.
    cpu_seconds : float
        Processor time of all threads.
    peak_bytes : int
        Peak resident memory of the process.
    written_bytes : int
        Size of the output file.
    """

    what: str
    splats: int
    seconds: float
    cpu_seconds: float
    peak_bytes: int
    written_bytes: int


@dataclass(frozen=True)
class Line:
    """Linear model of a cost by number of splats.

    Parameters
    ----------
    fixed : float
        Cost at 0 splats, in the unit of the measurements.
    per_splat : float
        Cost per splat.
    largest_deviation : float
        Largest relative deviation of a measurement from the line.
    """

    fixed: float
    per_splat: float
    largest_deviation: float


def fit_line(splats: Sequence[int], values: Sequence[float]) -> Line:
    """Fit a line by least squares of the relative deviations.

    Parameters
    ----------
    splats : sequence of int
        Scene sizes, at least two of them different.
    values : sequence of float
        Measured costs, above 0.

    Examples
    --------
    >>> line = fit_line([1000, 3000], [5.0, 7.0])
    >>> round(line.fixed, 6), round(line.per_splat, 6)
    (4.0, 0.001)
    """
    if len(set(splats)) < 2:
        raise ValueError(f"scenes of {sorted(set(splats))} splats, expected at least two sizes")
    found = np.asarray(values, np.float64)
    terms = np.stack([np.ones(len(found)), np.asarray(splats, np.float64)], axis=1)
    line, *_ = np.linalg.lstsq(terms / found[:, None], np.ones(len(found)), rcond=None)
    deviation = float(np.abs(terms @ line / found - 1.0).max())
    return Line(float(line[0]), float(line[1]), deviation)


def measure(
    splats: int, folder: Path, *, views: int, preset: str, memory: int | None, threads: int
) -> list[Step]:
    """Generate a synthetic scene of SH degree 3, encode it, and decode it to a PLY.

    Parameters
    ----------
    splats : int
    folder : Path
        Folder for temporary files, which are deleted at the end.
    views : int
        Number of synthetic training views, 200x150 px.
    preset : str
        One of `codec.encode.presets.PRESETS`.
    memory : int or None
        Memory limit of the encode, bytes.
    threads : int
        0 for all cores.

    Returns
    -------
    list of Step
        Steps ``synth``, ``encode`` and ``decode``.
    """
    scene, cogs, decoded = (folder / f"scaling{end}" for end in (".ply", ".cogs", ".decoded.ply"))
    try:
        return [
            _measure_in_process("synth", splats, scene, _synthesise, splats, scene),
            _measure_in_process(
                "encode", splats, cogs, _encode, scene, cogs, views, preset, memory, threads
            ),
            _measure_in_process("decode", splats, decoded, _decode, cogs, decoded, threads),
        ]
    finally:
        for path in (scene, cogs, decoded):
            path.unlink(missing_ok=True)


def _measure_in_process(
    what: str, splats: int, out: Path, work: Callable[..., None], *arguments: object
) -> Step:
    """Run an operation in a new process, whose peak memory is then that of the operation."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        seconds, cpu, peak = pool.submit(_timed, work, *arguments).result()
    with storage_errors(out):
        return Step(what, splats, seconds, cpu, peak, out.stat().st_size)


def _timed(work: Callable[..., None], *arguments: object) -> tuple[float, float, int]:
    """Run an operation; return wall-clock and processor time, s, and peak memory, bytes."""
    start, cpu = time.perf_counter(), time.process_time()
    work(*arguments)
    return time.perf_counter() - start, time.process_time() - cpu, _peak_bytes()


def _peak_bytes() -> int:
    """Return the peak resident memory of this process, bytes."""
    if _STATUS.exists():
        for line in _STATUS.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _synthesise(splats: int, scene: Path) -> None:
    """Write a synthetic scene."""
    cogsplat.write(synth(splats), scene, force=True)


def _encode(
    scene: Path, out: Path, views: int, preset: str, memory: int | None, threads: int
) -> None:
    """Encode a scene file with synthetic training views; `memory` is the limit in bytes."""
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.request import EncodeRequest

    cogsplat.encode(
        scene,
        out,
        cameras=synth_cameras(views, 200, 150),
        preset=preset,
        request=EncodeRequest(config=EncodeConfig(threads=threads), memory_bytes=memory),
        force=True,
    )


def _decode(cogs: Path, out: Path, threads: int) -> None:
    """Decode a COGS file to a PLY file, part by part."""
    with open_cogs(FileSource(cogs)) as file:
        write_ply_parts(file.decode_parts(threads=threads), file.root.splats, out, force=True)


def charts(steps: Sequence[Step]) -> dict[str, str]:
    """Return SVG charts by file name: processor time and memory per splat, by scene size."""
    kinds = list(dict.fromkeys(step.what for step in steps))

    def draw(title: str, unit: str, value: Callable[[Step], float]) -> str:
        series = [
            Series(
                what,
                tuple((step.splats, value(step)) for step in steps if step.what == what),
                style=number,
            )
            for number, what in enumerate(kinds)
        ]
        return line_chart(title, "splats", unit, series, x_text=lambda x: f"{x:,.0f}")

    return {
        _TIME_CHART: draw(
            "Processor time per splat",
            "µs per splat",
            lambda step: 1e6 * step.cpu_seconds / step.splats,
        ),
        _MEMORY_CHART: draw(
            "Peak memory per splat",
            "kB per splat",
            lambda step: step.peak_bytes / step.splats / 1e3,
        ),
    }


def _counts(text: str) -> list[int]:
    """Parse the value of --splats: splat counts, separated by commas."""
    try:
        counts = sorted({int(part) for part in text.split(",")})
    except ValueError:
        counts = []
    if not counts or counts[0] < 1:
        raise click.BadParameter(f"{text!r}, expected numbers such as 100000,300000")
    return counts


@click.command(
    epilog="\b\nExample:\n"
    "  python -m cogsplat.tools.lab.benchmark.size_scaling --splats 100000,1000000 --out scaling"
)
@click.option(
    "--splats", "counts", type=_counts, default="100000,300000,1000000", show_default=True
)
@click.option("--views", type=click.IntRange(min=1), default=12, show_default=True, metavar="N")
@click.option(
    "--preset",
    type=click.Choice(["fast", "balanced", "best"]),
    default="fast",
    show_default=True,
)
@click.option("--memory", type=number_of_bytes, metavar="SIZE", help="Memory limit of each encode.")
@click.option("--out", type=WRITTEN_PATH, metavar="DIR", help="Folder for two charts.")
@threads_option
@force_option
@json_option
def main(
    counts: list[int],
    views: int,
    preset: str,
    memory: int | None,
    out: Path | None,
    threads: int,
    force: bool,
    as_json: bool,
) -> None:
    """Measure time and memory of synthetic scenes of SH degree 3 and several sizes."""
    if out is not None:
        with storage_errors(out):
            out.mkdir(parents=True, exist_ok=True)
        for name in (_TIME_CHART, _MEMORY_CHART):
            check_output(out / name, force=force)
    steps: list[Step] = []
    with tempfile.TemporaryDirectory(dir=out) as folder:
        for splats in counts:
            steps += measure(
                splats, Path(folder), views=views, preset=preset, memory=memory, threads=threads
            )
    if out is not None:
        for name, chart in charts(steps).items():
            with atomic_write(out / name, force=force) as file:
                file.write(chart.encode())
    lines: dict[str, dict[str, Line]] = {}
    if len(counts) > 1:
        for what in ("synth", "encode", "decode"):
            some = [step for step in steps if step.what == what]
            sizes = [step.splats for step in some]
            lines[what] = {
                "cpu_seconds": fit_line(sizes, [step.cpu_seconds for step in some]),
                "peak_bytes": fit_line(sizes, [step.peak_bytes for step in some]),
            }
    if as_json:
        models = {
            what: {key: asdict(line) for key, line in of.items()} for what, of in lines.items()
        }
        print_json({"steps": [asdict(step) for step in steps], "lines": models})
        return
    rows = [
        (
            step.what,
            f"{step.splats:,}",
            f"{step.seconds:.1f}",
            f"{step.cpu_seconds:.1f}",
            f"{step.peak_bytes / 1e9:.2f}",
            f"{step.written_bytes / 1e6:.1f}",
        )
        for step in sorted(steps, key=lambda step: step.what)
    ]
    print_table(("", "splats", "seconds", "processor s", "peak GB", "written MB"), rows)
    for what, of in lines.items():
        memory_line, time_line = of["peak_bytes"], of["cpu_seconds"]
        print_line(
            f"{what}: {memory_line.fixed / 1e9:.2f} GB and {memory_line.per_splat / 1e3:.2f} kB a "
            f"splat ({memory_line.largest_deviation:.0%} off at most), {time_line.fixed:.1f} s and "
            f"{1e6 * time_line.per_splat:.0f} µs a splat ({time_line.largest_deviation:.0%})"
        )


if __name__ == "__main__":
    main()
