"""``cogsplat encode``: from a scene to a COGS file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.chunking import DEFAULT_LARGEST, MAX_CHUNK_SPLATS
from cogsplat.codec.splats import Splats
from cogsplat.formats.atomic import refuse_existing

from . import report as reports
from .bench_photos import Photos, read_photos
from .cli_inputs import judged_in, judging_cameras, read_any, scoring_cameras
from .cli_options import (
    PATH,
    background_option,
    cameras_option,
    eval_every_option,
    force_option,
    jitter_option,
    json_option,
    quiet_option,
    threads_option,
    top_k_option,
)
from .cli_output import counted, facts, name_of, say, say_json, size_text, table
from .cli_progress import Stages
from .cli_values import ByteCount, Colour, byte_count
from .quality import PrefixQuality, measure
from .scene_edits import SceneEdits, edit_options

if TYPE_CHECKING:
    from cogsplat.codec.encoder import EncodeConfig
    from cogsplat.codec.target import Target
    from cogsplat.formats.cogs_reader import CogsFile

# The choices and defaults below are those of `EncodeConfig` and `PruneConfig`, which take a
# compiler to import; a test compares them.


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat encode scene.ply scene.cogs --cameras cameras.json --quality 38"
)
@click.argument("scene", type=PATH)
@click.argument("out", type=PATH, metavar="OUT.cogs")
@cameras_option("Without it, views are made up around the scene.")
@click.option(
    "--profile",
    type=click.Choice(["transform", "vq", "near"]),
    default="transform",
    show_default=True,
    help="transform, vq: for viewing, by a shared transform or by codebooks. near: every attribute "
    "within a bound, for archives.",
)
@click.option(
    "--quality",
    type=click.FloatRange(10, 90),
    default=36.0,
    show_default=True,
    metavar="DB",
    help="Nominal PSNR of the profiles for viewing.",
)
@click.option(
    "--target-psnr",
    type=click.FloatRange(5, 90),
    metavar="DB",
    help="Search for the quality that gives this PSNR in the views given.",
)
@click.option(
    "--target-size",
    type=byte_count,
    metavar="SIZE",
    help="Search for the best quality in a file of this size: 12MB, 500KiB, 20% of SCENE.",
)
@click.option(
    "--preset",
    type=click.Choice(["fast", "balanced", "best"]),
    default="balanced",
    show_default=True,
    help="fast scores one view in three; best measures every view in full and takes longest.",
)
@click.option(
    "--order",
    type=click.Choice(["contribution", "source"]),
    default="contribution",
    show_default=True,
    help="Which splats come first.",
)
@click.option(
    "--chunk-splats",
    type=click.IntRange(1, MAX_CHUNK_SPLATS),
    default=DEFAULT_LARGEST,
    show_default=True,
    metavar="N",
    help="Most splats in a chunk.",
)
@click.option("--no-morton", is_flag=True, help="Keep the order inside chunks as well.")
@click.option(
    "--prune",
    type=click.FloatRange(0, 1, max_open=True),
    show_default="0.02",
    metavar="PEAK",
    help="Drop splats whose weight stays below PEAK in every pixel of every view.",
)
@click.option("--no-prune", is_flag=True, help="Keep every splat.")
@jitter_option
@top_k_option
@eval_every_option(0, "Keep from scoring, and judge by, the")
@click.option(
    "--report",
    type=PATH,
    metavar="OUT.html",
    help="Write a report with plots and pictures, one file that needs nothing else.",
)
@click.option(
    "--images",
    type=PATH,
    metavar="DIR",
    help="Photos named as the cameras are: measure against them as well.",
)
@background_option
@edit_options
@threads_option
@force_option
@quiet_option
@json_option
def encode(
    scene: Path,
    out: Path,
    cameras: Path | None,
    profile: str,
    quality: float,
    target_psnr: float | None,
    target_size: ByteCount | None,
    preset: str,
    order: str,
    chunk_splats: int,
    no_morton: bool,
    prune: float | None,
    no_prune: bool,
    no_jitter: bool,
    top_k: int,
    eval_every: int,
    report: Path | None,
    images: Path | None,
    background: Colour,
    edits: SceneEdits,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Encode SCENE into a progressive COGS file.

    Splats are scored from the cameras, put in the order of what they contribute, pruned, cut into
    chunks and compressed. The bytes do not depend on the number of threads.
    """
    from cogsplat.codec.encoder import EncodeConfig
    from cogsplat.codec.preset import PRESETS
    from cogsplat.codec.prune import PruneConfig

    if prune is not None and no_prune:
        raise click.UsageError("--prune and --no-prune: expected one of them")
    _require_one_aim(profile, target_psnr, target_size)
    bound = PruneConfig() if prune is None else PruneConfig(peak=prune)
    config = EncodeConfig(
        profile=profile,
        quality_db=quality,
        order=order,
        chunk_splats=chunk_splats,
        morton=not no_morton,
        prune=None if no_prune else bound,
        threads=threads,
    )
    if images is not None and report is None and not eval_every:
        raise click.UsageError("--images without --report or --eval-every: nothing to measure")
    refuse_existing(out, force=force)
    if report is not None:
        refuse_existing(report, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, eval_every)
            given = read_any(scene, threads=threads)
            splats = edits.apply(given.splats, scene)
            if views is not None:
                views = [edits.camera(view) for view in views]
        size = cogsplat.encode(
            splats,
            out,
            cameras=views,
            config=config,
            score_config=PRESETS[preset].score_config(
                profile, top_k=top_k, jitter=not no_jitter, threads=threads
            ),
            target=_target(target_psnr, target_size, given.file_bytes),
            preset=preset,
            measured_on=None if views is None or eval_every else judged_in(views),
            force=force,
            progress=stages,
        )
        stages("write", 1, 1)
        seconds = stages.total_seconds
        judged: list[PrefixQuality] = []
        if len(splats) and (report is not None or eval_every):
            judging, judged_by = _judging(scene, splats, cameras, eval_every, edits)
            photos = None
            if images is not None:
                photos = read_photos(images, splats, judging, background, threads=threads)
            judged = measure(
                out,
                splats,
                judging,
                background=background,
                photos=photos,
                threads=threads,
                progress=stages,
            )
            if report is not None:
                subject = reports.Subject(
                    scene,
                    given.file_bytes,
                    splats,
                    out,
                    judging,
                    judged_by,
                    background,
                    photos,
                    judged,
                    _settings(click.get_current_context(), stages.totals.get("score", 0), seconds),
                    threads,
                )
                reports.write_report(report, subject, force=force, progress=stages)
    if quiet and not as_json:
        return
    with cogsplat.open(out) as file:
        told = _report(file, size, config, stages)
        seen = _predicted(file)
    rows_in, kept = given.file_splats, int(file.root.splats)
    dropped, pruned = rows_in - len(splats), len(splats) - kept
    if as_json:
        say_json(
            {
                "output": name_of(out),
                **told,
                "quality": [quality.report() for quality in judged],
                "source_bytes": given.file_bytes,
                "ratio": round(given.file_bytes / size, 3),
                "splats_in": rows_in,
                "splats_dropped": dropped,
                "splats_pruned": pruned,
            }
        )
        return
    say(f"{out}: {size_text(size)}, {given.file_bytes / size:.1f} times smaller than {scene}")
    gone = f"{pruned:,} pruned" + (f", {dropped:,} left out" if dropped else "")
    books = [f"{book.attribute} {book.rows:,}" for book in file.root.codebooks]
    facts(
        ("splats", f"{kept:,} of {rows_in:,} ({gone}), {size / max(kept, 1):.2f} B each"),
        ("chunks", f"{file.num_chunks}, SH degree {file.root.sh_degree}"),
        ("codebooks", f"{', '.join(books)} rows" if books else ""),
        ("predicted", f"{seen:.2f} dB in views given to the encoder" if seen else ""),
        ("scored", counted(stages.totals.get("score", 0), "view") + _with_copies(no_jitter)),
        ("time", stages.line()),
        ("report", str(report) if report else ""),
    )
    if judged:
        say("")
        _tell_quality(judged, photos)


