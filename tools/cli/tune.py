"""``cogsplat tune``: train and encode fewer splats that match the pictures of a scene."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np

import cogsplat
from cogsplat.codec.errors import DataError
from cogsplat.formats.cogs.metadata import FileMetadata
from cogsplat.formats.storage.atomic import check_output
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.photos import read_photos
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
from cogsplat.tools.terminal.output_names import COGS, check_distinct, check_name, format_option
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, OutputPath
from cogsplat.tools.terminal.values import Colour, FiniteNumber, byte_count
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    input_files,
    load_cameras,
    read_any,
    scoring_cameras,
    target_cameras,
)
from cogsplat.tools.workflow.tune_checkpoint import fingerprint, read_checkpoint, write_checkpoint

if TYPE_CHECKING:
    from cogsplat.codec.encode.config import Target
    from cogsplat.codec.encode.encoded import EncodedScene
    from cogsplat.codec.fit.tuning import CheckpointArrays, Milestone

_DEFAULT_DB: Final = 40.0
# A week; far larger numbers overflow in seconds.
_MAX_MINUTES: Final = 10_080
# `TuneConfig.prefix_weight` with a preview, whose purpose is the quality of the first bytes.
_PREFIX_WEIGHT: Final = 0.5

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
    "Training": ("--profile", "--seed", "--eval-every"),
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
    help="Effort of scoring and ordering, as in encode. balanced and best raise the PSNR of the "
    "first bytes.",
)
@preview_option
@training_seed_option
@eval_every_option(0, "do not train in it.")
@click.option(
    "--ply",
    type=PATH,
    metavar="OUT.ply",
    help="Also write the trained splats before quantisation.",
)
@click.option(
    "--checkpoint",
    type=PATH,
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
def tune(
    scene: Path,
    out: Path,
    cameras: Path | None,
    target_psnr: float | None,
    target_size: ByteCount | None,
    minutes: float | None,
    images: Path | None,
    keep: float | None,
    profile: str,
    preset: str,
    preview: float | None,
    seed: int,
    eval_every: int,
    ply: Path | None,
    checkpoint: Path | None,
    resume: bool,
    format_name: str | None,
    background: Colour,
    device: str,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Train fewer splats to match the pictures of SCENE.

    Each round removes the splats that change the pictures least and trains the others to
    compensate. Then the remaining splats train through the encoder's quantisers. The reduction in
    size depends on the scene and its cameras.
    """
    from cogsplat.codec.fit.preview_training import PreviewConfig, TrainedPreview
    from cogsplat.codec.fit.train_config import TrainConfig
    from cogsplat.codec.fit.training_views import make_training_views
    from cogsplat.codec.fit.tune_config import TuneConfig
    from cogsplat.codec.fit.tuning import tune as tuned_scene
    from cogsplat.codec.fit.tuning_views import choose_tuning_views

    if target_psnr is not None and target_size is not None:
        raise click.UsageError("--target-psnr and --target-size: expected one of them")
    if images is not None and cameras is None:
        raise click.UsageError("--images without --cameras, expected the cameras of the photos")
    if resume and checkpoint is None:
        raise click.UsageError("--resume without --checkpoint, expected the file to resume from")
    check_name(out, COGS, insisted=format_name is not None)
    inputs = list(input_files(scene, cameras, images))
    check_output(out, force=force, inputs=inputs)
    for other in (ply, checkpoint):
        if other is not None:
            check_distinct(out, other)
            check_output(other, force=force or other == checkpoint, inputs=inputs)
    shown = not (quiet or as_json)
    begin = time.monotonic()
    with Stages(shown=shown) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, eval_every)
            given = read_any(scene, threads=threads)
            splats = drop_invalid_splats(given.splats, scene).without_extras()
            if not len(splats):
                raise DataError("empty-scene", f"{scene}: 0 splats, expected some to train")
        chosen = choose_tuning_views(
            splats,
            views,
            test_views=target_cameras(load_cameras(cameras), eval_every) if cameras else (),
            threads=threads,
            progress=stages,
        )
        photos = None
        if images is not None:
            taken = read_photos(images, splats, chosen.cameras, background, threads=threads)
            photos = [pixels.astype(np.float32) / np.float32(255) for pixels in taken.pictures]
        training_views = make_training_views(
            splats,
            chosen.cameras,
            photos=photos,
            covering=chosen.covering,
            held_out=chosen.held_out,
            background=background,
            threads=threads,
            device=device,
            progress=stages,
        )
        target = _target(target_psnr, target_size, given.file_bytes)
        config = TuneConfig(
            keep=keep,
            seconds=None if minutes is None else 60 * minutes,
            preset=preset,
            profile=profile,
            prefix_weight=0.0 if preview is None else _PREFIX_WEIGHT,
            # The worst photos may have errors of their own, so they get no extra weight.
            train=TrainConfig(worst_views=0.0 if photos else 1.0, seed=seed, threads=threads),
        )
        metadata = FileMetadata(None if chosen.planned else chosen.cameras[0])
        first = None
        if preview is not None:
            first = TrainedPreview(PreviewConfig(share=preview, seed=seed, threads=threads))
        run = fingerprint(
            splats, f"{target} {config} {preview} {[view.name for view in chosen.cameras]}"
        )
        if minutes is not None:
            # The time spent until here counts as well.
            left = 60 * minutes - (time.monotonic() - begin)
            config = replace(config, seconds=max(left, 0.1 * 60 * minutes))
        state = None
        if checkpoint is not None and resume and checkpoint.exists():
            state = read_checkpoint(checkpoint, run)

        def save_state(state: CheckpointArrays) -> None:
            if checkpoint is not None:
                write_checkpoint(checkpoint, run, state)

        made = tuned_scene(
            splats,
            training_views,
            chosen.cameras,
            target,
            config,
            test_views=chosen.test_views,
            covering=chosen.covering,
            size_of=metadata.file_bytes,
            preview=first,
            resume=state,
            checkpoint=None if checkpoint is None else save_state,
            notify=_print_milestone if shown else None,
            progress=stages,
        )
        with stages.stage("write"):
            size = metadata.save(made.encoded, out, force=force)
            if ply is not None:
                cogsplat.write(made.splats, ply, force=force, format_name="ply")
    _print_summary(
        made.encoded, scene, out, size, given.file_bytes, given.file_splats, chosen.planned, stages,
        quiet=quiet, as_json=as_json,
    )  # fmt: skip


