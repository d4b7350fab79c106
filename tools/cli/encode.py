"""``cogsplat encode``: from a scene in any format to a COGS file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import click

import cogsplat
from cogsplat.codec.encode.config import PROFILE_NAMES, EncodeConfig
from cogsplat.codec.encode.needed_kernels import needed_kernels
from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.order.chunk_plan import DEFAULT_CHUNK_SPLATS
from cogsplat.codec.partition.nested_cells import DEFAULT_CELL_SPLATS
from cogsplat.codec.progress import Progress
from cogsplat.codec.rate.pruning import PEAK, SPARSE_PEAK
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS
from cogsplat.codec.threads import thread_count
from cogsplat.formats.cogs.description import Description
from cogsplat.formats.cogs.description_json import read_description
from cogsplat.formats.scenes.memory_cap import working_memory
from cogsplat.tools.cluster.dask_executor import connected
from cogsplat.tools.evaluation.byte_inventory import stored_sizes
from cogsplat.tools.evaluation.prefix_quality import PrefixQuality
from cogsplat.tools.evaluation.report_page import write_report
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
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
    shown_at_option,
    target_psnr_option,
    threads_option,
    top_k_option,
    trained_at_option,
    up_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.output_names import (
    format_option,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import no_extras_option
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, WRITTEN_PATH, OutputPath
from cogsplat.tools.terminal.values import FiniteNumber, byte_count, number_of_bytes
from cogsplat.tools.workflow.byte_table import print_byte_table
from cogsplat.tools.workflow.compile_ahead import CompileAhead
from cogsplat.tools.workflow.descriptions import SceneNotes, notes_of
from cogsplat.tools.workflow.file_evaluation import FileEvaluation, settings_of
from cogsplat.tools.workflow.inputs import (
    LoadedScene,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.order_options import order_options
from cogsplat.tools.workflow.predicted_quality import predicted_facts, prediction_report
from cogsplat.tools.workflow.scene_edits import edit_options

from .encode_options import EncodeOptions

if TYPE_CHECKING:
    from cogsplat.codec.encode.encoded import EncodeReport
    from cogsplat.formats.cogs.reader import CogsFile

_DEFAULTS: Final = EncodeConfig()

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
    "Scoring": ("--shown-at", "--no-jitter", "--top-k", "--eval-every"),
    "First view and drawing": ("--view", "--up", "--trained-at"),
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
        "--basis-of",
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
    type=click.Choice(PROFILE_NAMES),
    default=_DEFAULTS.profile,
    show_default=True,
    help="transform, vq: for viewing; vq is transform with codebooks of shapes and view-dependent "
    "colour. near-lossless: for archives, every attribute within an error bound.",
)
@quality_option(
    "Nominal PSNR of the profiles for viewing. Without --cameras it is corrected to what is "
    "measured in planned test views, to about 1 dB."
)
@target_psnr_option(
    "Search for the quality with this mean PSNR in some views of --cameras or, "
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
    type=click.Choice(list(PRESETS)),
    default=DEFAULT_PRESET,
    show_default=True,
    help="Effort. fast scores one given view in three, at most 20, or plans fewer views, and "
    "orders a tenth of the splats by gain in small pictures. best plans most views and measures "
    "each in full.",
)
@order_options
@click.option(
    "--chunk-splats",
    type=click.IntRange(1, MAX_CHUNK_SPLATS),
    metavar="N",
    help="Splats in a chunk at most.  "
    f"[default: {DEFAULT_CHUNK_SPLATS}, with --cells {DEFAULT_CELL_SPLATS}]",
)
@click.option(
    "--cells",
    is_flag=True,
    help="Also cut chunks by cells of space, smaller in later layers, so that a client can fetch "
    "the cells in view.",
)
@click.option(
    "--no-view-table",
    is_flag=True,
    help="With --cells: store no view table. It holds the share of each chunk in what is seen "
    "all around up to 32 viewpoints, which shows clients what walls hide.",
)
@click.option(
    "--no-morton",
    is_flag=True,
    help="Store the splats of a chunk in the chosen order, not in Morton order.",
)
@click.option(
    "--no-refine", is_flag=True, help="Write full precision into heads, without refinements."
)
@click.option(
    "--no-compensation",
    is_flag=True,
    help="Store no prefix compensation, and order for prefixes without it.",
)
@preview_option
@click.option(
    "--prune",
    type=FiniteNumber(0, 1, max_open=True),
    show_default=f"{PEAK}, or {SPARSE_PEAK} where cameras overlap too little",
    metavar="PEAK",
    help="Drop splats that are not worth their bytes, among those whose weight is below PEAK in "
    "every pixel of every view.",
)
@click.option("--no-prune", is_flag=True, help="Keep every splat.")
@no_extras_option
@up_option
@trained_at_option
@shown_at_option
@click.option(
    "--describe",
    type=PATH,
    metavar="FILE.json",
    help="Store the description of a JSON file: title, licence, views, poster and more. Without "
    "it, that of SCENE. `cogsplat describe` changes it later.",
)
@click.option("--store-cameras", is_flag=True, help="Store all cameras of --cameras in the file.")
@jitter_option
@top_k_option(None)
@eval_every_option(0, "do not score in it, measure in it.")
@click.option(
    "--measure",
    is_flag=True,
    help="Print PSNR and SSIM of prefixes of the file, and bytes by attribute.",
)
@click.option(
    "--report",
    type=WRITTEN_PATH,
    metavar="OUT.html",
    help="Write the results of --measure with plots and pictures as an HTML page.",
)
@click.option(
    "--images",
    type=PATH,
    metavar="DIR",
    help="Folder of photos named like the cameras: also measure against the photos.",
)
@click.option(
    "--memory",
    type=number_of_bytes,
    metavar="SIZE",
    help="Memory limit, such as 8GiB. Arrays of a larger PLY lie in files in the folder of OUT; "
    "not with --profile vq. It does not change the result.",
)
@click.option(
    "--basis-of",
    type=PATH,
    metavar="FILE.cogs",
    help="Use the basis of this file's view-dependent colours in place of a new one, as `merge "
    "--parts` needs it; only for the profile transform.",
)
@format_option(["cogs"], "Without it, a name with the extension of another format is refused.")
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
def encode(**options: Any) -> None:
    """Encode SCENE into a progressive COGS file.

    Splats are scored in the cameras, ordered by contribution, pruned, cut into chunks and
    compressed. The number of threads does not change the result.
    """
    _encode(EncodeOptions(**options))


@dataclass(frozen=True, eq=False)
class _NewFile:
    """An encoded file and the inputs of its summary."""

    options: EncodeOptions
    request: EncodeRequest
    made: EncodeReport
    given: LoadedScene
    splats: int
    evaluation: FileEvaluation | None
    qualities: Sequence[PrefixQuality]
    stages: Stages


def _encode(options: EncodeOptions) -> None:
    """Encode a scene and print its summary, as the options say."""
    from cogsplat.codec.encode.stage_costs import stage_costs

    options.require_consistent()
    request = options.request()
    # Edits and labels by masks work on a copy in memory.
    copied = options.edits.changes or options.choice.masks is not None
    folder = options.out.absolute().parent
    working = working_memory(options.scene, request.config, options.memory, folder, copied=copied)
    kernels = needed_kernels(request.config)
    with (
        Stages(shown=not (options.quiet or options.as_json)) as stages,
        working as workspace,
        CompileAhead(kernels, thread_count(options.threads)) as ahead,
        ExitStack() as stack,
    ):
        with stages.stage("read"):
            views = scoring_cameras(options.cameras, options.eval_every)
            given = read_any(options.scene, threads=options.threads, zeros=workspace.zeros)
            splats = _prepare_scene(options, given.splats, stages)
            if views is not None:
                views = [options.edits.camera(view) for view in views]
            evaluation = _evaluation(options, splats)
        ahead.finish(stages)
        notes = notes_of(options.scene, options.edits)
        request = options.complete(request, views, given.file_bytes, workspace)
        request = request.with_stored_look(notes.up, notes.view)
        later = [] if evaluation is None else evaluation.stage_costs()
        stages.plan([*stage_costs(len(splats), request), *later])
        if options.scheduler is not None:
            executor = stack.enter_context(connected(options.scheduler, workers=options.threads))
            stages("connect", 1, 1)
            request = replace(request, executor=executor)
        made = cogsplat.encode(
            splats,
            options.out,
            request=request,
            description=_description(options, notes),
            force=options.force,
            progress=stages,
        )
        stages("write", 1, 1)
        qualities = _measure(options, evaluation, given, made, stages)
    if options.as_json or not options.quiet:
        _print_summary(
            _NewFile(options, request, made, given, len(splats), evaluation, qualities, stages)
        )


def _description(options: EncodeOptions, notes: SceneNotes) -> Description | None:
    """Return the description of the scene, updated by the JSON file of ``--describe``."""
    found = notes.description
    if options.describe is None:
        return found
    given = read_description(options.describe, limits=current_limits())
    return given if found is None else found.updated(given)


def _prepare_scene(options: EncodeOptions, splats: Splats, progress: Progress) -> Splats:
    """Apply mask labels, then edits; with --no-extras, remove the extra attributes."""
    labelled = options.choice.with_labels(
        splats, options.cameras, threads=options.threads, progress=progress
    )
    edited = options.edits.apply(labelled, options.scene)
    return edited.without_extras() if options.no_extras else edited


def _evaluation(options: EncodeOptions, splats: Splats) -> FileEvaluation | None:
    """Return the evaluation of the new file, None if the file is not measured."""
    if not (len(splats) and options.measures):
        return None
    return FileEvaluation.prepare(
        options.scene,
        splats,
        options.cameras,
        options.eval_every,
        options.edits,
        options.images,
        options.background,
        shown_at=options.shown_at,
        threads=options.threads,
    )


def _measure(
    options: EncodeOptions,
    evaluation: FileEvaluation | None,
    given: LoadedScene,
    made: EncodeReport,
    stages: Stages,
) -> list[PrefixQuality]:
    """Measure PSNR and SSIM of prefixes of the new file; write the HTML report, if chosen."""
    if evaluation is None:
        return []
    settings = settings_of(click.get_current_context(), made.scored_views, stages.total_seconds)
    qualities = evaluation.measure(options.out, threads=options.threads, progress=stages)
    if options.report is not None:
        shown = evaluation.report_input(
            options.scene,
            given.file_bytes,
            options.out,
            qualities,
            [*predicted_facts(made), *settings],
        )
        write_report(shown, options.report, force=options.force, progress=stages)
    return qualities


def _print_summary(new: _NewFile) -> None:
    """Print the summary of the new file, or its JSON object."""
    options, made, given, stages = new.options, new.made, new.given, new.stages
    with cogsplat.open(options.out) as file:
        report = _report(file, made, new.request.config, stages)
        sizes = stored_sizes(file) if new.qualities else []
    size = made.size_bytes
    rows_in, kept = given.file_splats, int(file.root.splats)
    dropped, pruned = rows_in - new.splats, new.splats - kept
    if options.as_json:
        print_json(
            {
                "output": display_name(options.out),
                "source": display_name(options.scene),
                **report,
                "prefixes": [quality.report() for quality in new.qualities],
                "attributes": [stored.report() for stored in sizes],
                "source_bytes": given.file_bytes,
                "ratio": round(given.file_bytes / size, 3),
                "source_splats": rows_in,
                "splats_dropped": dropped,
                "splats_pruned": pruned,
            }
        )
        return
    ratio = given.file_bytes / size
    print_line(f"{options.out}: {size_text(size)}, {ratio:.1f} times smaller than {options.scene}")
    gone = f"{pruned:,} pruned" + (f", {dropped:,} left out" if dropped else "")
    books = [f"{book.attribute} {book.rows:,}" for book in file.root.codebooks]
    print_facts(
        ("splats", f"{kept:,} of {rows_in:,} ({gone}), {size / max(kept, 1):.2f} B each"),
        ("chunks", f"{file.num_chunks}, SH degree {file.root.sh_degree}"),
        ("codebooks", f"{', '.join(books)} rows" if books else ""),
        *predicted_facts(made),
        ("scored", _scored(made)),
        ("time", stages.summary()),
        ("report", str(options.report) if options.report else ""),
    )
    if new.evaluation is not None:
        print_byte_table(sizes, file)
        new.evaluation.print_results(new.qualities)


def _scored(made: EncodeReport) -> str:
    """Return the scored views as text: count, origin, and the share of the scene they cover."""
    if made.views == "none":
        return count_text(made.scored_views, "view")
    shown = "of the splats" if made.views == "given" else "of what is visible"
    return (
        f"{count_text(made.scored_views, 'view')} {made.views}, {made.coverage:.1%} {shown} covered"
    )


def _views_report(made: EncodeReport) -> dict[str, object]:
    """Return the JSON keys of the predicted PSNR and of the scored views."""
    return {
        **prediction_report(made),
        "scored_views": made.scored_views,
        "scored_views_from": made.views,
        "coverage": None if made.views == "none" else round(made.coverage, 4),
    }


def _report(
    file: CogsFile, made: EncodeReport, config: EncodeConfig, stages: Stages
) -> dict[str, object]:
    """Return the JSON keys about the contents of the new file and its encode."""
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
        **_views_report(made),
        "order": config.order,
        "quality_db": None if config.profile == "near-lossless" else round(made.quality_db, 3),
        "trials": made.trials,
        "seconds": stages.rounded_seconds(),
        "cpu_seconds": stages.rounded_cpu_seconds(),
    }
