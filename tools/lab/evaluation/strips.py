"""Film-strips of prefixes: one row of pictures per order or file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.metrics import psnr
from cogsplat.codec.splats import Splats
from cogsplat.tools.evaluation.prefix_quality import decode_prefix
from cogsplat.tools.pictures.difference import scaled_difference
from cogsplat.tools.pictures.filmstrip import BACKGROUND, filmstrip
from cogsplat.tools.terminal.output import size_text

from .evaluator import Evaluator
from .progs_protocol import PrefixPoint, counts

if TYPE_CHECKING:
    from PIL.Image import Image

STRIP_SHARES: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
"""Shares of the splats in film-strips: the range of visible differences between orders."""

_MAX_PICTURES: Final = 6
_WIDTH_PX: Final = 320


@dataclass(frozen=True, eq=False)
class Strip:
    """Prefixes and captions of one row of pictures.

    Parameters
    ----------
    name : str
        Name of the order or file.
    captions : tuple of str
        Caption of each picture.
    versions : tuple of Splats
        Splats of each picture.
    """

    name: str
    captions: tuple[str, ...]
    versions: tuple[Splats, ...]

    @staticmethod
    def of_order(
        name: str, splats: Splats, rows: NDArray[np.int64], shares: Sequence[float]
    ) -> Strip:
        """Create the strip of an order."""
        sizes = counts(len(rows), shares)
        ordered = splats.without_extras().take(rows[: max(sizes)])
        return Strip(
            name,
            tuple(f"{100 * share:g} % of the splats" for share in shares),
            tuple(ordered.take(slice(0, size)) for size in sizes),
        )

    @staticmethod
    def of_file(
        name: str,
        path: Path,
        points: Sequence[PrefixPoint],
        *,
        compensate: bool = False,
        threads: int = 0,
    ) -> Strip:
        """Create the strip of a file from its shortest measured prefixes."""
        lengths = [point.size_bytes for point in points if point.size_bytes is not None]
        lengths = lengths[:_MAX_PICTURES]
        return Strip(
            name,
            tuple(size_text(length) for length in lengths),
            tuple(
                decode_prefix(path, length, compensate=compensate, threads=threads).without_extras()
                for length in lengths
            ),
        )


def draw_strips(
    evaluator: Evaluator, strips: Sequence[Strip], *, differences: bool = False
) -> Image:
    """Draw strips in rows, each followed by the full render.

    Parameters
    ----------
    evaluator : Evaluator
        Evaluator whose middle test view is shown.
    strips : sequence of Strip
        Strips, at least one.
    differences : bool
        Whether to show the difference to the full render, amplified by `difference.GAIN` (PRoGS,
        figure 5), instead of the prefix.
    """
    from PIL import Image

    camera = evaluator.cameras[len(evaluator.cameras) // 2]
    camera = camera.resized(min(camera.width, _WIDTH_PX))
    whole = evaluator.draw(evaluator.reference, camera)
    rows: list[Image.Image] = []
    for strip in strips:
        pictures = [evaluator.draw(version, camera) for version in strip.versions]
        captions = [
            (caption, f"{psnr(whole, picture):.1f} dB, {len(version):,} splats")
            for caption, picture, version in zip(
                strip.captions, pictures, strip.versions, strict=True
            )
        ]
        if differences:
            pictures = [scaled_difference(whole, picture) for picture in pictures]
        last = ("full render", f"{len(evaluator.reference):,} splats")
        title = f"{strip.name}, {camera.name}"
        rows.append(filmstrip([*pictures, whole], [*captions, last], title))
    size = (max(row.width for row in rows), sum(row.height for row in rows))
    page = Image.new("RGB", size, BACKGROUND)
    top = 0
    for row in rows:
        page.paste(row, (0, top))
        top += row.height
    return page
