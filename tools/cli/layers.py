"""``cogsplat layers``: a scene in levels for pictures of several sizes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.colmap_points import find_points, read_points
from cogsplat.formats.cogs.metadata import FileMetadata
from cogsplat.formats.storage.scratch_folder import scratch_folder
from cogsplat.tools.evaluation.photos import read_ground_truth
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import (
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
from cogsplat.tools.workflow.descriptions import notes_of
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    load_cameras,
    plan_cameras,
    read_any,
)
from cogsplat.tools.workflow.output_files import check_outputs

if TYPE_CHECKING:
    from cogsplat.codec.cameras import Camera
    from cogsplat.codec.fit.train_config import LevelsConfig
    from cogsplat.tools.evaluation.level_figures import LevelQuality

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
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def layers(**options: Any) -> None:
    """Split SCENE into levels for pictures of different sizes.

    The first level is trained on the smallest pictures. Each further level adds splats trained on
    larger pictures. Splats of lower levels change only in opacity. A reader fetches one level at a
    time.

    SCENE is a trained scene, or a COLMAP folder with points. In the second case, splats are trained
    from the points and --images.

    Of a trained scene the summary compares each level with a file that encode makes of SCENE: with
    its first bytes, as many as the level takes with those before it.
    """
    _layers(LayersOptions(**options))


@dataclass(frozen=True)
class LayersOptions:
    """Values of the options of ``layers``."""

    scene: Path
    out: Path
    cameras: Path | None
    scales: str
    shares: str
    most: int | None
    steps: int | None
    images: Path | None
    quality: float
    seed: int
    eval_every: int
    format_name: str | None
    threads: int
    force: bool
    quiet: bool
    as_json: bool

    @cached_property
    def points(self) -> Path | None:
        """File of structure-from-motion points, if the scene is a COLMAP folder with points."""
        return find_points(self.scene)

    def require_consistent(self) -> None:
        """Refuse contradictory options and an unwritable output."""
        points, photos = self.points is not None, self.images is not None
        if points and not photos:
            raise click.UsageError(f"{self.scene}: points without --images, expected photos")
        if photos and not points and self.cameras is None:
            raise click.UsageError("--images without --cameras, expected the cameras of the photos")
        if self.most is not None and not points:
            raise click.UsageError(
                "--splats with a trained scene, expected a COLMAP folder of points"
            )
        check_name(self.out, COGS, insisted=self.format_name is not None)
        check_outputs(self.out, force=self.force)

    def config(self) -> LevelsConfig:
        """Return the configuration of the levels; refuse scales and shares that do not fit."""
        from cogsplat.codec.fit.train_config import LevelsConfig

        default_steps = _STEPS if self.points is None else _GROWING_STEPS
        try:
            return LevelsConfig(
                tuple(int(scale) for scale in self.scales.split(",")),
                tuple(
                    float(share.strip().removesuffix("%")) / 100 for share in self.shares.split(",")
                ),
                steps=default_steps if self.steps is None else self.steps,
                quality_db=self.quality,
                seed=self.seed,
                threads=self.threads,
            )
        except ValueError as error:
            raise click.UsageError(
                f"--scales {self.scales}, --shares {self.shares}: {error}"
            ) from error

    def read_splats(self) -> cogsplat.Splats:
        """Read the trained scene, or splats made from the points."""
        from cogsplat.codec.fit.initial_splats import splats_from_points

        if self.points is not None:
            found = read_points(self.points, limits=current_limits())
            read = splats_from_points(found.positions, found.colours)
        else:
            read = read_any(self.scene, threads=self.threads).splats
        splats = drop_invalid_splats(read, self.scene).without_extras()
        if not len(splats):
            raise DataError("empty-scene", f"{self.scene}: 0 splats, expected some to train")
        return splats


def _layers(options: LayersOptions) -> None:
    """Run the command."""
    from cogsplat.codec.fit.level_encoding import make_levels
    from cogsplat.codec.fit.train_config import LevelsRequest
    from cogsplat.codec.views.first_look_search import find_first_look

    options.require_consistent()
    config = options.config()
    images, threads = options.images, options.threads
    with Stages(shown=not (options.quiet or options.as_json)) as stages:
        with stages.stage("read"):
            splats = options.read_splats()
        path = options.cameras or (options.points and options.points.parent)
        if path is not None:
            views, tests = hold_out(load_cameras(path), options.eval_every)
            if not views:
                raise click.UsageError(f"--eval-every {options.eval_every} holds out all cameras")
        else:
            views, tests = plan_cameras(splats, threads=threads, progress=stages), []
        _require_pixels(views, max(config.scales))
        judged = tests or views
        photos = None if images is None else read_ground_truth(images, views)
        most = None if options.points is None else options.most or _MOST_SPLATS
        request = LevelsRequest(views, config, photos, most, planned=path is None)
        if images is None or options.points is None:
            full = _render_all(splats, judged, threads)
        else:
            full = read_ground_truth(images, judged)
        encoded = make_levels(splats, request, progress=stages)
        with stages.stage("write"):
            shown = encoded.prefix_splats(len(encoded.chunks))
            look = find_first_look(shown, None if path is None else views, threads=threads)
            description = None if options.points else notes_of(options.scene).description
            metadata = FileMetadata(look, description=description)
            size = metadata.save(encoded, options.out, force=options.force)
        found = _measure(options, splats, None if path is None else views, judged, full, stages)
    if options.as_json:
        print_json(
            {
                "output": display_name(options.out),
                "source": display_name(options.scene),
                "bytes": size,
                "splats": encoded.splats,
                "source_splats": len(splats),
                "test_views": {"from": "given" if tests else "trained in", "count": len(judged)},
                "levels": [level.report() for level in found],
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not options.quiet:
        _print_summary(options.out, size, found, len(judged), held_out=bool(tests))


def _measure(
    options: LayersOptions,
    splats: cogsplat.Splats,
    cameras: list[Camera] | None,
    tests: list[Camera],
    full: list[F32],
    stages: Stages,
) -> list[LevelQuality]:
    """Measure each level, and what an ordinary file of the scene shows in the same bytes.

    Parameters
    ----------
    options : LayersOptions
    splats : Splats
        Source scene; points have no ordinary file.
    cameras : list of Camera or None
        Training views, in which the ordinary file is scored; None plans views.
    tests : list of Camera
        Test views.
    full : list of (H, W, 3) float32
        Ground truth of each test view.
    stages : Stages
    """
    from cogsplat.tools.evaluation.level_figures import measure_levels

    measured = partial(
        measure_levels, options.out, tests, full, threads=options.threads, progress=stages
    )
    if options.points is not None:
        return measured()
    config = cogsplat.EncodeConfig(quality_db=options.quality, threads=options.threads)
    with scratch_folder() as folder:
        ordinary = folder / "ordinary.cogs"
        cogsplat.encode(splats, ordinary, cameras=cameras, config=config, progress=stages)
        found = measured(ordinary)
    beaten = [f"1/{level.sizes.scale:g}" for level in found if level.is_beaten]
    if beaten:
        warnings.warn(
            f"{options.out}: at {', '.join(beaten)} the beginning of a file of encode shows at "
            "least as much in the same bytes, expected less; use encode, or more --steps",
            CogsplatWarning,
            stacklevel=2,
        )
    return found


def _require_pixels(cameras: list[Camera], scale: int) -> None:
    """Refuse cameras whose reduced pictures are too small for SSIM."""
    for camera in cameras:
        if min(camera.width, camera.height) < scale * _LEAST_PIXELS:
            raise click.UsageError(
                f"--scales {scale}: camera {camera.name!r} has {camera.width}x{camera.height} "
                f"pixels, expected at least {scale * _LEAST_PIXELS} a side"
            )


def _render_all(splats: cogsplat.Splats, cameras: list[Camera], threads: int) -> list[F32]:
    """Return the renders of a scene at full size."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    config = RenderConfig(threads=threads)
    return [render(splats, camera, config) for camera in cameras]


def _print_summary(
    out: Path,
    size: int,
    found: list[LevelQuality],
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
            *(
                (f"{level.prefix.psnr_db:.2f}", f"{level.prefix_splats:,}")
                if level.prefix
                else ("-", "-")
            ),
        )
        for level in found
        for sizes, figures in [(level.sizes, level.figures)]
    ]
    heads = (
        "level", "splats", "left out", "fetched B", "opacities B", "PSNR", "worst", "SSIM",
        "encode", "its splats",
    )  # fmt: skip
    print_table(heads, rows, left=0)
