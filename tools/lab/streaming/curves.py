"""What policies show along a trace, as a chart and as rows of pictures."""

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

# 100 dB, where nothing differs any more, would press all else into the lower half of a chart.
_TOP_DB = 60.0


def chart(along: Mapping[str, Sequence[Moment]], title: str) -> str:
    """Return an SVG chart of PSNR over time, a line for each policy.

    Parameters
    ----------
    along : mapping of str to sequence of Moment
    title : str
    """
    series = [
        Series(
            name,
            tuple((moment.seconds, min(moment.psnr_db, _TOP_DB)) for moment in moments),
            (*POLICIES, PEER).index(name),
        )
        for name, moments in along.items()
    ]
    return line_chart(
        title,
        "seconds",
        "PSNR against the whole, dB",
        series,
        note=f"what is above {_TOP_DB:g} dB is drawn there",
    )


def strips(
    pictures: Mapping[str, Sequence[F32]], along: Mapping[str, Sequence[Moment]], title: str
) -> Image:
    """Return a picture of film-strips, one below the other: the whole scene, then each policy.

    Parameters
    ----------
    pictures : mapping of str to sequence of (H, W, 3) float32
        By policy, empty for the whole scene: one of each moment.
    along : mapping of str to sequence of Moment
        The same moments.
    title : str
    """
    from PIL import Image

    rows = []
    for name, seen in pictures.items():
        moments = next(iter(along.values())) if not name else along[name]
        captions = [
            [f"{moment.seconds:.1f} s"]
            if not name
            else [f"{moment.psnr_db:.1f} dB", f"{moment.bytes / 1000:,.0f} kB"]
            for moment in moments
        ]
        rows.append(filmstrip(seen, captions, name or title))
    size = max(row.width for row in rows), sum(row.height for row in rows)
    page = Image.new("RGB", size, BACKGROUND)
    top = 0
    for row in rows:
        page.paste(row, (0, top))
        top += row.height
    return page
