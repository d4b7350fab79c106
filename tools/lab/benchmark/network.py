"""Network benchmarks: random access to a large file, a slow link, and concurrent readers.

Run ``python -m cogsplat.tools.lab.benchmark.network large``, ``link SCENE.cogs`` or
``readers SCENE.cogs``. Each server runs in a separate process on this machine.
"""

from __future__ import annotations

import asyncio
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import click
import numpy as np

import cogsplat
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.formats.cogs.index_tables import PageTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.cogs.root import Root
from cogsplat.formats.cogs.writer import Segment, write_cogs
from cogsplat.formats.network.download import download
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.terminal.options import json_option
from cogsplat.tools.terminal.output import print_facts, print_json
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber

_STATUS: Final = "/proc/{}/status"
_RANGE_BYTES: Final = 65536

# Approximate size of a chunk of the large file: 100,000 chunks are a gigabyte.
_CHUNK_BYTES: Final = 10_000

_CODEBOOKS: Final = (
    SegmentKind.SHAPE_CODEBOOK,
    SegmentKind.COLOUR_BAND1,
    SegmentKind.COLOUR_BAND2,
    SegmentKind.COLOUR_BAND3,
)


@dataclass(frozen=True)
class LargeFile:
    """Cost of opening a large file and of reading single chunks.

    Parameters
    ----------
    file_bytes, chunks, pages : int
        Size of the file, number of its chunks and of its pages.
    opening_requests, opening_bytes : int
        Requests and bytes for opening the file.
    chunk_requests, chunk_bytes : int
        Maximum number of requests and bytes for one chunk, after opening the file anew.
    memory_bytes : int
        Peak resident memory of the process minus its memory before opening the file.
    """

    file_bytes: int
    chunks: int
    pages: int
    opening_requests: int
    opening_bytes: int
    chunk_requests: int
    chunk_bytes: int
    memory_bytes: int


@dataclass(frozen=True)
class SlowLink:
    """Traffic and times of loading a scene over a slow link.

    Parameters
    ----------
    file_bytes, received_bytes, requests : int
        Size of the file, bytes received and requests when streaming.
    link_seconds : float
        Transfer time of the file's bytes at the link's bandwidth, without latency.
    fetched_seconds : float
        Time of a download without decoding.
    opened_seconds, first_chunk_seconds, last_chunk_seconds : float
        Time until the index, the first and the last chunk are available when streaming.
    decoded_seconds : float
        Time of `cogsplat.decode` of the file's URL.
    """

    file_bytes: int
    received_bytes: int
    requests: int
    link_seconds: float
    fetched_seconds: float
    opened_seconds: float
    first_chunk_seconds: float
    last_chunk_seconds: float
    decoded_seconds: float


@dataclass(frozen=True)
class Readers:
    """Result of a load test: responses and server memory under concurrent clients.

    Parameters
    ----------
    readers : int
        Number of concurrent clients.
    seconds : float
        Duration of the test.
    answers, wrong, errors : int
        Number of correct responses, of responses with wrong bytes, and of failed requests.
    memory_first_bytes, memory_last_bytes, memory_peak_bytes : int
        Resident memory of the server after a tenth of the time, at the end, and its peak.
    """

    readers: int
    seconds: float
    answers: int
    wrong: int
    errors: int
    memory_first_bytes: int
    memory_last_bytes: int
    memory_peak_bytes: int


@contextmanager
def served(path: Path, *options: str) -> Iterator[tuple[str, int]]:
    """Serve a file from a new process for the duration of the block; yield URL and process id."""
    command = [sys.executable, "-m", "cogsplat.tools.main", "serve", str(path), "--json"]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            told = ""
            while not told.endswith("}\n"):
                line = process.stdout.readline()
                if not line:
                    raise RuntimeError(f"cogsplat serve ended after printing {told!r}")
                told += line
            yield json.loads(told)["scene_url"], process.pid
        finally:
            process.terminate()


def make_large(path: Path, chunks: int) -> None:
    """Write a file of `chunks` copies of one chunk of a synthetic scene, SH degree 3."""
    with tempfile.TemporaryDirectory() as folder:
        small = Path(folder) / "small.cogs"
        cogsplat.encode(synth(6000), small, cameras=synth_cameras(6, 120, 90), preset="fast")
        with cogsplat.open(small) as file:
            root, segments = _copies(file, chunks)
    write_cogs(root, segments, path, force=True)


