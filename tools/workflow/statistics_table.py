"""Statistics of a scene's values, as a JSON object and as a table."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.tools.evaluation.scene_statistics import SceneStatistics, ValueStatistics
from cogsplat.tools.terminal.output import (
    count_text,
    print_facts,
    print_line,
    print_table,
    size_text,
)

# Lower block elements, U+2581 to U+2588; a space stands for an empty bin.
_BARS: Final = "▁▂▃▄▅▆▇█"


def statistics_report(found: SceneStatistics) -> dict[str, object]:
    """Return statistics of a scene as a JSON object."""
    return {
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
    """Return the statistics of one column as a JSON object."""
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


def print_statistics(found: SceneStatistics, source_splats: int) -> None:
    """Print statistics of a scene.

    Parameters
    ----------
    found : SceneStatistics
    source_splats : int
        Splats in the whole file; fewer may have been read.
    """
    of = "" if found.splats == source_splats else f" of {source_splats:,}"
    opaque = "" if found.opaque_share is None else f"{found.opaque_share:.1%} above one half"
    print_line("")
    print_facts(
        ("read", f"{found.splats:,}{of} splats at SH degree {found.sh_degree}"),
        ("memory", f"{size_text(found.nbytes)} of arrays"),
        ("invalid", count_text(found.num_invalid, "splat") if found.num_invalid else "none"),
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
    print_line("")
    heads = ("values", "least", "median", "largest", "mean", "std", "NaN", "inf", "histogram")
    print_table(heads, rows)


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
    """Return a number with four significant digits, a dash for None."""
    # -0.0 + 0.0 is 0.0, which reads better.
    return "-" if value is None else f"{value + 0.0:.4g}"


def _is_finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
