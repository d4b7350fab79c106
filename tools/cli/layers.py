"""``cogsplat layers``: a scene in levels for pictures of several sizes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.errors import DataError
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.colmap_points import find_points, read_points
from cogsplat.formats.cogs.metadata import FileMetadata
from cogsplat.formats.storage.atomic import check_output
from cogsplat.tools.evaluation.photos import read_photos
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    eval_every_option,
    force_option,
    json_option,
    quality_option,
    quiet_option,
    threads_option,
    training_images_option,
    training_seed_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_json,
    print_line,
    print_table,
    size_text,
)
from cogsplat.tools.terminal.output_names import COGS, check_name, format_option
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.terminal.values import Colour
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    input_files,
    load_cameras,
    plan_cameras,
    read_any,
)

if TYPE_CHECKING:
    from cogsplat.codec.cameras import Camera
    from cogsplat.tools.evaluation.level_figures import LevelSizes, PictureFigures

F32 = NDArray[np.float32]

# Pixels per side that SSIM needs (`metrics.ssim`).
_LEAST_PIXELS: Final = 11
# Training steps of a level that begins with trained splats, or with points.
_STEPS, _GROWING_STEPS = 400, 2000
_MOST_SPLATS: Final = 100_000


@click.command(
    epilog="\b\nExamples:\n"
    "  cogsplat layers scene.ply levels.cogs --cameras cameras.json\n"
    "  cogsplat layers capture levels.cogs --images capture/images --splats 200000",
)
@click.argument("scene", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(), metavar="OUT")
@cameras_option("Without it, the cameras of SCENE if it is a COLMAP folder, else planned views.")
@click.option(
    "--scales",
    type=str,
    default="8,4,2,1",
    show_default=True,
    metavar="N,…",
    help="Divisors of the pictures' width and height, one for each level.",
)
@click.option(
    "--shares",
    type=str,
    default="8%,25%,60%,100%",
    show_default=True,
    metavar="P%,…",
    help="Share of the splats of SCENE, or of --splats, in each level with all levels before it.",
)
@click.option(
    "--splats",
    "most",
    type=click.IntRange(1),
    metavar="N",
    help=f"Splats of all levels at most, if SCENE is points.  [default: {_MOST_SPLATS}]",
)
@click.option(
    "--steps",
    type=click.IntRange(0),
    metavar="N",
    help="Training steps of each level, one view per step.  "
    f"[default: {_STEPS}, or {_GROWING_STEPS} if SCENE is points]",
)
@training_images_option
@quality_option("Nominal PSNR of the file, as in encode.")
@training_seed_option
@eval_every_option(0, "do not train in it, measure in it.")
@format_option(["cogs"], "Without it, a name with the extension of another format is refused.")
@background_option
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def layers(
    scene: Path,
    out: Path,
    cameras: Path | None,
    scales: str,
    shares: str,
    most: int | None,
    steps: int | None,
    images: Path | None,
    quality: float,
    seed: int,
    eval_every: int,
    format_name: str | None,
    background: Colour,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Split SCENE into levels for pictures of different sizes.

    The first level is trained on the smallest pictures. Each further level adds splats trained on
    larger pictures. Splats of lower levels change only in opacity. A reader fetches one level at a
    time.

    SCENE is a trained scene, or a COLMAP folder with points. In the second case, splats are trained
    from the points and --images.
    """
    from cogsplat.codec.fit.downscaling import downscale_camera, downscale_picture
    from cogsplat.codec.fit.initial_splats import splats_from_points
    from cogsplat.codec.fit.level_encoding import LevelEncoding, encode_levels
    from cogsplat.codec.fit.level_training import grow_levels, train_levels
    from cogsplat.codec.fit.train_config import LevelsConfig
    from cogsplat.tools.evaluation.level_figures import level_sizes, picture_figures

    points = find_points(scene)
    if points is not None and images is None:
        raise click.UsageError(f"{scene}: points without --images, expected photos")
    if points is None and images is not None and cameras is None:
        raise click.UsageError("--images without --cameras, expected the cameras of the photos")
    if points is None and most is not None:
        raise click.UsageError("--splats with a trained scene, expected a COLMAP folder of points")
    try:
        config = LevelsConfig(
            tuple(int(scale) for scale in scales.split(",")),
            tuple(float(share.strip().removesuffix("%")) / 100 for share in shares.split(",")),
            steps=steps if steps is not None else _STEPS if points is None else _GROWING_STEPS,
            seed=seed,
            threads=threads,
        )
    except ValueError as error:
        raise click.UsageError(f"--scales {scales}, --shares {shares}: {error}") from error
    check_name(out, COGS, insisted=format_name is not None)
    check_output(out, force=force, inputs=list(input_files(scene, cameras, images)))
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            if points is not None:
                found_points = read_points(points, limits=current_limits())
                read = splats_from_points(found_points.positions, found_points.colours)
                cameras = cameras or points.parent
            else:
                read = read_any(scene, threads=threads).splats
            splats = drop_invalid_splats(read, scene).without_extras()
            if not len(splats):
                raise DataError("empty-scene", f"{scene}: 0 splats, expected some to train")
        if cameras is not None:
            views, tests = hold_out(load_cameras(cameras), eval_every)
            if not views:
                raise click.UsageError(f"--eval-every {eval_every} holds out all cameras")
        else:
            views, tests = plan_cameras(splats, threads=threads, progress=stages), []
        _require_pixels(views, max(config.scales))
        judged = tests or views
        photos = None
        if images is not None:
            photos = _photos(images, splats, views, background, threads)
        if points is None:
            trained = train_levels(splats, views, config, pictures=photos, progress=stages)
            full = _render_all(splats, judged, threads)
        else:
            assert photos is not None
            trained = grow_levels(
                splats, views, photos, most or _MOST_SPLATS, config, progress=stages
            )
            assert images is not None
            full = _photos(images, splats, tests, background, threads) if tests else photos
        encoding = LevelEncoding(quality_db=quality, threads=threads)
        encoded = encode_levels(trained, views, encoding, progress=stages)
        with stages.stage("write"):
            metadata = FileMetadata(None if cameras is None else views[0])
            size = metadata.save(encoded, out, force=force)
        found: list[tuple[LevelSizes, PictureFigures]] = []
        with cogsplat.open(out) as file:
            for sizes in level_sizes(file):
                scale = int(sizes.scale)
                targets = [downscale_picture(picture, scale) for picture in full]
                small = [downscale_camera(camera, scale) for camera in judged]
                drawn = file.decode(level=sizes.level, threads=threads)
                found.append((sizes, picture_figures(drawn, small, targets, threads)))
                stages("measure", sizes.level + 1, len(file.root.levels))
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(scene),
                "bytes": size,
                "splats": encoded.splats,
                "source_splats": len(splats),
                "test_views": {"from": "given" if tests else "trained in", "count": len(judged)},
                "levels": [{**sizes.report(), **figures.report()} for sizes, figures in found],
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        _print_summary(out, size, found, len(judged), held_out=bool(tests))