def _judging(
    scene: Path, splats: Splats, cameras: Path | None, eval_every: int, edits: SceneEdits
) -> tuple[list[Camera], str]:
    """Return the cameras to judge a new file by, and what they are."""
    views, what = judging_cameras(scene, splats, cameras, eval_every)
    if cameras is None and what == "virtual views":
        return list(views), what
    if cameras is not None:
        what += " never given to the encoder" if eval_every else ", all given to the encoder"
    return [edits.camera(view) for view in views], what


def _settings(context: click.Context, views: int, seconds: float) -> list[tuple[str, str]]:
    """Return the options that shaped the file, and what they led to."""
    shown = (
        "profile", "quality", "target_psnr", "target_size", "preset", "order", "chunk_splats",
        "no_morton", "prune", "no_prune", "no_jitter", "top_k", "eval_every", "background",
    )  # fmt: skip
    settings = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if option.name in shown and value is not None and value is not False:
            text = context.get_parameter_source(option.name or "")
            default = text is click.core.ParameterSource.DEFAULT
            settings.append((option.opts[0], f"{_plain(value)}{' (default)' if default else ''}"))
    return [*settings, ("views scored", str(views)), ("seconds", f"{seconds:.1f}")]


def _plain(value: object) -> str:
    if isinstance(value, ByteCount):
        return f"{value.amount * 100}%" if value.is_share else f"{int(value.amount):,} bytes"
    if isinstance(value, tuple):
        return ", ".join(f"{part:g}" for part in value)
    return "yes" if value is True else str(value)


