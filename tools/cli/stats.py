"""``cogsplat stats``: statistics of a scene's values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.scene_statistics import SceneStatistics, ValueStatistics, statistics
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.options import (
    json_option,
    part_options,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import counted, facts, name_of, say, say_json, size_text, table
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT
from cogsplat.tools.terminal.values import ChunkRange

from .inputs import LoadedScene, Selection, read_any

# Lower block elements, U+2581 to U+2588; a space stands for an empty bin.
_BARS: Final = "▁▂▃▄▅▆▇█"


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat stats scene.spz\n"
    "  cogsplat stats scene.cogs --bytes 20% --json | jq .fill_ratio"
)
@click.argument("path", type=INPUT, metavar="SCENE")
@part_options
@partial_option
@limits_option
@threads_option
@quiet_option
@json_option
def stats(
    path: Path,
    chunks: ChunkRange | None,
    least_splats: int | None,
    size: ByteCount | None,
    objects: tuple[int, ...] | None,
    sh_degree: int | None,
    threads: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Show statistics of a scene, or of a part of it.

    Per attribute the range, mean, deviation, a histogram from the 0.5 % to the 99.5 % quantile, and
    how many values are not finite. Scales are natural logarithms, opacities logits; linear and
    unit ones follow. The fill ratio tells how many splats a ray through the scene crosses, about:
    their one-sigma areas over the mean face of the box that holds nearly all centres.
    """
    part = Selection(chunks, least_splats, size, sh_degree, objects)
    with Stages(shown=not (quiet or as_json)) as stages:
        scene = read_any(path, part, threads=threads, progress=stages)
        stages("read", 1, 1)
        found = statistics(scene.splats, stages)
    if as_json:
        say_json({**_report(path, scene, found), "seconds": stages.rounded()})
        return
    _tell(path, scene, found)
    if not quiet:
        say("")
        facts(("time", stages.line()))


def _report(path: Path, scene: LoadedScene, found: SceneStatistics) -> dict[str, object]:
    return {
        "source": name_of(path),
        "source_bytes": scene.file_bytes,
        "source_splats": scene.file_splats,
        "splats": found.splats,
        "sh_degree": found.sh_degree,
        "memory_bytes": found.nbytes,
        "invalid_splats": found.num_invalid,
        "opaque_share": found.opaque_share,
        # JSON has no infinity.
        "fill_ratio": found.fill_ratio if _is_finite(found.fill_ratio) else None,
        "values": {name: _values_report(values) for name, values in found.values.items()},
    }


def _values_report(values: ValueStatistics) -> dict[str, object]:
    return {
        "count": values.count,
        "nan": values.num_nan,
        "infinite": values.num_infinite,
        "min": values.least,
        "max": values.largest,
        "mean": values.mean,
        "std": values.std,
        "median": values.median,
        "edges": values.edges.tolist(),
        "histogram": values.histogram.tolist(),
    }


def _tell(path: Path, scene: LoadedScene, found: SceneStatistics) -> None:
    of = "" if found.splats == scene.file_splats else f" of {scene.file_splats:,}"
    say(f"{path}: {found.splats:,}{of} splats at SH degree {found.sh_degree}")
    opaque = "" if found.opaque_share is None else f"{found.opaque_share:.1%} above one half"
    facts(
        (
            "memory",
            f"{size_text(found.nbytes)} of arrays, {size_text(scene.file_bytes)} in the file",
        ),
        ("invalid", counted(found.num_invalid, "splat") if found.num_invalid else "none"),
        ("opacity", opaque),
        ("fill", "" if found.fill_ratio is None else f"{found.fill_ratio:.4g} layers"),
    )
    if not found.splats:
        return
    rows = [
        (
            name,
            *(_number(x) for x in (values.least, values.median, values.largest)),
            *(_number(x) for x in (values.mean, values.std)),
            f"{values.num_nan:,}" if values.num_nan else "-",
            f"{values.num_infinite:,}" if values.num_infinite else "-",
            bars(values.histogram),
        )
        for name, values in found.values.items()
    ]
    say("")
    heads = ("values", "least", "median", "largest", "mean", "std", "NaN", "inf", "histogram")
    table(heads, rows)


def bars(histogram: NDArray[np.int64]) -> str:
    """Return a histogram as one line of block characters, scaled to its highest bin.

    Parameters
    ----------
    histogram : (B,) int64
        Counts.
    """
    top = int(histogram.max(initial=0))
    # Rounded up, so that every bin that is not empty shows.
    heights = [-(-int(count) * len(_BARS) // top) if top else 0 for count in histogram]
    return "".join(_BARS[height - 1] if height else " " for height in heights)


def _number(value: float | None) -> str:
    # -0.0 + 0.0 is 0.0, which reads better.
    return "-" if value is None else f"{value + 0.0:.4g}"


def _is_finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
