"""``cogsplat layers``: a scene in levels for pictures of several sizes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np

import cogsplat
from cogsplat.codec.errors import DataError
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cogs import scene as cogs
from cogsplat.formats.storage.atomic import check_output
from cogsplat.tools.evaluation.photos import read_photos
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    eval_every_option,
    force_option,
    json_option,
    quality_option,
    quiet_option,
    taught_by_option,
    threads_option,
    training_seed_option,
)
from cogsplat.tools.terminal.output import name_of, say, say_json, size_text, table
from cogsplat.tools.terminal.output_names import COGS, check_name, format_option
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.terminal.values import Colour

from .inputs import given_cameras, given_files, read_any, usable_rows, virtual_views

if TYPE_CHECKING:
    from cogsplat.codec.cameras import Camera
    from cogsplat.tools.evaluation.level_figures import LevelSizes, PictureFigures

# What SSIM needs (`metrics.ssim`).
_LEAST_PIXELS: Final = 11


@click.command(
    epilog="\b\nExample:\n  cogsplat layers scene.ply levels.cogs --cameras cameras.json",
)
@click.argument("scene", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(), metavar="OUT")
@cameras_option("Without it, views are planned around the scene.")
@click.option(
    "--scales",
    type=str,
    default="8,4,2,1",
    show_default=True,
    metavar="N,…",
    help="By what the pictures of each level are divided in width and height.",
)
@click.option(
    "--shares",
    type=str,
    default="8%,25%,60%,100%",
    show_default=True,
    metavar="P%,…",
    help="Share of the splats of SCENE that each level and those before it have.",
)
@click.option(
    "--steps",
    type=click.IntRange(0),
    default=400,
    show_default=True,
    metavar="N",
    help="Training steps of each level; a view teaches in each.",
)
@taught_by_option
@quality_option("Nominal PSNR of what is stored, as in encode.")
@training_seed_option
@eval_every_option(0, "Keep from training, and measure in, the")
@format_option(["cogs"], "Without it, a name that says another format is refused.")
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
    steps: int,
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
    """Make SCENE into levels, each for pictures of another size.

    The first level is trained on the smallest pictures; each further one adds splats, which are
    trained on larger pictures while those of lower levels keep all but their opacities. A reader
    fetches what one level draws and nothing else.
    """
    from cogsplat.codec.fit.level_encoding import LevelEncoding, encode_levels
    from cogsplat.codec.fit.levels import LevelsConfig, averaged, scaled_camera, train_levels
    from cogsplat.tools.evaluation.level_figures import compared, level_sizes

    if images is not None and cameras is None:
        raise click.UsageError("--images without --cameras, expected where they were taken from")
    try:
        config = LevelsConfig(
            tuple(int(scale) for scale in scales.split(",")),
            tuple(float(share.strip().removesuffix("%")) / 100 for share in shares.split(",")),
            steps=steps,
            seed=seed,
            threads=threads,
        )
    except ValueError as error:
        raise click.UsageError(f"--scales {scales}, --shares {shares}: {error}") from error
    check_name(out, COGS, insisted=format_name is not None)
    check_output(out, force=force, inputs=list(given_files(scene, cameras, images)))
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            splats = usable_rows(read_any(scene, threads=threads).splats, scene).without_extras()
            if not len(splats):
                raise DataError("empty-scene", f"{scene}: 0 splats, expected some to train")
        if cameras is not None:
            views, tests = hold_out(given_cameras(cameras), eval_every)
            if not views:
                raise click.UsageError(f"--eval-every {eval_every} holds out all cameras")
        else:
            views, tests = virtual_views(splats, threads=threads, progress=stages), []
        _require_pixels(views, max(config.scales))
        photos = None
        if images is not None:
            taken = read_photos(images, splats, views, background, threads=threads)
            photos = [pixels.astype(np.float32) / np.float32(255) for pixels in taken.pictures]
        trained = train_levels(splats, views, config, pictures=photos, progress=stages)
        encoding = LevelEncoding(quality_db=quality, threads=threads)
        encoded = encode_levels(trained, views, encoding, progress=stages)
        with stages.stage("write"):
            size = cogs.save(
                encoded,
                out,
                writer=f"cogsplat {cogsplat.__version__}",
                first_view=views[0] if cameras is not None else None,
                force=force,
            )
        judged = tests or views
        found: list[tuple[LevelSizes, PictureFigures]] = []
        full = _full(splats, judged, threads)
        with cogsplat.open(out) as file:
            for sizes in level_sizes(file):
                scale = int(sizes.scale)
                targets = [averaged(picture, scale) for picture in full]
                small = [scaled_camera(camera, scale) for camera in judged]
                drawn = file.decode(level=sizes.level, threads=threads)
                found.append((sizes, compared(drawn, small, targets, threads)))
                stages("measure", sizes.level + 1, len(file.root.levels))
    if as_json:
        say_json(
            {
                "output": name_of(out),
                "source": name_of(scene),
                "bytes": size,
                "splats": encoded.splats,
                "source_splats": len(splats),
                "test_views": {"from": "given" if tests else "trained in", "count": len(judged)},
                "levels": [{**sizes.report(), **figures.report()} for sizes, figures in found],
                "seconds": stages.rounded(),
            }
        )
    elif not quiet:
        _tell(out, size, found, len(judged), held_out=bool(tests))


def _require_pixels(cameras: list[Camera], scale: int) -> None:
    for camera in cameras:
        if min(camera.width, camera.height) < scale * _LEAST_PIXELS:
            raise click.UsageError(
                f"--scales {scale}: camera {camera.name!r} has {camera.width}x{camera.height} "
                f"pixels, expected at least {scale * _LEAST_PIXELS} a side"
            )


def _full(
    splats: cogsplat.Splats, cameras: list[Camera], threads: int
) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float32]]]:
    """Return the full pictures of the source."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    info = splats.info
    config = RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased, threads=threads)
    return [render(splats, camera, config) for camera in cameras]


def _tell(
    out: Path,
    size: int,
    found: list[tuple[LevelSizes, PictureFigures]],
    views: int,
    *,
    held_out: bool,
) -> None:
    """Print a row for each level."""
    whose = "held-out views" if held_out else "views that it was trained in"
    say(f"{out}: {size_text(size)}, judged in {views} {whose}")
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
    table(heads, rows, left=0)
