"""``cogsplat encode``: from a scene in any format to a COGS file."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

import cogsplat
from cogsplat.codec.order.chunk_plan import DEFAULT_CHUNK_SPLATS
from cogsplat.codec.partition.nested_cells import DEFAULT_CELL_SPLATS
from cogsplat.codec.streams.limits import MAX_CHUNK_SPLATS
from cogsplat.codec.threads import thread_count
from cogsplat.formats.storage.atomic import check_output
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.cluster.dask_executor import connected
from cogsplat.tools.evaluation.byte_inventory import stored_sizes
from cogsplat.tools.evaluation.prefix_quality import PrefixQuality
from cogsplat.tools.evaluation.report_page import write_report
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.option_groups import GroupedCommand
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    device_option,
    eval_every_option,
    force_option,
    jitter_option,
    json_option,
    preview_option,
    quality_option,
    quiet_option,
    scheduler_option,
    target_psnr_option,
    threads_option,
    top_k_option,
)
from cogsplat.tools.terminal.output import counted, facts, name_of, say, say_json, size_text
from cogsplat.tools.terminal.output_names import (
    COGS,
    HTML,
    check_distinct,
    check_name,
    format_option,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.scene_writing import no_extras_option
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, OutputPath
from cogsplat.tools.terminal.values import Colour, byte_count, number_of_bytes
from cogsplat.tools.workflow.byte_table import print_byte_table
from cogsplat.tools.workflow.compile_ahead import CompileAhead
from cogsplat.tools.workflow.file_evaluation import FileEvaluation, settings_of
from cogsplat.tools.workflow.inputs import (
    given_cameras,
    given_files,
    measured_in,
    read_any,
    scoring_cameras,
    virtual_views,
)
from cogsplat.tools.workflow.order_options import OrderChoice, order_options
from cogsplat.tools.workflow.scene_edits import SceneEdits, edit_options

if TYPE_CHECKING:
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.encoded import EncodeReport
    from cogsplat.formats.cogs.reader import CogsFile

# The choices and defaults below are those of `EncodeConfig` and `PruneConfig`, which take a
# compiler to import; a test compares them.


# In the order of the help. `--help` shows the first group, at most 16 options.
_GROUPS: Final = {
    "Most used": (
        "--cameras",
        "--quality",
        "--target-psnr",
        "--target-size",
        "--profile",
        "--preset",
        "--cells",
        "--preview",
        "--report",
        "--device",
        "--threads",
        "--config",
        "--force",
        "--json",
        "--help-all",
        "--help",
    ),
    "Order of the splats": (
        "--order",
        "--first-view",
        "--first-view-share",
        "--first-view-mix",
        "--frustum-share",
        "--frustum-margin",
        "--octree-depth",
        "--octree-capacity",
        "--seed",
        "--objects",
        "--object-budgets",
        "--masks",
    ),
    "Scoring": ("--no-jitter", "--top-k", "--eval-every"),
    "Contents of the file": (
        "--prune",
        "--no-prune",
        "--no-refine",
        "--no-compensation",
        "--no-extras",
        "--store-cameras",
        "--chunk-splats",
        "--no-view-table",
        "--no-morton",
    ),
    "Memory": ("--memory",),
    "Edits of the scene": (
        "--drop-invalid",
        "--sh",
        "--crop",
        "--scale",
        "--rotate",
        "--translate",
    ),
    "Measuring the file": ("--measure", "--images", "--background"),
}


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog="\b\nExample:\n"
    "  cogsplat encode scene.ply scene.cogs --cameras cameras.json --quality 38",
)
@click.argument("scene", type=INPUT)
@click.argument("out", type=OutputPath(".cogs"), metavar="OUT.cogs")
@cameras_option("Without it, views are planned around the scene.")
@click.option(
    "--profile",
    type=click.Choice(["transform", "vq", "near-lossless"]),
    default="transform",
    show_default=True,
    help="transform, vq: for viewing, by a shared transform or by codebooks. near-lossless: every "
    "attribute within a bound, for archives.",
)
@quality_option(
    "Nominal PSNR of the profiles for viewing. Without --cameras it is corrected to what is "
    "measured in planned test views, to about 1 dB."
)
@target_psnr_option(
    "Search for the quality that gives this mean PSNR in some of the views of --cameras or, "
    "without it, in test views planned around the scene. Other views may be harder or easier."
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
    help="fast scores one given view in three, at most 20, or plans fewer views, and orders only a "
    "tenth of the splats by gain, in small pictures; best plans most views, measures every one in "
    "full and takes longest.",
)
@order_options
@click.option(
    "--chunk-splats",
    type=click.IntRange(1, MAX_CHUNK_SPLATS),
    metavar="N",
    help="Most splats in a chunk.  "
    f"[default: {DEFAULT_CHUNK_SPLATS}, with --cells {DEFAULT_CELL_SPLATS}]",
)
@click.option(
    "--cells",
    is_flag=True,
    help="Cut chunks by space as well, finer from layer to layer, so that a client can fetch what "
    "it looks at.",
)
@click.option(
    "--no-view-table",
    is_flag=True,
    help="With --cells: store no table of what each chunk adds to the pictures of up to 64 "
    "viewpoints, from which a client knows what is behind walls.",
)
@click.option("--no-morton", is_flag=True, help="Keep the order inside chunks as well.")
@click.option("--no-refine", is_flag=True, help="Write heads fine at once, none coarse first.")
@click.option(
    "--no-compensation",
    is_flag=True,
    help="Store no prefix compensation; order for prefixes that are drawn without it.",
)
@preview_option
@click.option(
    "--prune",
    type=click.FloatRange(0, 1, max_open=True),
    show_default="0.06",
    metavar="PEAK",
    help="Drop splats that are not worth their bytes, of those whose weight stays below PEAK in "
    "every pixel of every view.",
)
@click.option("--no-prune", is_flag=True, help="Keep every splat.")
@no_extras_option
@click.option(
    "--store-cameras", is_flag=True, help="Store the cameras of --cameras in the file, all of them."
)
@jitter_option
@top_k_option(None)
@eval_every_option(0, "Keep from scoring, and measure in, the")
@click.option(
    "--measure",
    is_flag=True,
    help="Say how good the file is as its bytes arrive, and where they are.",
)
@click.option(
    "--report",
    type=PATH,
    metavar="OUT.html",
    help="Write what --measure finds, with plots and pictures, as one page.",
)
@click.option(
    "--images",
    type=PATH,
    metavar="DIR",
    help="Photos named as the cameras are: measure against them, too.",
)
@click.option(
    "--memory",
    type=number_of_bytes,
    metavar="SIZE",
    help="Most memory to take, such as 8GiB. A PLY that would take more is worked through in files "
    "beside OUT, but not by --profile vq. The bytes do not depend on it.",
)
@format_option(["cogs"], "Without it, a name that says another format is refused.")
@background_option
@edit_options
@partial_option
@limits_option
@device_option("Where views are scored.")
@threads_option
@scheduler_option
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
    choice: OrderChoice,
    chunk_splats: int | None,
    cells: bool,
    no_view_table: bool,
    no_morton: bool,
    no_refine: bool,
    no_compensation: bool,
    preview: float | None,
    prune: float | None,
    no_prune: bool,
    no_extras: bool,
    store_cameras: bool,
    no_jitter: bool,
    top_k: int | None,
    eval_every: int,
    measure: bool,
    report: Path | None,
    images: Path | None,
    memory: int | None,
    format_name: str | None,
    background: Colour,
    edits: SceneEdits,
    device: str,
    threads: int,
    scheduler: str | None,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Encode SCENE into a progressive COGS file.

    Splats are scored from the cameras, put in the order of what they contribute, pruned, cut into
    chunks and compressed. The bytes do not depend on the number of threads.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.needed_kernels import needed_kernels
    from cogsplat.codec.encode.presets import PRESETS
    from cogsplat.codec.encode.rate_control import Target
    from cogsplat.codec.encode.stage_costs import stage_costs
    from cogsplat.codec.rate.pruning import PruneConfig
    from cogsplat.formats.scenes.memory_cap import working_memory

    if prune is not None and no_prune:
        raise click.UsageError("--prune and --no-prune: expected one of them")
    if no_extras and choice.by_object:
        raise click.UsageError("--no-extras and --objects: expected one of them")
    if cells and chunk_splats == 1:
        raise click.UsageError("--cells with chunks of 1 splat, expected at least 2")
    if cells and choice.by_object:
        raise click.UsageError("--cells and --objects: expected one of them")
    if preview is not None:
        _require_preview_possible(
            {
                "--no-compensation": no_compensation,
                "--profile near-lossless": profile == "near-lossless",
                "--cells": cells,
                "--objects": choice.by_object,
                "--memory": memory is not None,
            }
        )
    if store_cameras and cameras is None:
        raise click.UsageError("--store-cameras without --cameras, expected cameras to store")
    _require_one_aim(profile, target_psnr, target_size)
    if scheduler is not None and memory is not None:
        raise click.UsageError("--memory and --scheduler: expected one of them")
    if scheduler is not None and device == "cuda":
        raise click.UsageError("--device cuda and --scheduler: expected one of them")
    if memory is not None and (measure or report is not None or images is not None):
        raise click.UsageError(
            "--memory with --measure, --report or --images, expected `cogsplat compare` "
            "afterwards: measuring holds two scenes in memory"
        )
    bound = PruneConfig() if prune is None else PruneConfig(peak=prune)
    chosen = PRESETS[preset]
    config = EncodeConfig(
        profile=profile,
        quality_db=quality,
        order=choice.base,
        chunk_splats=chunk_splats or (DEFAULT_CELL_SPLATS if cells else DEFAULT_CHUNK_SPLATS),
        cells=cells,
        view_table=not no_view_table,
        morton=not no_morton,
        refine=not no_refine,
        compensate=not no_compensation,
        prune=None if no_prune else bound,
        threads=threads,
    )
    check_name(out, COGS, insisted=format_name is not None)
    check_output(out, force=force, inputs=given_files(scene, cameras, images, choice.masks))
    if report is not None:
        check_name(report, HTML)
        check_distinct(out, report)
        inputs = given_files(scene, cameras, images, choice.masks)
        check_output(report, force=force, inputs=inputs)
    # Edits and labels by masks work on a copy in memory.
    copied = edits.changes or choice.masks is not None
    working = working_memory(scene, config, memory, out.absolute().parent, copied=copied)
    kernels = needed_kernels(config, planned=cameras is None)
    with (
        Stages(shown=not (quiet or as_json)) as stages,
        working as workspace,
        CompileAhead(kernels, thread_count(threads)) as ahead,
        ExitStack() as stack,
    ):
        with stages.stage("read"):
            views = scoring_cameras(cameras, eval_every)
            given = read_any(scene, threads=threads, zeros=workspace.zeros)
            labelled = choice.labelled(given.splats, cameras, threads=threads, progress=stages)
            splats = edits.apply(labelled, scene)
            if no_extras:
                splats = splats.without_extras()
            if views is not None:
                views = [edits.camera(view) for view in views]
            evaluation = None
            if len(splats) and (measure or report is not None or images is not None):
                evaluation = FileEvaluation.gather(
                    scene, splats, cameras, eval_every, edits, images, background, threads=threads
                )
        ahead.finish(stages)
        if choice.first_view is not None and cameras is None:
            views = virtual_views(splats, threads=threads, progress=stages)
        numbered = [edits.camera(view) for view in given_cameras(cameras)] if cameras else views
        config = replace(config, order=choice.name, ordering=choice.config(numbered or []))
        score_config = replace(
            chosen.score_config(profile, top_k=top_k, jitter=not no_jitter, threads=threads),
            device=device,
        )
        aimed = None if target_size is None else target_size.uncapped(given.file_bytes)
        if aimed == 0:
            raise click.UsageError("--target-size of 0 bytes, expected at least 1")
        target = None if target_psnr is None and aimed is None else Target(target_psnr, aimed)
        costs = stage_costs(
            len(splats), config, chosen, cameras=views, jitter=not no_jitter, target=target,
            preview=preview is not None,
        )  # fmt: skip
        if evaluation is not None:
            costs += evaluation.stage_costs()
        stages.plan(costs)
        executor = None
        if scheduler is not None:
            executor = stack.enter_context(connected(scheduler, workers=threads))
            stages("connect", 1, 1)
        made = cogsplat.encode(
            splats,
            out,
            cameras=views,
            config=config,
            score_config=score_config,
            target=target,
            preset=preset,
            preview=preview,
            stored_cameras=list(numbered or []) if store_cameras else [],
            test_views=measured_in(numbered, eval_every) if cameras and numbered else None,
            workspace=workspace,
            force=force,
            executor=executor,
            progress=stages,
        )
        stages("write", 1, 1)
        qualities: list[PrefixQuality] = []
        if evaluation is not None:
            settings = settings_of(
                click.get_current_context(), made.scored_views, stages.total_seconds
            )
            qualities = evaluation.measure(out, threads=threads, progress=stages)
            if report is not None:
                shown = evaluation.report_input(scene, given.file_bytes, out, qualities, settings)
                write_report(shown, report, force=force, progress=stages)
    if quiet and not as_json:
        return
    with cogsplat.open(out) as file:
        told = _report(file, made, config, stages)
        sizes = stored_sizes(file) if qualities else []
    size = made.size_bytes
    rows_in, kept = given.file_splats, int(file.root.splats)
    dropped, pruned = rows_in - len(splats), len(splats) - kept
    if as_json:
        say_json(
            {
                "output": name_of(out),
                "source": name_of(scene),
                **told,
                "prefixes": [quality.report() for quality in qualities],
                "attributes": [stored.report() for stored in sizes],
                "source_bytes": given.file_bytes,
                "ratio": round(given.file_bytes / size, 3),
                "source_splats": rows_in,
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
        ("predicted", _predicted(made)),
        ("scored", _scored(made)),
        ("time", stages.line()),
        ("report", str(report) if report else ""),
    )
    if evaluation is not None:
        print_byte_table(sizes, file)
        evaluation.tell(qualities)


def _require_preview_possible(others: dict[str, bool]) -> None:
    """Refuse options that a preview cannot be made with."""
    for option, given in others.items():
        if given:
            raise click.UsageError(f"--preview and {option}: expected one of them")


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
    if profile == "near-lossless" and named and named != ["--quality"]:
        raise click.UsageError(
            f"{named[0]} with --profile near-lossless, expected a profile for viewing"
        )


def _scored(made: EncodeReport) -> str:
    """Say how many views were scored, whose they are and how much of the scene they show."""
    if made.views == "none":
        return counted(made.scored_views, "view")
    shown = "of what is visible" if made.views == "planned" else "of the splats"
    return f"{counted(made.scored_views, 'view')} {made.views}, {made.coverage:.1%} {shown} covered"


def _predicted(made: EncodeReport) -> str:
    """Say what PSNR the encoder measured of the whole scene, and how much views differ."""
    values = made.test_psnr_db
    if not values:
        return ""
    mean = sum(values) / len(values)
    whose = "planned around the scene" if made.test_views == "planned" else "of those given"
    return f"{mean:.2f} dB, the mean of {len(values)} views {whose}; the worst {min(values):.2f} dB"


def _prediction(made: EncodeReport) -> dict[str, object]:
    """Return what `_scored` and `_predicted` say."""
    values = made.test_psnr_db
    return {
        "predicted_psnr_db": round(sum(values) / len(values), 3) if values else None,
        "predicted_worst_psnr_db": round(min(values), 3) if values else None,
        "test_views": {"from": made.test_views, "count": len(values)},
        "scored_views": made.scored_views,
        "scored_views_from": made.views,
        "coverage": None if made.views == "none" else round(made.coverage, 4),
    }


def _report(
    file: CogsFile, made: EncodeReport, config: EncodeConfig, stages: Stages
) -> dict[str, object]:
    """Return what the new file holds and how it came about."""
    splats = file.root.splats
    return {
        "bytes": made.size_bytes,
        "splats": splats,
        "bytes_per_splat": round(made.size_bytes / max(splats, 1), 3),
        "sh_degree": file.root.sh_degree,
        "chunks": file.num_chunks,
        "codebooks": [
            {"attribute": book.attribute, "rows": book.rows} for book in file.root.codebooks
        ],
        "profile": config.profile,
        **_prediction(made),
        "order": config.order,
        "quality_db": None if config.profile == "near-lossless" else round(made.quality_db, 3),
        "trials": made.trials,
        "seconds": stages.rounded(),
        "cpu_seconds": stages.cpu_rounded(),
    }