def _tell_quality(judged: Sequence[PrefixQuality], photos: Photos | None) -> None:
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
        ]
        + ([] if q.photos_db is None else [f"{q.photos_db:.2f}"])
        for q in judged
    ]
    table([*columns, *(["photos"] if photos else [])], rows, left=0)
    lost = judged[-1].photos_db
    if photos and lost is not None:
        say("")
        facts(("photos", f"source {photos.source_db:.2f} dB, {photos.source_db - lost:.2f} lost"))


def _require_one_aim(
    profile: str, target_psnr: float | None, target_size: ByteCount | None
) -> None:
    aims = {"--target-psnr": target_psnr, "--target-size": target_size}
    named = [option for option, value in aims.items() if value is not None]
    context = click.get_current_context()
    if context.get_parameter_source("quality") is click.core.ParameterSource.COMMANDLINE:
        named.append("--quality")
    if len(named) > 1:
        raise click.UsageError(f"{' and '.join(named)}: expected one of them")
    if profile == "near" and named and named != ["--quality"]:
        raise click.UsageError(f"{named[0]} with --profile near, expected a profile for viewing")


def _target(
    target_psnr: float | None, target_size: ByteCount | None, file_bytes: int
) -> Target | None:
    from cogsplat.codec.target import Target

    if target_psnr is not None:
        return Target(psnr_db=target_psnr)
    if target_size is None:
        return None
    wanted = target_size.of(file_bytes) if target_size.is_share else int(target_size.amount)
    if wanted < 1:
        raise click.UsageError("--target-size of 0 bytes, expected at least 1")
    return Target(size_bytes=wanted)


def _with_copies(no_jitter: bool) -> str:
    return "" if no_jitter else ", jittered copies included"


def _predicted(file: CogsFile) -> float | None:
    """Return the PSNR that the encoder saw of the whole scene, dB."""
    if not len(file.chunks.quality) or not file.chunks.quality[-1]:
        return None
    return round(float(file.chunks.quality[-1]), 3)


def _report(file: CogsFile, size: int, config: EncodeConfig, stages: Stages) -> dict[str, object]:
    """Return what the new file holds and how it came about."""
    splats = file.root.splats
    return {
        "bytes": size,
        "splats": splats,
        "bytes_per_splat": round(size / max(splats, 1), 3),
        "sh_degree": file.root.sh_degree,
        "chunks": file.num_chunks,
        "codebooks": [
            {"attribute": book.attribute, "rows": book.rows} for book in file.root.codebooks
        ],
        "profile": config.profile,
        "predicted_psnr_db": _predicted(file),
        "order": config.order,
        "scored_views": stages.totals.get("score", 0),
        "seconds": stages.rounded(),
    }
