"""``cogsplat lab views``: planned cameras for a scene without cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress
from cogsplat.codec.splats import Splats
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.tools.cli.render import fitted
from cogsplat.tools.pictures.contact_sheet import THUMBNAIL, contact_sheet
from cogsplat.tools.pictures.png import write_png
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.inputs import read_any
from cogsplat.tools.workflow.output_files import check_outputs

if TYPE_CHECKING:
    from PIL.Image import Image

# Scoring more views takes hours; planning keeps six candidate poses per view in memory.
_MOST_VIEWS: Final = 1024


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat lab views scene.ply views.png\n"
    "  cogsplat lab views scene.ply views.json --count 96\n"
    "  cogsplat encode scene.ply scene.cogs --cameras views.json"
)
@click.argument("path", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(".json"), metavar="OUT.json|OUT.png")
@click.option(
    "--count",
    type=click.IntRange(1, _MOST_VIEWS),
    metavar="N",
    help="Number of views; a few more may cover what these miss.  [default: 64]",
)
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def views(
    path: Path,
    out: Path,
    count: int | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Plan views to score a SCENE without cameras.

    OUT.json is a cameras.json in INRIA's format, to edit and to pass to --cameras of other
    commands. OUT.png is a contact sheet of the views. The same scene gives the same views.
    """
    from cogsplat.codec.views.planner import ViewPlanConfig, plan_views

    kind = out.suffix.lower()
    if kind not in (".json", ".png"):
        raise click.UsageError(f"{out}, expected an output that ends in .json or .png")
    check_outputs(out, force=force)
    config = ViewPlanConfig(threads=threads)
    if count is not None:
        config = replace(config, views=count)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            splats = read_any(path, threads=threads).splats
        cameras = plan_views(splats, config, progress=stages)
        if kind == ".png":
            sheet = _sheet(splats, cameras, threads, stages)
        with stages.stage("write"):
            if kind == ".png":
                write_png(sheet, out, force=force)
            else:
                write_cameras_json(cameras, out, force=force)
    with storage_errors(out):
        written = out.stat().st_size
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(path),
                "bytes": written,
                "views": len(cameras),
                "width": config.width,
                "height": config.height,
                "splats": len(splats),
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        what = "a contact sheet of " if kind == ".png" else ""
        print_line(f"{out}: {what}{count_text(len(cameras), 'view')}, {size_text(written)}")
        print_facts(("size", f"{config.width}x{config.height} px"), ("time", stages.summary()))


def _sheet(splats: Splats, cameras: Sequence[Camera], threads: int, progress: Progress) -> Image:
    """Return a contact sheet of renders."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render_views

    config = RenderConfig(threads=threads)
    small = [fitted(camera, *THUMBNAIL) for camera in cameras]
    images = render_views(splats, small, config, progress=progress)
    return contact_sheet(images, [camera.name for camera in cameras])
