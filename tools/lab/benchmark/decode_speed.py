"""Decoding speed: full decodes timed against copies of the decoded arrays.

Run ``python -m cogsplat.tools.lab.benchmark.decode_speed FILE.cogs ... [--synth 1000000]``. With
``--spz NODE_MODULES``, after ``npm install @adobe/spz`` in that folder's parent, the SPZ library
(C++ compiled to WebAssembly) loads the same splats for comparison.
"""

from __future__ import annotations

import json
import multiprocessing
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click
import numpy as np

import cogsplat
from cogsplat.codec.streams import decoding_tiers
from cogsplat.codec.threads import thread_count
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.terminal.options import json_option, threads_option
from cogsplat.tools.terminal.output import (
    display_name,
    print_json,
    print_line,
    print_table,
    size_text,
)
from cogsplat.tools.terminal.standard_streams import PATH

_ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")

_LIBRARY: Final = "@adobe/spz/dist/spz.js"

# Arguments: the library's module, an SPZ file, number of loads. Prints seconds per load as JSON.
_LOAD_SPZ: Final = """
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';
const [module, file, loads] = process.argv.slice(2);
const { default: create } = await import(pathToFileURL(module).href);
const spz = await create({ print: () => {} });
const bytes = new Uint8Array(readFileSync(file));
const names = ['positions', 'scales', 'rotations', 'alphas', 'colors', 'sh'];
const seconds = [];
for (let i = 0; i < Number(loads); i++) {
  const start = performance.now();
  const cloud = spz.loadSpzFromBuffer(bytes, { to: spz.CoordinateSystem.RDF });
  const arrays = names.map((name) => cloud[name]);
  seconds.push((performance.now() - start) / 1000);
  if (arrays.some((array) => array === undefined)) throw new Error('an array is missing');
}
console.log(JSON.stringify(seconds));
"""


@dataclass(frozen=True)
class Way:
    """Decoder configuration.

    Parameters
    ----------
    kernels : bool
        Whether to use compiled kernels instead of numpy.
    threads : int
        Number of threads; 0 for the default.
    """

    kernels: bool
    threads: int

    @property
    def label(self) -> str:
        """Kernels or numpy, and thread count, as text for tables."""
        threads = f"{self.threads} thread" + "s" * (self.threads != 1)
        by = "kernels" if self.kernels else "numpy"
        return f"{by}, {threads if self.threads else 'plain'}"


@dataclass(frozen=True)
class Timing:
    """Decode and copy times of one file, measured in interleaved pairs.

    Parameters
    ----------
    name : str
        Name of the file.
    splats, sh_degree, file_bytes, decoded_bytes : int
        Size of the scene, of the file and of the decoded arrays.
    decode_s : tuple of float
        Time of each full decode, from open to arrays, s.
    copy_s : tuple of float
        Time of each copy of all arrays to new memory, s.
    way : str
        Label of the decoder.
    """

    name: str
    splats: int
    sh_degree: int
    file_bytes: int
    decoded_bytes: int
    decode_s: tuple[float, ...]
    copy_s: tuple[float, ...]
    way: str = ""

    @property
    def least_ratio(self) -> float:
        """Ratio of the fastest decode to the fastest copy."""
        return min(self.decode_s) / min(self.copy_s)

    @property
    def median_ratio(self) -> float:
        """Median ratio of decode time to copy time over the interleaved pairs."""
        pairs = zip(self.decode_s, self.copy_s, strict=True)
        return statistics.median(decode / copy for decode, copy in pairs)

    def report(self) -> dict[str, object]:
        """Return the figures for JSON output."""
        return {
            "name": self.name,
            "way": self.way,
            "splats": self.splats,
            "sh_degree": self.sh_degree,
            "bytes": self.file_bytes,
            "decoded_bytes": self.decoded_bytes,
            "decode_s": list(self.decode_s),
            "copy_s": list(self.copy_s),
            "least_ratio": self.least_ratio,
            "median_ratio": self.median_ratio,
        }


def measure(
    path: Path, name: str, *, pairs: int, ways: Sequence[Way], spz: Path | None = None
) -> list[Timing]:
    """Time decodes of a file and copies of its arrays, interleaved.

    Parameters
    ----------
    path : Path
        COGS file. The first decode, which reads the file from disk, is not timed.
    name : str
        Name for the results.
    pairs : int
        Number of repetitions, at least 1.
    ways : sequence of Way
        Decoder configurations, all timed in each repetition. Copies use one thread (`numpy.copy`).
    spz : Path, optional
        Folder of node modules with the SPZ library, to time it on the same splats.

    Returns
    -------
    list of Timing
        One for each configuration, and one for the SPZ library if given.
    """
    for way in ways:
        # Warm-up: loads or compiles the kernels.
        decoding_tiers.use_compiled(way.kernels)
        splats = cogsplat.decode(path, threads=way.threads)
    decode_s: list[list[float]] = [[] for _ in ways]
    copy_s: list[float] = []
    for _ in range(pairs):
        for way, seconds in zip(ways, decode_s, strict=True):
            decoding_tiers.use_compiled(way.kernels)
            start = time.perf_counter()
            decoded = cogsplat.decode(path, threads=way.threads)
            seconds.append(time.perf_counter() - start)
            # Freed before the next allocation, so that all runs find the same free memory.
            del decoded
        start = time.perf_counter()
        copies = [np.copy(getattr(splats, field)) for field in _ARRAYS]
        copy_s.append(time.perf_counter() - start)
        del copies
    found = [
        (path.stat().st_size, way.label, seconds)
        for way, seconds in zip(ways, decode_s, strict=True)
    ]
    if spz is not None:
        with tempfile.TemporaryDirectory() as folder:
            other = Path(folder) / "same.spz"
            # An SPZ has no place for viewpoints, and reading takes no time for them.
            plain = splats.without_capture()
            cogsplat.write(plain, other, spz_precision="usual")
            seconds = load_spz(spz, other, pairs)
            found.append((other.stat().st_size, "SPZ library, WebAssembly", seconds))
    return [
        Timing(
            name=name,
            splats=len(splats),
            sh_degree=splats.sh_degree,
            file_bytes=size,
            decoded_bytes=splats.nbytes,
            decode_s=tuple(seconds),
            copy_s=tuple(copy_s),
            way=label,
        )
        for size, label, seconds in found
    ]


