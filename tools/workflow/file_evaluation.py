"""Measurement of the file that ``cogsplat encode`` writes: test views, PSNR and SSIM, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, StageCost, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import at_width
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation import prefix_quality, report_page
from cogsplat.tools.evaluation.measuring_costs import comparison_costs
from cogsplat.tools.evaluation.photos import Photos, read_photos
from cogsplat.tools.evaluation.prefix_quality import PrefixQuality
from cogsplat.tools.terminal.output import print_facts, print_line, print_table, size_text
from cogsplat.tools.terminal.values import Colour

from .inputs import evaluation_cameras
from .scene_edits import SceneEdits

# Options that the report lists.
_SETTINGS: Final = (
    "profile",
    "quality",
    "target_psnr",
    "target_size",
    "preset",
    "order",
    "chunk_splats",
    "cells",
    "no_morton",
    "no_refine",
    "no_compensation",
    "prune",
    "no_prune",
    "no_jitter",
    "top_k",
    "eval_every",
    "background",
)


@dataclass(frozen=True, eq=False)
class FileEvaluation:
    """Source scene and test views that an encoded file is compared with.

    Parameters
    ----------
    source : Splats
        Scene that is encoded.
    cameras : sequence of Camera
        Test views.
    what : str
        Description of the test views, for output.
    background : tuple of float
        RGB behind the splats.
    photos : Photos or None
        Photos of the test views.
    """

    source: Splats
    cameras: Sequence[Camera]
    what: str
    background: Colour
    photos: Photos | None

    @classmethod
    def prepare(
        cls,
        scene: Path,
        source: Splats,
        cameras: Path | None,
        eval_every: int,
        edits: SceneEdits,
        images: Path | None,
        background: Colour,
        *,
        shown_at: int | None = None,
        threads: int = 0,
    ) -> FileEvaluation:
        """Return the evaluation in the held-out cameras, or in all cameras if none is held out.

        With `shown_at`, pictures have this width, px.

        Raises
        ------
        CogsplatError
            Cameras or photos cannot be read.
        """
        views, what = evaluation_cameras(scene, source, cameras, eval_every)
        if cameras is not None:
            what += " never given to the encoder" if eval_every else ", all given to the encoder"
        if what != "virtual views":
            views = [edits.camera(view) for view in views]
        views = at_width(views, shown_at)
        photos = None
        if images is not None:
            photos = read_photos(images, source, views, background, threads=threads)
        return cls(source, views, what, background, photos)

    def stage_costs(self) -> list[StageCost]:
        """Return the expected cost of `measure`, in the unit of `codec.encode.stage_costs`."""
        costs = comparison_costs(len(self.source), self.cameras, close=False)
        once = sum(cost.total() for cost in costs)
        return [StageCost("measure", len(prefix_quality.PREFIX_FRACTIONS) * once)]

    def measure(
        self, path: Path, *, threads: int = 0, progress: Progress = silent
    ) -> list[PrefixQuality]:
        """Measure prefixes of a file (`prefix_quality.measure`)."""
        return prefix_quality.measure(
            path,
            self.source,
            self.cameras,
            background=self.background,
            photos=self.photos,
            threads=threads,
            progress=progress,
        )

    def report_input(
        self,
        scene: Path,
        scene_bytes: int,
        path: Path,
        found: Sequence[PrefixQuality],
        settings: Sequence[tuple[str, str]],
    ) -> report_page.ReportInput:
        """Return the input of the report page on a file."""
        return report_page.ReportInput(
            scene=scene,
            source_bytes=scene_bytes,
            source=self.source,
            path=path,
            cameras=self.cameras,
            test_views=self.what,
            background=self.background,
            photos=self.photos,
            qualities=found,
            settings=settings,
        )

    def print_results(self, found: Sequence[PrefixQuality]) -> None:
        """Print the measured PSNR and SSIM of each prefix."""
        columns = ["bytes", "", "splats", "PSNR dB", "SSIM", "worst", "roam"]
        rows = [
            [
                f"{q.share:.0%}",
                size_text(q.size_bytes),
                f"{q.splats:,}",
                f"{q.held_out_db:.2f}",
                f"{q.held_out_ssim:.4f}",
                f"{q.worst_db:.2f}",
                f"{q.roam_db:.2f}",
                *([] if q.photos_db is None else [f"{q.photos_db:.2f}"]),
            ]
            for q in found
        ]
        print_line("")
        print_line(f" by {self.what}")
        print_table([*columns, *(["photos"] if self.photos else [])], rows, left=0)
        reached = found[-1].photos_db
        if self.photos and reached is not None:
            source_db = self.photos.source_db
            print_line("")
            print_facts(("photos", f"source {source_db:.2f} dB, {source_db - reached:.2f} lost"))


def settings_of(context: click.Context, views: int, seconds: float) -> list[tuple[str, str]]:
    """Return the settings of an encode as pairs of name and text, for its report.

    Parameters
    ----------
    context : click.Context
        Context of ``encode``.
    views : int
        Number of scored views.
    seconds : float
        Duration of the encode.
    """
    settings = []
    for option in context.command.params:
        name = option.name or ""
        value = context.params.get(name)
        if name in _SETTINGS and value is not None and value is not False:
            default = context.get_parameter_source(name) is click.core.ParameterSource.DEFAULT
            settings.append(
                (option.opts[0], f"{_value_text(value)}{' (default)' if default else ''}")
            )
    return [*settings, ("views scored", str(views)), ("seconds", f"{seconds:.1f}")]


def _value_text(value: object) -> str:
    """Return the value of an option as text."""
    if isinstance(value, ByteCount):
        return (
            f"{float(value.amount):.4g} of SCENE" if value.is_share else f"{int(value.amount):,} B"
        )
    if isinstance(value, tuple):
        return ", ".join(f"{part:g}" for part in value)
    return "yes" if value is True else str(value)
