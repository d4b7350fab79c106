"""Decoding speed: full decodes timed against copies of the decoded arrays.

Run ``python -m cogsplat.tools.benchmark.decode_speed FILE.cogs ... [--synth 1000000]``.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import platform
import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

import cogsplat
from cogsplat.codec.threads import thread_count
from cogsplat.tools.synthetic.scene import synth, synth_cameras
from cogsplat.tools.terminal.options import json_option, threads_option
from cogsplat.tools.terminal.output import name_of, say, say_json, size_text, table
from cogsplat.tools.terminal.standard_streams import PATH

_ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


@dataclass(frozen=True)
class Timing:
    """Seconds of decodes and copies of one file, measured in interleaved pairs.

    Parameters
    ----------
    name : str
    splats, sh_degree, file_bytes, decoded_bytes : int
    decode_s, copy_s : tuple of float
        Seconds of each pair: open, checks and all arrays allocated; a fresh copy of each array.
    """

    name: str
    splats: int
    sh_degree: int
    file_bytes: int
    decoded_bytes: int
    decode_s: tuple[float, ...]
    copy_s: tuple[float, ...]

    @property
    def least_ratio(self) -> float:
        """Ratio of the fastest decode to the fastest copy."""
        return min(self.decode_s) / min(self.copy_s)

    @property
    def median_ratio(self) -> float:
        """Median over the pairs of the ratio of decode to copy."""
        pairs = zip(self.decode_s, self.copy_s, strict=True)
        return statistics.median(decode / copy for decode, copy in pairs)

    def report(self) -> dict[str, object]:
        """Return the figures as JSON output has them."""
        return {
            "name": self.name,
            "splats": self.splats,
            "sh_degree": self.sh_degree,
            "bytes": self.file_bytes,
            "decoded_bytes": self.decoded_bytes,
            "decode_s": list(self.decode_s),
            "copy_s": list(self.copy_s),
            "least_ratio": self.least_ratio,
            "median_ratio": self.median_ratio,
        }


def measure(path: Path, name: str, *, pairs: int, threads: int = 0) -> Timing:
    """Time decodes of a file against copies of its arrays, one after the other in turn.

    Parameters
    ----------
    path : Path
        A COGS file; it is read once before, so that the disk is not measured.
    name : str
        What to call it.
    pairs : int
        At least 1.
    threads : int
        Of the decoder; 0 for all cores. Copies run on one thread, as `numpy.copy` does.
    """
    splats = cogsplat.decode(path, threads=threads)
    decode_s, copy_s = [], []
    for _ in range(pairs):
        start = time.perf_counter()
        decoded = cogsplat.decode(path, threads=threads)
        decode_s.append(time.perf_counter() - start)
        # Freed before the copies are made: both find the same memory to allocate from.
        del decoded
        start = time.perf_counter()
        copies = [np.copy(getattr(splats, field)) for field in _ARRAYS]
        copy_s.append(time.perf_counter() - start)
        del copies
    return Timing(
        name=name,
        splats=len(splats),
        sh_degree=splats.sh_degree,
        file_bytes=path.stat().st_size,
        decoded_bytes=splats.nbytes,
        decode_s=tuple(decode_s),
        copy_s=tuple(copy_s),
    )


def encode_synth(path: Path, splats: int, sh_degree: int, views: int) -> None:
    """Encode a synthetic scene as `cogsplat encode` would, scored on few, small views.

    Parameters
    ----------
    path : Path
    splats, sh_degree : int
        Of the scene.
    views : int
        Of the scene's own cameras; nothing is pruned, so that the decoder has all splats to do.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.scoring.contribution import ScoreConfig

    cogsplat.encode(
        synth(splats, sh_degree=sh_degree),
        path,
        cameras=synth_cameras(views, 240, 180),
        config=EncodeConfig(prune=None),
        score_config=ScoreConfig(jitter=False),
    )


def machine() -> dict[str, object]:
    """Return the machine's description: processor, cores, versions."""
    return {
        "platform": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cores": thread_count(0),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba_in_use(),
    }


def numba_in_use() -> bool:
    """Tell whether decoding in this process went through compiled kernels."""
    return sys.modules.get("numba") is not None


@click.command(
    epilog="\b\nExample:\n"
    "  python -m cogsplat.tools.benchmark.decode_speed scene.cogs --synth 1000000"
)
@click.argument("files", nargs=-1, type=PATH, metavar="[FILE.cogs]...")
@click.option(
    "--synth",
    "synth_splats",
    type=click.IntRange(min=1),
    metavar="N",
    help="Also synthetic scenes of N splats at SH 0 and SH 3, encoded here (takes the extra).",
)
@click.option("--views", type=click.IntRange(min=1), default=4, show_default=True, metavar="N")
@click.option("--pairs", type=click.IntRange(min=1), default=15, show_default=True, metavar="N")
@click.option("--core", is_flag=True, help="Decode as an install without the extra does.")
@threads_option
@json_option
def main(
    files: tuple[Path, ...],
    synth_splats: int | None,
    views: int,
    pairs: int,
    core: bool,
    threads: int,
    as_json: bool,
) -> None:
    """Time full decodes (open, checks, all arrays) against copies of the decoded arrays."""
    if not files and synth_splats is None:
        raise click.UsageError("nothing to time, expected COGS files or --synth N")
    if core:
        # As if it were not installed: importing it fails from here on.
        sys.modules["numba"] = None  # type: ignore[assignment]
    elif importlib.util.find_spec("numba"):
        # Whatever the decoder makes of it, loading it is over before the clock starts.
        importlib.import_module("numba")
    subjects = [(path, name_of(path)) for path in files]
    with tempfile.TemporaryDirectory() as folder:
        for degree in (0, 3) if synth_splats else ():
            path = Path(folder) / f"sh{degree}.cogs"
            # In a process of its own, because encoding imports numba in any case.
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                pool.submit(encode_synth, path, synth_splats or 0, degree, views).result()
            subjects.append((path, f"synth {synth_splats:,} SH {degree}"))
        timings = [measure(path, name, pairs=pairs, threads=threads) for path, name in subjects]
    about = machine()
    if as_json:
        say_json({"machine": about, "pairs": pairs, "files": [t.report() for t in timings]})
        return
    using = "numba loaded" if about["numba"] else "without numba"
    say(f"{using}, {pairs} pairs, {thread_count(threads)} threads, {about['platform']}")
    rows = [
        (
            timing.name,
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
    table(
        ("file", "splats", "SH", "bytes", "decoded", "decode ms", "copy ms", "ratio", "median"),
        rows,
    )


if __name__ == "__main__":
    main()
