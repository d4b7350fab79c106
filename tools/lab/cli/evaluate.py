"""``cogsplat lab evaluate``: quality of prefixes of a scene, for several orders of its splats."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.order.orders import OrderConfig, OrderInputs
from cogsplat.codec.progress import StageCost
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.scenes.registry import WRITABLE
from cogsplat.formats.storage.atomic import atomic_write, storage_errors
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.lpips import read_lpips
from cogsplat.tools.evaluation.measuring_costs import references_cost
from cogsplat.tools.evaluation.photos import read_photos
from cogsplat.tools.lab.evaluation.evaluator import Evaluator
from cogsplat.tools.lab.evaluation.object_curves import ObjectPoint, object_curves
from cogsplat.tools.lab.evaluation.progs_protocol import (
    BYTES,
    SHARES,
    SPLATS,
)
from cogsplat.tools.lab.evaluation.strips import Strip, draw_strips
from cogsplat.tools.lab.evaluation.tables import (
    DIFFERENCES,
    STRIPS,
    EvaluationInput,
    picture_names,
    print_results,
    report,
    result_files,
)
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.option_groups import GroupedCommand
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    eval_every_option,
    force_option,
    jitter_option,
    json_option,
    quality_option,
    quiet_option,
    ssim_border_option,
    target_psnr_option,
    threads_option,
    top_k_option,
)
from cogsplat.tools.terminal.output import print_facts, print_json, print_line
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, WRITTEN_PATH
from cogsplat.tools.terminal.values import Colour
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    evaluation_cameras,
    load_cameras,
    plan_cameras,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.order_options import OrderChoice, orders_option
from cogsplat.tools.workflow.output_files import check_outputs

from .evaluation_costs import eval_costs
from .evaluation_measuring import FileMeasuring, Results, measure_codecs, measure_orders
from .evaluation_options import codecs, objects, shares, sizes
from .octree_sweep import curves, octree_depths_option, require_octree

# `--help` shows the first group.
_GROUPS: Final = {
    "Most used": (
        "--cameras",
        "--eval-every",
        "--orders",
        "--file",
        "--shares",
        "--sizes",
        "--codecs",
        "--by-object",
        "--quality",
        "--target-psnr",
        "--images",
        "--out",
        "--config",
        "--json",
        "--help-all",
        "--help",
    ),
    "Parameters of the orders": (
        "--view",
        "--first-view-share",
        "--first-view-mix",
        "--frustum-share",
        "--frustum-margin",
        "--octree-depths",
        "--octree-depth",
        "--octree-capacity",
        "--seed",
        "--objects",
        "--object-budgets",
        "--masks",
    ),
    "Scoring and measuring": (
        "--no-jitter",
        "--top-k",
        "--compensate",
        "--lpips-weights",
        "--ssim-border",
        "--background",
    ),
}


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog="\b\nExample:\n"
    "  cogsplat lab evaluate scene.ply --cameras cameras.json --out figures\n"
    "  cogsplat lab evaluate scene.ply --cameras cameras.json --file scene.cogs\n"
    "  cogsplat lab evaluate both.ply --by-object all --sizes none\n"
    "  cogsplat lab evaluate scene.ply --orders antimatter --codecs spz,splat",
)
@click.argument("scene", type=INPUT)
@cameras_option(
    "Without it, views to score in are planned, and the test views are eval_cameras.json in "
    "SCENE's folder, else some planned views."
)
@eval_every_option(8, "do not score in it, measure in it.")
@orders_option
@octree_depths_option
@click.option(
    "--file",
    "files",
    type=INPUT,
    multiple=True,
    metavar="PATH",
    help="COGS file of SCENE to measure by bytes instead of encoding every order. Repeatable.",
)
@click.option(
    "--shares",
    "wanted",
    type=shares,
    default=",".join(f"{100 * share:g}" for share in SHARES),
    show_default=True,
    metavar="P,…",
    help="Prefixes of each order, percent of the splats; or none.",
)
@click.option(
    "--sizes",
    "lengths",
    type=sizes,
    metavar="N|P%,…",
    help="Prefixes of each file, bytes; or none.  [default: 32 KiB, doubled to the end]",
)
@click.option(
    "--codecs",
    type=codecs,
    default=None,
    metavar="NAME,…",
    help="Also write each prefix of every order in these formats and measure by bytes: "
    f"{', '.join(WRITABLE)}.",
)
@click.option(
    "--by-object",
    "wanted_objects",
    type=objects,
    metavar="N,…|all",
    help="Also measure these objects in their own pixels at --shares, in every order and with the "
    "object's splats first.",
)
@click.option(
    "--compensate",
    is_flag=True,
    help="Apply prefix compensation to prefixes of files.",
)
@quality_option("Nominal PSNR of encoded files.")
@target_psnr_option("PSNR of every encoded file instead, in other views than the test views.")
@click.option(
    "--out",
    type=WRITTEN_PATH,
    metavar="DIR",
    help="Folder for the results as CSV, JSON and SVG, and for film strips.",
)
@click.option(
    "--images",
    type=PATH,
    metavar="DIR",
    help="Folder of photos named like the cameras: also measure against the photos.",
)
@click.option(
    "--lpips-weights",
    type=PATH,
    metavar="FILE",
    help="Also measure LPIPS with these weights of AlexNet or VGG-16: torch.save or .npz.",
)
@jitter_option
@top_k_option(20)
@background_option
@ssim_border_option
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def evaluate(
    scene: Path,
    cameras: Path | None,
    eval_every: int,
    choice: OrderChoice,
    octree_depths: tuple[int, ...] | None,
    files: tuple[Path, ...],
    wanted: tuple[float, ...],
    lengths: tuple[ByteCount, ...] | None,
    codecs: tuple[str, ...] | None,
    wanted_objects: tuple[int, ...] | None,
    compensate: bool,
    quality: float,
    target_psnr: float | None,
    out: Path | None,
    images: Path | None,
    lpips_weights: Path | None,
    no_jitter: bool,
    top_k: int,
    background: Colour,
    ssim_border: str,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Measure prefixes of SCENE under several orders of its splats.

    Prefixes of each order, without quantisation, and prefixes of a COGS file in that order are
    compared with the whole scene. PSNR is the mean and the worst of held-out views, and the mean of
    roaming views, which step back and turn away. Each is also averaged over the logarithm of
    splats or bytes.
    """
    cut = bool(files) or lengths != ()
    by = ([SPLATS] if wanted else []) + ([BYTES] if cut or codecs else [])
    if wanted_objects is not None and not wanted:
        raise click.UsageError("--by-object with --shares none, expected shares to measure at")
    if not by:
        raise click.UsageError("--shares none and --sizes none: nothing to measure")
    require_octree(choice.names, octree_depths)
    if out is not None:
        _prepare_folder(out, by, force=force)
    results = Results()
    of_objects: list[ObjectPoint] = []
    with Stages(shown=not (quiet or as_json)) as stages:

        def work(
            splats: Splats, scored_on: Sequence[Camera], test_views: Sequence[Camera]
        ) -> list[StageCost]:
            return eval_costs(
                splats,
                scored_on,
                test_views,
                [curve.order for curve in curves(choice.names, OrderConfig(), octree_depths)],
                sorts=bool(wanted or codecs),
                shares=len(wanted),
                objects=wanted_objects,
                files=len(files),
                cut=cut,
                lengths=None if lengths is None else len(lengths),
                codecs=len(codecs or ()),
                quality_db=quality,
                target_psnr=target_psnr,
            )

        given = _gather(
            scene,
            cameras,
            eval_every,
            choice,
            images,
            lpips_weights,
            no_jitter,
            top_k,
            background,
            ssim_border,
            work,
            threads=threads,
            stages=stages,
        )
        unordered = OrderInputs(
            given.splats, given.scores, given.scored_on, threads, stages, jitter=not no_jitter
        )
        measured = curves(choice.names, given.config, octree_depths)
        ordered: dict[str, NDArray[np.int64]] = {}
        if wanted or codecs:
            ordered = measure_orders(given, measured, unordered, wanted, results, stages)
        if wanted_objects is not None:
            of_objects = object_curves(
                given.splats,
                ordered,
                wanted_objects,
                wanted,
                given.evaluator.cameras,
                background=background,
                threads=threads,
                progress=stages,
            )
        measuring = FileMeasuring(given, lengths, results, compensate, threads, stages)
        if files:
            measuring.measure_files(files)
        elif cut:
            measuring.measure_encodes(measured, quality, target_psnr)
        if codecs:
            measure_codecs(given, codecs, ordered, wanted or SHARES, results, stages)
        pages = result_files(given, results.points, by, of_objects)
        if out is not None:
            _write(out, pages, given, results.strips, force=force, stages=stages)
    if as_json:
        print_json(
            {**report(given, results.points, by, of_objects), "seconds": stages.rounded_seconds()}
        )
        return
    print_results(given, results.points, by, of_objects)
    if not quiet:
        print_line("")
        drawn = [page for kind in by for page in results.strip_files(kind)]
        written = "" if out is None else f"{', '.join([*pages, *drawn])} in {out}"
        print_facts(("written", written), ("time", stages.summary()))


