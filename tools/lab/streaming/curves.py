"""Chart and picture strips of a simulated trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cogsplat.tools.pictures.filmstrip import BACKGROUND, filmstrip
from cogsplat.tools.pictures.svg_charts import Series, line_chart

from .comparison import PEER, POLICIES, Moment

if TYPE_CHECKING:
    from PIL.Image import Image

F32 = NDArray[np.float32]

# Identical pictures have 100 dB, which would compress the rest of the chart to its lower half.
_MAX_DB = 60.0


def psnr_chart(measured: Mapping[str, Sequence[Moment]], title: str) -> str:
    """Return an SVG chart of PSNR over time, one line per policy.

    Parameters
    ----------
    measured : mapping of str to sequence of Moment
        Moments by policy.
    title : str
        Title of the chart.
    """
    series = [
        Series(
            name,
            tuple((moment.seconds, min(moment.psnr_db, _MAX_DB)) for moment in moments),
            (*POLICIES, PEER).index(name),
        )
        for name, moments in measured.items()
    ]
    return line_chart(
        title,
        "seconds",
        "PSNR against the reference, dB",
        series,
        note=f"values above {_MAX_DB:g} dB are drawn at {_MAX_DB:g} dB",
    )


def picture_strips(
    pictures: Mapping[str, Sequence[F32]], measured: Mapping[str, Sequence[Moment]], title: str
) -> Image:
    """Return an image of stacked film-strips: the reference, then each policy.

    Parameters
    ----------
    pictures : mapping of str to sequence of (H, W, 3) float32
        Pictures by policy, one per moment; the key of the reference is empty.
    measured : mapping of str to sequence of Moment
        Moments of the pictures, by policy.
    title : str
        Caption of the reference strip.
    """
    from PIL import Image

    rows = []
    for name, strip in pictures.items():
        moments = next(iter(measured.values())) if not name else measured[name]
        captions = [
            [f"{moment.seconds:.1f} s"]
            if not name
            else [f"{moment.psnr_db:.1f} dB", f"{moment.bytes / 1000:,.0f} kB"]
            for moment in moments
        ]
        rows.append(filmstrip(strip, captions, name or title))
    size = max(row.width for row in rows), sum(row.height for row in rows)
    page = Image.new("RGB", size, BACKGROUND)
    top = 0
    for row in rows:
        page.paste(row, (0, top))
        top += row.height
    return page
