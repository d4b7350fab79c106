"""Predicted quality of a new file, as text and as JSON, for the commands that write one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

from cogsplat.codec.encode.encoded import EncodeReport
from cogsplat.codec.views.view_sets import CLOSE_SHARE
from cogsplat.tools.terminal.output import count_text

_ORIGINS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "given": "given to measure in",
        "left-out": "left out of the given cameras",
        "scored": "scored as well, since the cameras are too few",
        "planned": "planned around the scene",
    }
)


def predicted_facts(made: EncodeReport) -> tuple[tuple[str, str], ...]:
    """Return the predicted PSNR in test views and in close views as named texts.

    Parameters
    ----------
    made : EncodeReport
        Report of an encode or a tuning run.
    """
    views = f"{count_text(len(made.test_psnr_db), 'view')} {_ORIGINS.get(made.test_views, '')}"
    close = f"{count_text(len(made.close_psnr_db), 'view')} from {CLOSE_SHARE:.0%} of the distance"
    return (
        ("predicted", _text(made.test_psnr_db, made.test_distances, views)),
        ("close up", _text(made.close_psnr_db, made.close_distances, close)),
    )


def _text(values: Sequence[float], distances: Sequence[float], views: str) -> str:
    """Return mean and worst PSNR as text; empty without values."""
    found = _summarise(values, distances)
    if found is None:
        return ""
    mean, worst, distance = found
    where = "" if distance is None else f" from {distance:.3g} away"
    return f"{mean:.2f} dB in {views}; the worst {worst:.2f} dB{where}"


def prediction_report(made: EncodeReport) -> dict[str, object]:
    """Return the JSON keys of the predicted PSNR.

    Parameters
    ----------
    made : EncodeReport
        Report of an encode or a tuning run.
    """
    test = _figures(made.test_psnr_db, made.test_distances)
    return {
        "predicted_psnr_db": test["psnr_db"],
        "predicted_worst_psnr_db": test["worst_psnr_db"],
        "predicted_worst_distance": test["worst_distance"],
        "predicted_close": {
            **_figures(made.close_psnr_db, made.close_distances),
            "count": len(made.close_psnr_db),
        },
        "test_views": {"from": made.test_views, "count": len(made.test_psnr_db)},
    }


def _figures(values: Sequence[float], distances: Sequence[float]) -> dict[str, float | None]:
    """Return mean and worst PSNR and the distance of the worst view; None where not measured."""
    found = _summarise(values, distances)
    if found is None:
        return {"psnr_db": None, "worst_psnr_db": None, "worst_distance": None}
    mean, worst, distance = found
    return {
        "psnr_db": round(mean, 3),
        "worst_psnr_db": round(worst, 3),
        "worst_distance": None if distance is None else round(distance, 4),
    }


def _summarise(
    values: Sequence[float], distances: Sequence[float]
) -> tuple[float, float, float | None] | None:
    """Return mean and worst PSNR, and the distance of the worst view; None without values.

    The distance is None where distances were not measured.
    """
    if not values:
        return None
    worst = values.index(min(values))
    distance = distances[worst] if len(distances) == len(values) else None
    return sum(values) / len(values), values[worst], distance
