"""PRoGS' protocol: quality of prefixes of a scene, by shares of its splats and by bytes."""

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
"""Of the splats (PRoGS, section 4)."""

FIRST_BYTES: Final = 32 << 10
"""The shortest prefix of a file that is measured, in bytes; each next one is twice as long."""

SPLATS: Final = "splats"
BYTES: Final = "bytes"


@dataclass(frozen=True)
class PrefixPoint:
    """Quality of one prefix of a scene.

    Parameters
    ----------
    name : str
        The order, or the file.
    by : str
        `SPLATS` or `BYTES`: what is counted.
    share : float
        Of the splats or of the file's bytes.
    size_bytes : int or None
        Of the prefix of the file.
    splats : int
    figures : Figures
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
        """Return the fields as JSON output has them."""
        return {
            "name": self.name,
            "by": self.by,
            "share": round(self.share, 6),
            "bytes": self.size_bytes,
            "splats": self.splats,
            **self.figures.report(),
        }


def counts(splats: int, shares: Sequence[float]) -> list[int]:
    """Return the number of splats of each share, at least 1."""
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
    """Measure prefixes of an order at shares of the splats, without quantisation.

    Parameters
    ----------
    evaluator : Evaluator
    name : str
    splats : Splats
    rows : (N,) int64
        The order.
    shares : sequence of float
        Above 0 to 1.
    progress : Progress
        Called with the stage ``measure``.
    """
    # What is drawn last is stored first: each version is a view of one array, not a copy.
    ordered = splats.without_extras().take(rows)
    sizes = counts(len(rows), shares)
    found = evaluator.measure([ordered.take(slice(0, size)) for size in sizes], progress=progress)
    return [
        PrefixPoint(name, SPLATS, share, None, size, figures)
        for share, size, figures in zip(shares, sizes, found, strict=True)
    ]


def sizes_of(file_bytes: int) -> list[int]:
    """Return 32 KiB, doubled while it is below a file's size, and that size."""
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
    path : Path
    sizes : sequence of int, optional
        Bytes; `sizes_of` the file where none are given. What is longer than the file is left out,
        and the whole file measured.
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
    """Measure prefixes of an order by their bytes in another format (PRoGS, figure 9).

    Parameters
    ----------
    evaluator : Evaluator
    name : str
        The order; the codec is added to it.
    splats : Splats
    rows : (N,) int64
        The order.
    codec : str
        One of `formats.scenes.registry.WRITABLE`: each prefix becomes a file of this format, is
        read back and measured.
    shares : sequence of float
        Of the splats, above 0 to 1.
    path : Path
        Where the files are made, one in place of the other.
    progress : Progress
        Called with the stage ``measure``.

    Returns
    -------
    list of PrefixPoint
        Shares are those of the bytes of the longest prefix.
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
    """Return the mean of a curve over a logarithmic axis: its area divided by its width.

    Parameters
    ----------
    points : sequence of (x, y)
        By rising x, above 0; lines between them, level behind the last.
    until : float
        Where the axis ends; the same for all curves that are compared.

    Returns
    -------
    float
        In the unit of y; that of the only point where there is one.
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
"""What areas and plots are made of."""


def areas(points: Sequence[PrefixPoint]) -> dict[str, dict[str, float]]:
    """Return the mean of each figure over the logarithm of splats or bytes, by order, dB.

    Parameters
    ----------
    points : sequence of PrefixPoint
        Counted the same way; by name in rising order. All of the splats do not count where there is
        something before: they are the reference itself, whose 100 dB stand for no distance.
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
