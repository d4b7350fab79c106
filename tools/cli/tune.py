"""``cogsplat tune``: train and encode fewer splats that match the pictures of a scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import Target
from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import Progress
from cogsplat.formats.cogs.metadata import FileMetadata
from cogsplat.formats.storage.atomic import exists
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.photos import read_ground_truth
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.option_groups import GroupedCommand
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    device_option,
    eval_every_option,
    force_option,
    json_option,
    preview_option,
    quiet_option,
    shown_at_option,
    target_psnr_option,
    threads_option,
    training_images_option,
    training_seed_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.output_names import COGS, check_name, format_option
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, WRITTEN_PATH, OutputPath
from cogsplat.tools.terminal.values import Colour, FiniteNumber, byte_count
from cogsplat.tools.workflow.descriptions import notes_of
from cogsplat.tools.workflow.inputs import (
    LoadedScene,
    drop_invalid_splats,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.predicted_quality import predicted_facts, prediction_report
from cogsplat.tools.workflow.tune_checkpoint import (
    CHECKPOINT,
    fingerprint,
    read_checkpoint,
    write_checkpoint,
)

if TYPE_CHECKING:
    from cogsplat.codec.encode.encoded import EncodedScene
    from cogsplat.codec.fit.tune_config import TuneRequest
    from cogsplat.codec.fit.tuning import Milestone

# A week; far larger numbers overflow in seconds.
_MAX_MINUTES: Final = 10_080
# `TuneConfig.prefix_weight` with a preview, whose purpose is the quality of the first bytes.
_PREFIX_WEIGHT: Final = 0.5
# Share of --minutes that training has at least, however long reading takes.
_LEAST_TIME: Final = 0.1

_GROUPS: Final = {
    "Most used": (
        "--cameras",
        "--target-psnr",
        "--target-size",
        "--minutes",
        "--images",
        "--keep",
        "--preset",
        "--preview",
        "--checkpoint",
        "--resume",
        "--device",
        "--config",
        "--force",
        "--json",
        "--help-all",
        "--help",
    ),
    "Training": ("--shown-at", "--profile", "--seed", "--eval-every"),
    "More files": ("--ply",),
}


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog="\b\nExample:\n"
    "  cogsplat tune scene.ply scene.cogs --cameras cameras.json --target-size 2MB",
)
@click.argument("scene", type=INPUT, metavar="SCENE")
@click.argument("out", type=OutputPath(), metavar="OUT")
@cameras_option("Without it, views are planned around the scene.")
@target_psnr_option(
    "Remove splats down to this PSNR against renders of SCENE, in held-out views between those "
    "of --cameras. 40 without any target. If encoding SCENE untrained reaches it in fewer bytes, "
    "that encode is written."
)
@click.option(
    "--target-size",
    type=byte_count,
    metavar="SIZE",
    help="Reach the best PSNR in a file of this size: 2MB, 500KiB, 10% of SCENE.",
)
@click.option(
    "--minutes",
    type=FiniteNumber(0, _MAX_MINUTES, min_open=True),
    metavar="N",
    help="Time limit, minutes; at most 12 times the usual steps are trained. Without it, the "
    "number of steps is fixed and every run has the same result.",
)
@training_images_option
@click.option(
    "--keep",
    type=FiniteNumber(0, 1, min_open=True),
    metavar="SHARE",
    help="Share of the splats to keep. Without it, the fewest that reach the target.",
)
@click.option(
    "--profile",
    type=click.Choice(["transform", "vq"]),
    default="transform",
    show_default=True,
    help="Profile of OUT, as in encode. The codebooks of vq train with the splats.",
)
@click.option(
    "--preset",
    type=click.Choice(["fast", "balanced", "best"]),
    default="fast",
    show_default=True,
    help="Effort of scoring, as in encode. Order and compensation have that of best.",
)
@preview_option
@training_seed_option
@eval_every_option(0, "do not train in it.")
@shown_at_option
@click.option(
    "--ply",
    type=WRITTEN_PATH,
    metavar="OUT.ply",
    help="Also write the trained splats before quantisation.",
)
@click.option(
    "--checkpoint",
    type=WRITTEN_PATH,
    metavar="FILE",
    help="Write a checkpoint for --resume to this file after every round.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Resume from --checkpoint if the file exists, with the steps planned when it was written, "
    "also with --minutes. Every run from one checkpoint has the same result.",
)
@format_option(["cogs"], "Without it, a name with the extension of another format is refused.")
@background_option
@partial_option
@limits_option
@device_option("Device that renders and differentiates pictures.")
@threads_option
@force_option
@quiet_option
@json_option
def tune(**options: Any) -> None:
    """Train fewer splats to match the pictures of SCENE.

    Each round removes the splats that change the pictures least and trains the others to
    compensate. Then the remaining splats train through the encoder's quantisers. The reduction in
    size depends on the scene and its cameras.
    """
    _tune(TuneOptions(**options))


@dataclass(frozen=True)
class TuneOptions:
    """Values of the options of ``tune``."""

    scene: Path
    out: Path
    cameras: Path | None
    target_psnr: float | None
    target_size: ByteCount | None
    minutes: float | None
    images: Path | None
    keep: float | None
    profile: str
    preset: str
    preview: float | None
    seed: int
    eval_every: int
    shown_at: int | None
    ply: Path | None
    checkpoint: Path | None
    resume: bool
    format_name: str | None
    background: Colour
    device: str
    threads: int
    force: bool
    quiet: bool
    as_json: bool

    def require_consistent(self) -> None:
        """Refuse contradictory options and unwritable outputs."""
        if self.target_psnr is not None and self.target_size is not None:
            raise click.UsageError("--target-psnr and --target-size: expected one of them")
        if self.images is not None and self.cameras is None:
            raise click.UsageError("--images without --cameras, expected the cameras of the photos")
        if self.images is not None and self.shown_at is not None:
            raise click.UsageError(
                "--images and --shown-at: expected photos in the size of --cameras"
            )
        if self.resume and self.checkpoint is None:
            raise click.UsageError(
                "--resume without --checkpoint, expected the file to resume from"
            )
        check_name(self.out, COGS, insisted=self.format_name is not None)
        kinds = {} if self.checkpoint is None else {self.checkpoint: CHECKPOINT}
        check_outputs(self.out, self.ply, force=self.force, auxiliary=kinds)

    def request(
        self,
        splats: cogsplat.Splats,
        given: Sequence[Camera] | None,
        file_bytes: int,
        progress: Progress,
    ) -> TuneRequest:
        """Return the request: views, target, configuration and photos.

        Parameters
        ----------
        splats : Splats
            Scene to tune.
        given : sequence of Camera or None
            Cameras to train in; None plans views.
        file_bytes : int
            Size of the scene's file, for a target size in per cent.
        progress : Progress
            Receives the stage of planning.
        """
        from cogsplat.codec.fit.train_config import TrainConfig
        from cogsplat.codec.fit.tune_config import DEFAULT_TARGET, TuneConfig, TuneRequest
        from cogsplat.codec.fit.tuning_views import choose_tuning_views

        target = DEFAULT_TARGET
        if self.target_psnr is not None:
            target = Target(psnr_db=self.target_psnr)
        elif self.target_size is not None:
            size_bytes = self.target_size.uncapped(file_bytes)
            if size_bytes < 1:
                raise click.UsageError("--target-size of 0 bytes, expected at least 1")
            target = Target(size_bytes=size_bytes)
        views = choose_tuning_views(
            splats, given, shown_at=self.shown_at, threads=self.threads, progress=progress
        )
        photos = None
        if self.images is not None:
            photos = read_ground_truth(self.images, views.cameras)
        config = TuneConfig(
            keep=self.keep,
            seconds=None if self.minutes is None else 60 * self.minutes,
            preset=self.preset,
            profile=self.profile,
            preview=self.preview,
            prefix_weight=0.0 if self.preview is None else _PREFIX_WEIGHT,
            train=TrainConfig(seed=self.seed, threads=self.threads),
        )
        return TuneRequest(views, target, config, photos, self.background, self.device)


def _tune(options: TuneOptions) -> None:
    """Run the command."""
    from cogsplat.codec.fit import tuning
    from cogsplat.codec.views.first_look_search import find_first_look

    options.require_consistent()
    shown = not (options.quiet or options.as_json)
    begin = time.monotonic()
    with Stages(shown=shown) as stages:
        with stages.stage("read"):
            cameras = scoring_cameras(options.cameras, options.eval_every)
            given = read_any(options.scene, threads=options.threads)
            splats = drop_invalid_splats(given.splats, options.scene).without_extras()
            if not len(splats):
                raise DataError("empty-scene", f"{options.scene}: 0 splats, expected some to train")
        request = options.request(splats, cameras, given.file_bytes, stages)
        names = [f"{view.name} {view.width}x{view.height}" for view in request.views.cameras]
        run = fingerprint(splats, f"{request.target} {request.config} {names}")
        if (seconds := request.config.seconds) is not None:
            # The time spent until here counts as well.
            left = max(seconds - (time.monotonic() - begin), _LEAST_TIME * seconds)
            request = replace(request, config=replace(request.config, seconds=left))
        state, save_state = None, None
        if options.checkpoint is not None:
            if options.resume and exists(options.checkpoint):
                state = read_checkpoint(options.checkpoint, run)
            save_state = partial(write_checkpoint, options.checkpoint, run)
        threads = request.config.train.threads
        look = find_first_look(splats, cameras, threads=threads)
        metadata = FileMetadata(look, description=notes_of(options.scene).description)
        made = tuning.tune(
            splats,
            request,
            size_of=metadata.file_bytes,
            resume=state,
            checkpoint=save_state,
            notify=_print_milestone if shown else None,
            progress=stages,
        )
        with stages.stage("write"):
            size = metadata.save(made.encoded, options.out, force=options.force)
            if options.ply is not None:
                cogsplat.write(made.splats, options.ply, force=options.force, format_name="ply")
    _print_summary(options, given, made.encoded, size, stages)


def _print_milestone(milestone: Milestone) -> None:
    """Print a milestone of tuning to standard error."""
    size = f", {size_text(milestone.size_bytes)}" if milestone.size_bytes else ""
    click.echo(
        f"{milestone.stage}: {milestone.splats:,} splats, {milestone.psnr_db:.2f} dB, the worst "
        f"view {milestone.worst_db:.2f} dB{size}",
        err=True,
    )


def _print_summary(
    options: TuneOptions,
    given: LoadedScene,
    made: EncodedScene,
    size: int,
    stages: Stages,
) -> None:
    """Print the summary of the new file, or its JSON object."""
    ratio = given.file_bytes / size
    if options.as_json:
        print_json(
            {
                "output": display_name(options.out),
                "source": display_name(options.scene),
                "bytes": size,
                "splats": made.splats,
                "bytes_per_splat": round(size / max(made.splats, 1), 3),
                "source_bytes": given.file_bytes,
                "source_splats": given.file_splats,
                "ratio": round(ratio, 3),
                **prediction_report(made.report),
                "seconds": stages.rounded_seconds(),
                "cpu_seconds": stages.rounded_cpu_seconds(),
            }
        )
    elif not options.quiet:
        print_line(
            f"{options.out}: {size_text(size)}, {ratio:.1f} times smaller than {options.scene}"
        )
        print_facts(
            (
                "splats",
                f"{made.splats:,} of {given.file_splats:,}, {size / made.splats:.2f} B each",
            ),
            *predicted_facts(made.report),
            ("time", stages.summary()),
        )
