"""Evaluation protocol of PRoGS: quality of prefixes, by share of the splats and by bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.registry import FORMATS, write_scene
from cogsplat.tools.evaluation.prefix_quality import decode_prefix
from cogsplat.tools.terminal.standard_streams import set_display_name

from .evaluator import Evaluator, Figures

SHARES: Final = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Measured shares of the splats (PRoGS, section 4)."""

FIRST_BYTES: Final = 32 << 10
"""Shortest measured prefix of a file; each further one is twice as long."""

SPLATS: Final = "splats"
BYTES: Final = "bytes"


@dataclass(frozen=True)
class PrefixPoint:
    """Quality of one prefix of a scene.

    Parameters
    ----------
    name : str
        Name of the order or of the file.
    by : str
        Unit of the prefix length: `SPLATS` or `BYTES`.
    share : float
        Length as a share of the splats or of the bytes.
    size_bytes : int or None
        Length of a prefix of a file.
    splats : int
        Splats in the prefix.
    figures : Figures
        Quality against the full scene.
    """

    name: str
    by: str
    share: float
    size_bytes: int | None
    splats: int
    figures: Figures

    @property
    def x(self) -> float:
        """Position on the horizontal axis: percent of the splats, or bytes."""
        return 100 * self.share if self.size_bytes is None else float(self.size_bytes)

    def report(self) -> dict[str, object]:
        """Return the fields for JSON output."""
        return {
            "name": self.name,
            "by": self.by,
            "share": round(self.share, 6),
            "bytes": self.size_bytes,
            "splats": self.splats,
            **self.figures.report(),
        }


def counts(splats: int, shares: Sequence[float]) -> list[int]:
    """Convert shares to numbers of splats, at least 1."""
    return [max(1, round(share * splats)) for share in shares]


def by_splats(
    evaluator: Evaluator,
    name: str,
    splats: Splats,
    rows: NDArray[np.int64],
    shares: Sequence[float] = SHARES,
    *,
    progress: Progress = silent,
) -> list[PrefixPoint]:
    """Measure prefixes of an order by share of the splats, without quantisation.

    Parameters
    ----------
    evaluator : Evaluator
    name : str
        Name of the order.
    splats : Splats
    rows : (N,) int64
        Order of the splats.
    shares : sequence of float
        Lengths of the prefixes as shares of the splats, above 0 to 1.
    progress : Progress
        Called with the stage ``measure``.
    """
    # Prefixes of one reordered array are views, so no copies are made.
    ordered = splats.without_extras().take(rows)
    sizes = counts(len(rows), shares)
    found = evaluator.measure([ordered.take(slice(0, size)) for size in sizes], progress=progress)
    return [
        PrefixPoint(name, SPLATS, share, None, size, figures)
        for share, size, figures in zip(shares, sizes, found, strict=True)
    ]


def sizes_of(file_bytes: int) -> list[int]:
    """Return 32 KiB, its doublings below the file size, and the file size."""
    doublings = max(math.ceil(math.log2(max(file_bytes, 1) / FIRST_BYTES)), 0)
    return [*(FIRST_BYTES << k for k in range(doublings)), file_bytes]


def by_bytes(
    evaluator: Evaluator,
    name: str,
    path: Path,
    sizes: Sequence[int] | None = None,
    *,
    compensate: bool = False,
    threads: int = 0,
    progress: Progress = silent,
) -> list[PrefixPoint]:
    """Measure prefixes of a file, each decoded from its bytes alone.

    Parameters
    ----------
    evaluator : Evaluator
    name : str
        Name of the file.
    path : Path
    sizes : sequence of int, optional
        Lengths in bytes, clipped to the file size; by default `sizes_of` the file.
    compensate : bool
        Whether prefixes are decoded with compensation (SPEC 8.5).
    threads : int
    progress : Progress
        Called with the stage ``measure``.
    """
    whole = path.stat().st_size
    wanted = sizes_of(whole) if sizes is None else sorted({min(size, whole) for size in sizes})
    versions = [
        decode_prefix(path, size, compensate=compensate, threads=threads).without_extras()
        for size in wanted
    ]
    found = evaluator.measure(versions, progress=progress)
    return [
        PrefixPoint(name, BYTES, size / whole, size, len(version), figures)
        for size, version, figures in zip(wanted, versions, found, strict=True)
    ]


def by_codec(
    evaluator: Evaluator,
    name: str,
    splats: Splats,
    rows: NDArray[np.int64],
    codec: str,
    shares: Sequence[float] = SHARES,
    *,
    path: Path,
    progress: Progress = silent,
) -> list[PrefixPoint]:
    """Measure prefixes of an order by their size in another format (PRoGS, figure 9).

    Parameters
    ----------
    evaluator : Evaluator
    name : str
        Name of the order; the codec is appended.
    splats : Splats
    rows : (N,) int64
        Order of the splats.
    codec : str
        Format in `formats.scenes.registry.WRITABLE`; each prefix is written in this format, read
        and measured.
    shares : sequence of float
        Lengths of the prefixes as shares of the splats, above 0 to 1.
    path : Path
        Temporary file, overwritten by each prefix.
    progress : Progress
        Called with the stage ``measure``.

    Returns
    -------
    list of PrefixPoint
        Points whose shares refer to the bytes of the longest prefix.
    """
    ordered = splats.without_extras().take(rows)
    sizes: list[int] = []
    versions: list[Splats] = []
    read = next(format_ for format_ in FORMATS if format_.name == codec).read
    set_display_name(path, f"{name}, {codec}")
    for count in counts(len(rows), shares):
        write_scene(ordered.take(slice(0, count)), path, force=True, format_name=codec)
        sizes.append(path.stat().st_size)
        versions.append(read(path))
    found = evaluator.measure(versions, progress=progress)
    return [
        PrefixPoint(f"{name}, {codec}", BYTES, size / max(sizes), size, len(version), figures)
        for size, version, figures in zip(sizes, versions, found, strict=True)
    ]


def mean_over_log(points: Sequence[tuple[float, float]], until: float) -> float:
    """Return the mean of a curve over a logarithmic axis (area divided by width).

    Parameters
    ----------
    points : sequence of (x, y)
        Points by rising x, above 0. The curve is piecewise linear, and constant after the last.
    until : float
        End of the axis, the same for all compared curves.

    Returns
    -------
    float
        Mean in the unit of y; for a single point its y.
    """
    xs = np.log2([x for x, _ in points])
    ys = np.array([y for _, y in points])
    if until > points[-1][0]:
        xs, ys = np.append(xs, math.log2(until)), np.append(ys, ys[-1])
    width = float(xs[-1] - xs[0])
    if width <= 0.0:
        return float(ys[-1])
    return float(np.trapezoid(ys, xs)) / width


FIGURES: Final = ("held_out_db", "worst_db", "roam_db")
"""Figures that are plotted and averaged."""


def areas(points: Sequence[PrefixPoint]) -> dict[str, dict[str, float]]:
    """Return the mean of each figure over the logarithm of splats or bytes, by order, dB.

    Parameters
    ----------
    points : sequence of PrefixPoint
        Points with the same unit, by rising length for each name. Points with all splats are left
        out if there are others: they equal the reference, with a nominal PSNR of 100 dB.
    """
    points = [p for p in points if p.by == BYTES or p.share < 1] or points
    until = max(point.x for point in points)
    found: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(point.name for point in points):
        own = [point for point in points if point.name == name]
        found[name] = {
            figure: mean_over_log([(p.x, getattr(p.figures, figure)) for p in own], until)
            for figure in FIGURES
        }
    return found