def _prepare_folder(out: Path, by: Sequence[str], *, force: bool) -> None:
    """Make the folder of the results, and refuse to replace files before minutes of work."""
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    names = ("eval.csv", "eval.json", *picture_names(by))
    check_outputs(*(out / name for name in names), force=force)


def _gather(
    path: Path,
    cameras: Path | None,
    eval_every: int,
    choice: OrderChoice,
    images: Path | None,
    lpips_weights: Path | None,
    no_jitter: bool,
    top_k: int,
    background: Colour,
    ssim_border: str,
    work: Callable[[Splats, Sequence[Camera], Sequence[Camera]], list[StageCost]],
    *,
    threads: int,
    stages: Stages,
) -> EvaluationInput:
    """Read and score a scene; `work` returns the costs of the later stages from scene and views."""
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.encode.scored_views import score_scene
    from cogsplat.codec.encode.stage_costs import score_cost

    with stages.stage("read"):
        views = scoring_cameras(cameras, eval_every)
        splats = drop_invalid_splats(read_any(path, threads=threads).splats, path)
        if not len(splats):
            raise DataError("no-splats", f"{path}: 0 splats, expected at least 1")
        lpips = None if lpips_weights is None else read_lpips(lpips_weights)
    splats = choice.with_labels(splats, cameras, threads=threads, progress=stages)
    numbered = load_cameras(cameras) if cameras else []
    planned = None
    if views is None:
        planned = plan_cameras(splats, threads=threads, progress=stages)
        views = hold_out(planned, eval_every)[0] or planned
    config = choice.config(splats, numbered, threads)
    test_views, what = evaluation_cameras(path, splats, cameras, eval_every, planned=planned)
    preset = PRESETS[DEFAULT_PRESET]
    scoring = score_cost(len(splats), preset, views, jitter=not no_jitter)
    references = references_cost(len(splats), test_views)
    stages.plan(
        [
            StageCost("references", references),
            scoring,
            *work(splats, preset.views(views), test_views),
        ]
    )
    photos = None
    if images is not None:
        photos = read_photos(images, splats, test_views, background, threads=threads)
    with stages.stage("references"):
        evaluator = Evaluator(
            splats,
            test_views,
            first_view=config.first_view,
            photos=None if photos is None else photos.pictures,
            lpips=lpips,
            background=background,
            ssim_border=ssim_border,
            threads=threads,
        )
    settings = preset.score_config("transform", top_k=top_k, jitter=not no_jitter, threads=threads)
    request = EncodeRequest(
        cameras=views,
        test_views=test_views,
        config=EncodeConfig(threads=threads),
        score_config=settings,
    )
    scored = score_scene(splats, request, stages)
    assert scored.scores is not None
    return EvaluationInput(
        path, splats, scored.scores, scored.views, what, config, evaluator, photos
    )


def _write(
    out: Path,
    pages: Mapping[str, str],
    given: EvaluationInput,
    strips: Mapping[str, list[Strip]],
    *,
    force: bool,
    stages: Stages,
) -> None:
    """Write the results and film strips into a folder."""
    from cogsplat.tools.pictures.png import write_png

    for name, text in pages.items():
        with atomic_write(out / name, force=force) as file:
            file.write(text.encode())
    with stages.stage("strips"):
        for kind, rows in strips.items():
            if rows:
                write_png(draw_strips(given.evaluator, rows), out / STRIPS[kind], force=force)
                apart = draw_strips(given.evaluator, rows, differences=True)
                write_png(apart, out / DIFFERENCES[kind], force=force)