def _require_pixels(cameras: list[Camera], scale: int) -> None:
    """Refuse cameras whose reduced pictures are too small for SSIM."""
    for camera in cameras:
        if min(camera.width, camera.height) < scale * _LEAST_PIXELS:
            raise click.UsageError(
                f"--scales {scale}: camera {camera.name!r} has {camera.width}x{camera.height} "
                f"pixels, expected at least {scale * _LEAST_PIXELS} a side"
            )


def _photos(
    folder: Path, splats: cogsplat.Splats, cameras: list[Camera], background: Colour, threads: int
) -> list[F32]:
    """Return the photos of cameras, components 0 to 1."""
    taken = read_photos(folder, splats, cameras, background, threads=threads)
    return [pixels.astype(np.float32) / np.float32(255) for pixels in taken.pictures]


def _render_all(splats: cogsplat.Splats, cameras: list[Camera], threads: int) -> list[F32]:
    """Return the renders of a scene at full size."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    info = splats.info
    config = RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased, threads=threads)
    return [render(splats, camera, config) for camera in cameras]


def _print_summary(
    out: Path,
    size: int,
    found: list[tuple[LevelSizes, PictureFigures]],
    views: int,
    *,
    held_out: bool,
) -> None:
    """Print the summary of the file: one row for each level."""
    whose = "held-out views" if held_out else "training views"
    print_line(f"{out}: {size_text(size)}, measured in {views} {whose}")
    rows = [
        (
            f"1/{sizes.scale:g}",
            f"{sizes.splats:,}",
            f"{sizes.left_out:,}",
            f"{sizes.bytes_fetched:,}",
            f"{sizes.opacity_bytes:,}",
            f"{figures.psnr_db:.2f}",
            f"{figures.worst_psnr_db:.2f}",
            f"{figures.ssim:.4f}",
        )
        for sizes, figures in found
    ]
    heads = ("level", "splats", "left out", "fetched B", "opacities B", "PSNR", "worst", "SSIM")
    print_table(heads, rows, left=0)