def _target(psnr_db: float | None, size: ByteCount | None, file_bytes: int) -> Target:
    """Return the target: a size, or a PSNR, 40 dB by default."""
    from cogsplat.codec.encode.config import Target

    if size is None:
        return Target(psnr_db=_DEFAULT_DB if psnr_db is None else psnr_db)
    wanted = size.uncapped(file_bytes)
    if wanted < 1:
        raise click.UsageError("--target-size of 0 bytes, expected at least 1")
    return Target(size_bytes=wanted)


def _print_milestone(milestone: Milestone) -> None:
    """Print a milestone of tuning to standard error."""
    size = f", {size_text(milestone.size_bytes)}" if milestone.size_bytes else ""
    click.echo(
        f"{milestone.stage}: {milestone.splats:,} splats, {milestone.psnr_db:.2f} dB, the worst "
        f"view {milestone.worst_db:.2f} dB{size}",
        err=True,
    )


def _print_summary(
    made: EncodedScene,
    scene: Path,
    out: Path,
    size: int,
    source_bytes: int,
    source_splats: int,
    planned: bool,
    stages: Stages,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    """Print the summary of the new file, or its JSON object."""
    values = made.report.test_psnr_db
    mean = sum(values) / len(values)
    whose = "planned" if planned else "given"
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "source": display_name(scene),
                "bytes": size,
                "splats": made.splats,
                "bytes_per_splat": round(size / max(made.splats, 1), 3),
                "source_bytes": source_bytes,
                "source_splats": source_splats,
                "ratio": round(source_bytes / size, 3),
                "predicted_psnr_db": round(mean, 3),
                "predicted_worst_psnr_db": round(min(values), 3),
                "test_views": {"from": whose, "count": len(values)},
                "seconds": stages.rounded_seconds(),
                "cpu_seconds": stages.rounded_cpu_seconds(),
            }
        )
    elif not quiet:
        print_line(
            f"{out}: {size_text(size)}, {source_bytes / size:.1f} times smaller than {scene}"
        )
        print_facts(
            ("splats", f"{made.splats:,} of {source_splats:,}, {size / made.splats:.2f} B each"),
            (
                "measured",
                f"{mean:.2f} dB, the mean of {len(values)} views {whose}; the worst "
                f"{min(values):.2f} dB",
            ),
            ("time", stages.summary()),
        )