def load_spz(modules: Path, path: Path, loads: int) -> list[float]:
    """Return the duration of each load of an SPZ file from memory by the SPZ library, s.

    Raises
    ------
    click.ClickException
        Node or the library cannot be run.
    """
    library = (modules / _LIBRARY).resolve()
    command = ["node", "--input-type=module", "-", str(library), str(path), str(loads)]
    try:
        done = subprocess.run(command, input=_LOAD_SPZ, capture_output=True, text=True, check=False)
    except OSError as error:
        raise click.ClickException(f"node: {error}") from error
    if done.returncode:
        raise click.ClickException(f"{' '.join(command)}:\n{done.stdout}{done.stderr}")
    seconds: list[float] = json.loads(done.stdout.splitlines()[-1])
    return seconds


def encode_synth(path: Path, splats: int, sh_degree: int, views: int) -> None:
    """Encode a synthetic scene without pruning, scored in small training views.

    Parameters
    ----------
    path : Path
    splats : int
        Splats of the scene.
    sh_degree : int
        SH degree of the scene.
    views : int
        Number of training views.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.scoring.score_config import ScoreConfig

    cogsplat.encode(
        synth(splats, sh_degree=sh_degree),
        path,
        cameras=synth_cameras(views, 240, 180),
        config=EncodeConfig(prune=None),
        request=EncodeRequest(score_config=ScoreConfig(jitter=False)),
    )


def machine() -> dict[str, object]:
    """Return platform, processor, core count and versions of this machine."""
    return {
        "platform": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": thread_count(0),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba_in_use(),
    }


def numba_in_use() -> bool:
    """Tell whether numba is loaded in this process."""
    return sys.modules.get("numba") is not None


@click.command(
    epilog="\b\nExample:\n"
    "  python -m cogsplat.tools.lab.benchmark.decode_speed scene.cogs --synth 1000000"
)
@click.argument("files", nargs=-1, type=PATH, metavar="[FILE.cogs]...")
@click.option(
    "--synth",
    "synth_splats",
    type=click.IntRange(min=1),
    metavar="N",
    help="Also time synthetic scenes of N splats with SH 0 and SH 3 (needs the extra).",
)
@click.option("--views", type=click.IntRange(min=1), default=4, show_default=True, metavar="N")
@click.option("--pairs", type=click.IntRange(min=1), default=15, show_default=True, metavar="N")
@click.option("--core", is_flag=True, help="Only decode like an install without the extra.")
@click.option(
    "--spz",
    type=PATH,
    metavar="NODE_MODULES",
    help="Also time the SPZ library, from @adobe/spz in this folder.",
)
@threads_option
@json_option
def main(
    files: tuple[Path, ...],
    synth_splats: int | None,
    views: int,
    pairs: int,
    core: bool,
    spz: Path | None,
    threads: int,
    as_json: bool,
) -> None:
    """Time full decodes (open, checks, all arrays) against copies of the decoded arrays."""
    if not files and synth_splats is None:
        raise click.UsageError("nothing to time, expected COGS files or --synth N")
    if core:
        # Simulates that numba is not installed: later imports fail.
        sys.modules["numba"] = None  # type: ignore[assignment]
    ways = [Way(kernels=False, threads=threads)]
    if decoding_tiers.use_compiled(True):
        # The default, one thread and two threads.
        ways += [Way(kernels=True, threads=count) for count in sorted({threads, 1, 2})]
    subjects = [(path, display_name(path)) for path in files]
    with tempfile.TemporaryDirectory() as folder:
        for degree in (0, 3) if synth_splats else ():
            path = Path(folder) / f"sh{degree}.cogs"
            # In a separate process, because encoding always imports numba.
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                pool.submit(encode_synth, path, synth_splats or 0, degree, views).result()
            subjects.append((path, f"synth {synth_splats:,} SH {degree}"))
        timings = [
            timing
            for path, name in subjects
            for timing in measure(path, name, pairs=pairs, ways=ways, spz=spz)
        ]
    about = machine()
    if as_json:
        print_json({"machine": about, "pairs": pairs, "files": [t.report() for t in timings]})
        return
    using = "numba loaded" if about["numba"] else "without numba"
    print_line(f"{using}, {pairs} pairs, {about['cores']} cores, {about['platform']}")
    rows = [
        (
            timing.name,
            timing.way,
            f"{timing.splats:,}",
            str(timing.sh_degree),
            size_text(timing.file_bytes),
            size_text(timing.decoded_bytes),
            f"{1e3 * min(timing.decode_s):.1f}",
            f"{1e3 * min(timing.copy_s):.1f}",
            f"{timing.least_ratio:.1f}",
            f"{timing.median_ratio:.1f}",
        )
        for timing in timings
    ]
    print_table(
        (
            "file",
            "decoded by",
            "splats",
            "SH",
            "bytes",
            "decoded",
            "decode ms",
            "copy ms",
            "ratio",
            "median",
        ),
        rows,
    )


if __name__ == "__main__":
    main()
