"""Quality of single objects by received splats, with and without object-first loading.

This is figure 8 of PRoGS; section 3.4 describes loading by object. Quality is measured over the
pixels to which the object contributes most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.order.objects import labels_of
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.tools.evaluation.object_quality import Colour, object_qualities_of
from cogsplat.tools.pictures.svg_charts import Series, line_chart

from .progs_protocol import counts

# Points above are not plotted: identical pixels have a nominal PSNR of 100 dB.
_MAX_DB = 90.0


@dataclass(frozen=True)
class ObjectPoint:
    """Quality of one object in a prefix of a scene.

    Parameters
    ----------
    name : str
        Order, and whether the object's splats come first.
    object : int
        Label of the object.
    share : float
        Share of the scene's splats in the prefix.
    splats : int
        Splats in the prefix.
    psnr_db, worst_db : float or None
        Mean and minimum PSNR over the object's pixels in the views that show it; None if no view
        does.
    """

    name: str
    object: int
    share: float
    splats: int
    psnr_db: float | None
    worst_db: float | None

    def report(self) -> dict[str, str | int | float | None]:
        """Return the fields for JSON output."""
        return {
            "name": self.name,
            "object": self.object,
            "share": round(self.share, 6),
            "splats": self.splats,
            "psnr_db": None if self.psnr_db is None else round(self.psnr_db, 5),
            "worst_db": None if self.worst_db is None else round(self.worst_db, 5),
        }


def object_first(
    rows: NDArray[np.int64], labels: NDArray[np.uint32], label: int
) -> NDArray[np.int64]:
    """Move the splats of one object to the front of an order (stable).

    Parameters
    ----------
    rows : (N,) int64
        Order of the splats.
    labels : (N,) uint32
        Object label of each splat.
    label : int
        Object to move.
    """
    own = labels[rows] == label
    return np.concatenate([rows[own], rows[~own]])


def object_curves(
    splats: Splats,
    orders: Mapping[str, NDArray[np.int64]],
    wanted: Sequence[int],
    shares: Sequence[float],
    cameras: Sequence[Camera],
    *,
    background: Colour = (0.0, 0.0, 0.0),
    threads: int = 0,
    progress: Progress = silent,
) -> list[ObjectPoint]:
    """Measure objects in prefixes of each order, with and without the object first.

    Parameters
    ----------
    splats : Splats
        Scene with object labels in the attribute ``object``.
    orders : mapping of str to (N,) int64
        Orders of the splats, by name.
    wanted : sequence of int
        Labels of the objects to measure; empty for all except 0 (no object).
    shares : sequence of float
        Lengths of the prefixes as shares of the splats, above 0 to 1.
    cameras : sequence of Camera
        Test views; at least one.
    background : tuple of float
        RGB behind the splats.
    threads : int
        0 for all cores; the figures do not depend on it.
    progress : Progress
        Called with the stage ``objects``.

    Raises
    ------
    DataError
        ``no-objects`` and ``bad-objects`` of `labels_of`; ``object-missing``: a requested object
        is not in the scene.
    """
    labels = labels_of(splats)
    known = np.unique(labels).tolist()
    objects = list(wanted) or [label for label in known if label]
    absent = [label for label in objects if label not in known]
    if absent or not objects:
        raise DataError(
            "object-missing",
            f"object {absent[0] if absent else 'labels of 0 alone'}, expected some of {known[:16]}",
        )
    sizes = counts(len(splats), shares)
    plain = splats.without_extras()
    versions: list[tuple[str, int | None, int]] = []
    scenes: list[Splats] = []
    for name, rows in orders.items():
        for label in (None, *objects):
            placed = rows if label is None else object_first(rows, labels, label)
            ordered = plain.take(placed[: max(sizes)])
            named = name if label is None else f"{name}, object first"
            versions += [(named, label, number) for number in range(len(sizes))]
            scenes += [ordered.take(slice(0, size)) for size in sizes]
    found = object_qualities_of(
        splats, scenes, cameras, background=background, threads=threads, progress=progress
    )
    points = []
    for label in objects:
        for (name, of, number), qualities in zip(versions, found, strict=True):
            if of not in (None, label):
                continue
            own = next(quality for quality in qualities if quality.object == label)
            points.append(
                ObjectPoint(name, label, shares[number], sizes[number], own.psnr_db, own.worst_db)
            )
    return points


def object_charts(points: Sequence[ObjectPoint], title: str) -> dict[str, str]:
    """Return an SVG chart per object, by file name."""
    pages = {}
    names = list(dict.fromkeys(point.name for point in points))
    for label in dict.fromkeys(point.object for point in points):
        series = [
            Series(
                name,
                tuple(
                    (100 * point.share, point.psnr_db)
                    for point in points
                    if (point.name, point.object) == (name, label)
                    and point.psnr_db is not None
                    and point.psnr_db < _MAX_DB
                ),
                look,
            )
            for look, name in enumerate(names)
        ]
        pages[f"object-{label}.svg"] = line_chart(
            f"{title}, object {label}",
            "splats, %",
            "PSNR over the object's pixels, dB",
            [one for one in series if one.points],
            x_text=lambda x: f"{x:.3g}",
        )
    return pages