def _copies(file: CogsFile, chunks: int) -> tuple[Root, list[Segment]]:
    """Return root and segments of a file that repeats one chunk of another file."""
    whole = [c for c in range(file.num_chunks) if None not in _parts(file, c)]
    size = {c: sum(int(file.segments.length[row or 0]) for row in _parts(file, c)) for c in whole}
    chosen = min(whole, key=lambda chunk: abs(size[chunk] - _CHUNK_BYTES))
    books = np.flatnonzero(np.isin(file.segments.kind, [int(k) for k in _CODEBOOKS]))
    parts = [row for row in _parts(file, chosen) if row is not None]
    segments = [_segment(file, int(row), int(file.segments.owner[row])) for row in books]
    one = [_segment(file, row, 0) for row in parts]
    segments += [replace(part, owner=chunk) for chunk in range(chunks) for part in one]
    table = file.chunks.take(np.full(chunks, chosen))
    splats = int(table.splats.sum())
    return replace(
        file.root, splats=splats, chunks=table, pages=PageTable.zeros(0), attributes=()
    ), segments


def _parts(file: CogsFile, chunk: int) -> tuple[int | None, ...]:
    """Return the segment-table rows of a chunk's head, refinement and tail; None if absent."""
    rows = file.chunk_rows(chunk)
    return rows.head, rows.refinement, rows.tail


def _segment(file: CogsFile, row: int, owner: int) -> Segment:
    """Return the segment at a row of a file's segment table, with another owner."""
    needs = int(file.segments.needs[row])
    return Segment(
        int(file.segments.kind[row]),
        owner,
        bytes(file.read_segment(row)),
        tuple(book for book in range(len(file.root.codebooks)) if needs >> book & 1),
    )


def make_folder(path: Path, folder: Path) -> None:
    """Unpack a file into a folder of objects (SPEC 3.4)."""
    with cogsplat.open(path) as file:
        unpack_cogs(file, folder)


def large_file(path: Path, tries: int, seed: int = 1, place: Path | None = None) -> LargeFile:
    """Read random chunks of a large file from a local server and count the traffic.

    Parameters
    ----------
    path : Path
        The file.
    tries : int
        Number of random chunks, besides the first and the last.
    seed : int
        Seed of the random choice.
    place : Path, optional
        Folder that holds the file as objects (SPEC 3.4), to serve instead of the file.
    """
    chosen = random.Random(seed)
    with served(place or path) as (url, _):
        # Warm-up: imports and the first decode are not measured.
        with cogsplat.open(path, size_bytes=1 << 20) as file:
            file.decode([0])
        before = _resident_bytes()
        with cogsplat.open(url) as file:
            assert file.traffic is not None
            opening, count = file.traffic, file.num_chunks
            pages = len(file.page_bytes)
        requests = received = 0
        for chunk in [0, count - 1, *(chosen.randrange(count) for _ in range(tries))]:
            with cogsplat.open(url) as file:
                splats = file.decode([chunk])
                assert file.traffic is not None
                assert len(splats)
                requests = max(requests, file.traffic.requests - opening.requests)
                received = max(received, file.traffic.received_bytes - opening.received_bytes)
        memory = _resident_bytes(peak=True) - before
    size = path.stat().st_size
    return LargeFile(
        size, count, pages, opening.requests, opening.received_bytes, requests, received, memory
    )


def load_over_link(path: Path, bits_per_second: float, latency_ms: float) -> SlowLink:
    """Measure downloading, streaming and decoding a scene over a slow link."""
    options = ["--throttle", f"{bits_per_second:.0f}", "--latency", str(latency_ms)]
    with cogsplat.open(path) as file:
        file.decode([0])
    with served(path, *options) as (url, _):
        # Warm-up: imports are not measured.
        cogsplat.open(url).close()
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            download(url, Path(folder) / "fetched")
        fetched = time.perf_counter() - start
        start = time.perf_counter()
        with cogsplat.open(url) as file, file.stream() as updates:
            opened = time.perf_counter() - start
            next(updates)
            first = time.perf_counter() - start
            for _update in updates:
                pass
            last = time.perf_counter() - start
            assert file.traffic is not None
            traffic = file.traffic
        start = time.perf_counter()
        cogsplat.decode(url)
        decoded = time.perf_counter() - start
    size = path.stat().st_size
    return SlowLink(
        size,
        traffic.received_bytes,
        traffic.requests,
        8 * size / bits_per_second,
        fetched,
        opened,
        first,
        last,
        decoded,
    )


