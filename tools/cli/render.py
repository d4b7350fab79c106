"""``cogsplat render``: a picture of a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.views.pose import down_direction
from cogsplat.codec.views.view_text import parse_view
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    compensate_option,
    device_option,
    force_option,
    json_option,
    part_options,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.output_names import PNG, check_name, format_option
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.terminal.values import ChunkRange, Colour, picture_size
from cogsplat.tools.workflow.inputs import (
    LoadedScene,
    Selection,
    load_cameras,
    read_any,
)
from cogsplat.tools.workflow.order_options import parse_view_option
from cogsplat.tools.workflow.output_files import check_outputs


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat render scene.cogs whole.png --cameras cameras.json --view 3\n"
    "  cogsplat render scene.cogs tenth.png --bytes 10% --size 960x720"
)
@click.argument("path", type=INPUT, metavar="IN")
@click.argument("out", type=OutputPath(".png"), metavar="OUT.png")
@cameras_option("The first of them is rendered, or that of --view.")
@click.option(
    "--view",
    type=parse_view_option,
    metavar="POSE|INDEX",
    help="Pose x,y,z,tx,ty,tz,fov[,roll], or the index of a camera of --cameras, from 0.  "
    "[default: the file's first view, or one chosen by what it shows]",
)
@click.option(
    "--size",
    "picture",
    type=picture_size,
    metavar="WxH",
    help="Picture size; the whole view of the camera stays visible.  [default: the camera's]",
)
@format_option(["png"], "Without it, a name with the extension of another format is refused.")
@background_option
@part_options
@compensate_option
@partial_option
@limits_option
@device_option("Device that renders.")
@threads_option
@force_option
@quiet_option
@json_option
def render(
    path: Path,
    out: Path,
    cameras: Path | None,
    view: str | None,
    picture: tuple[int, int] | None,
    format_name: str | None,
    background: Colour,
    chunks: ChunkRange | None,
    least_splats: int | None,
    size: ByteCount | None,
    objects: tuple[int, ...] | None,
    sh_degree: int | None,
    compensate: bool,
    device: str,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Render a scene, or a part of a COGS file, as a PNG."""
    from cogsplat.codec.render.rasteriser import RenderConfig
    from cogsplat.codec.render.rasteriser import render as draw
    from cogsplat.tools.pictures.png import to_image, write_png

    check_name(out, PNG, insisted=format_name is not None)
    check_outputs(out, force=force)
    part = Selection(chunks, least_splats, size, sh_degree, objects, compensate=compensate)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            scene = read_any(path, part, threads=threads)
            camera = _camera(scene, cameras, view, threads)
        if picture:
            camera = fitted(camera, *picture)
        config = RenderConfig(
            background=background,
            threads=threads,
            device=device,
        )
        with stages.stage("render"):
            image = to_image(draw(scene.splats, camera, config))
        with stages.stage("write"):
            written = write_png(image, out, force=force)
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(path),
                "bytes": written,
                "width": camera.width,
                "height": camera.height,
                "camera": camera.name,
                "splats": len(scene.splats),
                "source_splats": scene.file_splats,
                "sh_degree": scene.splats.sh_degree,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{out}: {camera.width}x{camera.height}, {size_text(written)}")
        drawn = f"{len(scene.splats):,} of {scene.file_splats:,}"
        print_facts(
            ("camera", camera.name or view or "0"),
            ("splats", f"{drawn}, SH degree {scene.splats.sh_degree}"),
            ("time", stages.summary()),
        )


def _camera(scene: LoadedScene, cameras: Path | None, view: str | None, threads: int) -> Camera:
    """Return the camera that the options choose; by default the first view of the scene."""
    if view is not None and not view.isdecimal():
        up = scene.up if scene.up is not None else -down_direction(scene.splats.info.axes)
        return parse_view(view).camera(up)
    if cameras is not None:
        views, index = load_cameras(cameras), int(view or 0)
        if index >= len(views):
            raise click.UsageError(f"--view {index}, expected 0 to {len(views) - 1}, or a pose")
        return views[index]
    if view is not None:
        raise click.UsageError(f"--view {view} without --cameras, expected them, or a pose")
    if scene.first_view is not None:
        return scene.first_view
    from cogsplat.codec.views.first_look_search import find_first_look

    found = find_first_look(scene.splats, threads=threads).view
    if found is None:
        raise DataError("empty-scene", "no splat that can be drawn, expected --view")
    return found


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera of another picture size that shows the whole view without distortion.

    Parameters
    ----------
    camera : Camera
        Camera whose view to show.
    width, height : int
        New size, px. With another aspect ratio, the picture shows more at two sides.
    """
    scale = min(width / camera.width, height / camera.height)
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=0.5 * width + (camera.cx - 0.5 * camera.width) * scale,
        cy=0.5 * height + (camera.cy - 0.5 * camera.height) * scale,
    )
