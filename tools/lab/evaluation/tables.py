"""Tables, plots and JSON output of an evaluation."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.splats import Splats
from cogsplat.tools.evaluation.photos import Photos
from cogsplat.tools.pictures.svg_charts import Series, line_chart
from cogsplat.tools.terminal.output import (
    display_name,
    display_title,
    print_facts,
    print_line,
    print_table,
    size_text,
)

from .evaluator import Evaluator
from .object_curves import ObjectPoint, object_charts
from .progs_protocol import BYTES, FIGURES, SPLATS, PrefixPoint, areas

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores

_TITLES: Final[Mapping[str, str]] = {
    "held_out_db": "held-out",
    "worst_db": "worst",
    "roam_db": "roam",
}
STRIPS: Final[Mapping[str, str]] = {SPLATS: "strips-splats.png", BYTES: "strips-bytes.png"}
"""File names of the film-strips of prefixes."""

DIFFERENCES: Final[Mapping[str, str]] = {
    SPLATS: "differences-splats.png",
    BYTES: "differences-bytes.png",
}
"""File names of the film-strips of differences to the full render."""


def _charts(by: str) -> dict[str, str]:
    """Return the file name of each figure's chart."""
    return {figure: f"{by}-{title}.svg" for figure, title in _TITLES.items()}


@dataclass(frozen=True, eq=False)
class EvaluationInput:
    """Input of an evaluation: the scene, its scores and its test views.

    Parameters
    ----------
    path : Path
        Path of the scene.
    splats : Splats
    scores : Scores
        Scores of the splats.
    scored_on : sequence of Camera
        Training views of the scores.
    what : str
        Origin of the test views.
    config : OrderConfig
        Parameters of the orders.
    evaluator : Evaluator
    photos : Photos or None
        Photos of the test views.
    """

    path: Path
    splats: Splats
    scores: Scores
    scored_on: Sequence[Camera]
    what: str
    config: OrderConfig
    evaluator: Evaluator
    photos: Photos | None


def picture_names(by: Sequence[str]) -> list[str]:
    """Return the file names of plots and film-strips."""
    return [
        name for kind in by for name in (*_charts(kind).values(), STRIPS[kind], DIFFERENCES[kind])
    ]


def result_files(
    given: EvaluationInput,
    points: Sequence[PrefixPoint],
    by: Sequence[str],
    objects: Sequence[ObjectPoint] = (),
) -> dict[str, str]:
    """Return plots, CSV table and JSON of an evaluation, by file name."""
    title = display_title(given.path, in_folder=True)
    pages: dict[str, str] = {}
    for kind in by:
        own = [point for point in points if point.by == kind]
        names = list(dict.fromkeys(point.name for point in own))
        for figure, page in _charts(kind).items():
            # Differences above 90 dB are invisible; points at the cap would flatten the chart.
            series = [
                Series(
                    name,
                    tuple(
                        (point.x, getattr(point.figures, figure))
                        for point in own
                        if point.name == name and getattr(point.figures, figure) < 90
                    ),
                    look,
                )
                for look, name in enumerate(names)
            ]
            pages[page] = line_chart(
                f"{title}, {_TITLES[figure]} views",
                "splats, %" if kind == SPLATS else "bytes received",
                "PSNR against the full render, dB",
                series,
                x_text=_share_text if kind == SPLATS else lambda x: size_text(int(x)),
            )
    table_ = io.StringIO()
    rows = [point.report() for point in points]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(table_, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    pages["eval.csv"] = table_.getvalue()
    pages["eval.json"] = json.dumps(report(given, points, by, objects), indent=2) + "\n"
    return {**pages, **object_charts(objects, title)}


def _share_text(percent: float) -> str:
    """Format a percentage for an axis."""
    return f"{percent:.3g}"


def report(
    given: EvaluationInput,
    points: Sequence[PrefixPoint],
    by: Sequence[str],
    objects: Sequence[ObjectPoint] = (),
) -> dict[str, object]:
    """Return the JSON output of an evaluation."""
    means = {
        kind: {
            name: {figure: round(value, 4) for figure, value in figures.items()}
            for name, figures in areas([point for point in points if point.by == kind]).items()
        }
        for kind in by
    }
    return {
        "source": display_name(given.path),
        "splats": len(given.splats),
        "test_views": {"from": given.what, "count": len(given.evaluator.cameras)},
        "scored_views": len(given.scored_on),
        "source_photo_db": None if given.photos is None else given.photos.source_db,
        "points": [point.report() for point in points],
        "mean_over_log": means,
        **({"objects": [point.report() for point in objects]} if objects else {}),
    }


def print_results(
    given: EvaluationInput,
    points: Sequence[PrefixPoint],
    by: Sequence[str],
    objects: Sequence[ObjectPoint] = (),
) -> None:
    """Print the tables."""
    splats = given.splats
    print_line(f"{given.path}: {len(splats):,} splats, SH degree {splats.sh_degree}")
    photos = given.photos
    print_facts(
        ("test views", f"{len(given.evaluator.cameras)} {given.what}"),
        ("scored", f"on {len(given.scored_on)} views"),
        ("photos", "" if photos is None else f"{photos.source_db:.2f} dB for the source"),
    )
    for kind in by:
        own = [point for point in points if point.by == kind]
        for figure in (*FIGURES, "held_out_ssim", "held_out_lpips", "first_view_db", "photos_db"):
            if getattr(own[0].figures, figure) is not None:
                print_line("")
                _print_figure(own, kind, figure)
    _print_objects(objects)


def _print_objects(points: Sequence[ObjectPoint]) -> None:
    """Print the PSNR of each object, one line per order."""
    for label in dict.fromkeys(point.object for point in points):
        own = [point for point in points if point.object == label]
        print_line("")
        print_line(f"object {label} dB, by splats")
        rows = []
        for name in dict.fromkeys(point.name for point in own):
            values = [point.psnr_db for point in own if point.name == name]
            rows.append((name, *("" if value is None else f"{value:.2f}" for value in values)))
        shares = dict.fromkeys(point.share for point in own)
        print_table(("splats", *(f"{100 * share:.3g} %" for share in shares)), rows)


def _print_figure(points: Sequence[PrefixPoint], kind: str, figure: str) -> None:
    """Print one figure, one line per order or file."""
    what, digits = figure.replace("_", " "), 4
    if figure.endswith("_db"):
        what, digits = f"{figure.removesuffix('_db').replace('_', ' ')} dB", 2
    print_line(f"{what}, by {kind}")
    # Complete files differ in size, so their points share the last column.
    lengths = sorted({point.x for point in points if point.share < 1})
    heads = [f"{x:.3g} %" if kind == SPLATS else size_text(int(x)) for x in lengths]
    whole = {point.name: point for point in points if point.share >= 1}
    rows = []
    for name, area in areas(points).items():
        shown = {p.x: p for p in points if p.name == name and p.share < 1}
        cells = [shown.get(x) for x in lengths] + ([whole.get(name)] if whole else [])
        texts = ["" if p is None else f"{getattr(p.figures, figure):.{digits}f}" for p in cells]
        end = whole.get(name)
        if kind == BYTES and whole:
            texts.append("" if end is None else size_text(int(end.x)))
        rows.append((name, *texts, *([f"{area[figure]:.2f}"] if figure in area else [])))
    last = (["whole", "of"] if kind == BYTES else ["100 %"]) if whole else []
    print_table((kind, *heads, *last, *(["mean"] if figure in FIGURES else [])), rows)