def many_readers(path: Path, readers: int, seconds: float) -> Readers:
    """Request random byte ranges of a file by concurrent clients, each with one connection."""
    with served(path) as (url, process):
        return asyncio.run(_read(path.read_bytes(), url, process, readers, seconds))


async def _read(data: bytes, url: str, process: int, readers: int, seconds: float) -> Readers:
    import httpx

    answers = wrong = errors = 0
    stop = time.monotonic() + seconds
    resident = [_resident_bytes(process)]

    async def reader(number: int) -> None:
        nonlocal answers, wrong, errors
        chosen = random.Random(number)
        # Loading certificates for each client would take longer than the test.
        async with httpx.AsyncClient(timeout=30, verify=False) as client:
            while time.monotonic() < stop:
                first = chosen.randrange(len(data))
                end = min(len(data), first + 1 + chosen.randrange(_RANGE_BYTES))
                try:
                    answer = await client.get(url, headers={"Range": f"bytes={first}-{end - 1}"})
                except httpx.HTTPError:
                    errors += 1
                    continue
                right = answer.status_code == 206 and answer.content == data[first:end]
                answers += right
                wrong += not right

    async def watcher() -> None:
        while time.monotonic() < stop:
            await asyncio.sleep(seconds / 20)
            resident.append(_resident_bytes(process))

    await asyncio.gather(*(reader(number) for number in range(readers)), watcher())
    return Readers(
        readers,
        seconds,
        answers,
        wrong,
        errors,
        resident[len(resident) // 10],
        resident[-1],
        max(resident),
    )


def _resident_bytes(process: int | str = "self", *, peak: bool = False) -> int:
    """Return the resident memory of a process, bytes; with `peak`, its maximum.

    The maximum of `getrusage` would include the memory of the parent process.
    """
    field = "VmHWM" if peak else "VmRSS"
    for line in Path(_STATUS.format(process)).read_text(encoding="ascii").splitlines():
        if line.startswith(field):
            return int(line.split()[1]) * 1024
    raise RuntimeError(f"process {process} states no resident memory")


def _print(found: object, as_json: bool) -> None:
    """Print a result as a table or as JSON."""
    values = asdict(found)  # type: ignore[call-overload]
    if as_json:
        print_json(values)
        return
    print_facts(
        *(
            (name, f"{value:,.3f}" if isinstance(value, float) else f"{value:,}")
            for name, value in values.items()
        )
    )


@click.group()
def main() -> None:
    """Measure random access, slow links and concurrent clients over a network."""


@main.command()
@click.option("--chunks", type=click.IntRange(min=1), default=100_000, show_default=True)
@click.option("--tries", type=click.IntRange(min=0), default=20, show_default=True)
@click.option(
    "--folder", "as_folder", is_flag=True, help="Serve a folder of objects instead of the file."
)
@json_option
def large(chunks: int, tries: int, as_folder: bool, as_json: bool) -> None:
    """Count requests, bytes and memory of reading single chunks of a large file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.cogs"
        # In a separate process, so that its memory is not measured.
        command = "import sys; from pathlib import Path; "
        command += "from cogsplat.tools.lab.benchmark.network import make_folder, make_large; "
        command += "make_large(Path(sys.argv[1]), int(sys.argv[2])); "
        command += "[make_folder(Path(sys.argv[1]), Path(x)) for x in sys.argv[3:]]"
        place = [Path(folder) / "large"] if as_folder else []
        arguments = [str(x) for x in (path, chunks, *place)]
        subprocess.run([sys.executable, "-c", command, *arguments], check=True)
        _print(large_file(path, tries, place=place[0] if place else None), as_json)


@main.command()
@click.argument("scene", type=PATH)
@click.option(
    "--bits", type=FiniteNumber(), default=10e6, show_default=True, help="Bandwidth, bit/s."
)
@click.option(
    "--latency", type=FiniteNumber(), default=50.0, show_default=True, help="Latency, ms."
)
@json_option
def link(scene: Path, bits: float, latency: float, as_json: bool) -> None:
    """Measure times and traffic of loading SCENE over a slow link."""
    _print(load_over_link(scene, bits, latency), as_json)


@main.command()
@click.argument("scene", type=PATH)
@click.option("--readers", type=click.IntRange(min=1), default=200, show_default=True)
@click.option("--seconds", type=FiniteNumber(min=1), default=60.0, show_default=True)
@json_option
def readers(scene: Path, readers: int, seconds: float, as_json: bool) -> None:
    """Test a server under load: many clients request random byte ranges of SCENE."""
    _print(many_readers(scene, readers, seconds), as_json)


if __name__ == "__main__":
    main()
