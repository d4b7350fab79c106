"""``cogsplat lab bench``: size, quality and speed of COGS and foreign formats on a scene."""

from __future__ import annotations

import csv
import io
import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import StageCost
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.storage.atomic import atomic_write, storage_errors
from cogsplat.formats.storage.scratch_folder import scratch_folder
from cogsplat.tools.evaluation.photos import read_photos
from cogsplat.tools.lab.benchmark import ablation as bench_ablation
from cogsplat.tools.lab.benchmark import rate_distortion as benches
from cogsplat.tools.lab.benchmark.ablation import AblationTable
from cogsplat.tools.lab.benchmark.rate_distortion import Bench, BenchInput, Row, StageTime
from cogsplat.tools.pictures.svg_charts import Series, bar_chart, line_chart
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    eval_every_option,
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    display_title,
    print_facts,
    print_json,
    print_line,
    print_table,
    size_text,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, WRITTEN_PATH
from cogsplat.tools.terminal.values import Colour
from cogsplat.tools.workflow.inputs import (
    drop_invalid_splats,
    evaluation_cameras,
    plan_cameras,
    read_any,
    scoring_cameras,
)
from cogsplat.tools.workflow.output_files import check_outputs

_PROFILES: Final = ("transform", "vq", "near-lossless")

# What an ablation is measured at, nominal: 40 dB on a captured room, where scenes are published.
_ABLATION_DB: Final = 41.0

_FILES: Final = ("bench.csv", "bench.json", "prefixes.csv", "rate-distortion.svg", "received.svg")
_ABLATION_FILES: Final = ("ablation.csv", "ablation.json", "ablation.svg")


def _names(text: str, known: Sequence[str]) -> tuple[str, ...]:
    """Parse names or their beginnings, separated by commas, or ``all``, or ``none``."""
    if text.strip().lower() in ("all", "none"):
        return tuple(known) if text.strip().lower() == "all" else ()
    found: list[str] = []
    for part in text.split(","):
        key = _key(part)
        exact = [name for name in known if _key(name) == key]
        begun = exact or [name for name in known if key and _key(name).startswith(key)]
        if len(begun) != 1:
            raise click.BadParameter(
                f"{part.strip()!r}, expected all, none or some of {', '.join(known)}"
            )
        found.append(begun[0])
    return tuple(dict.fromkeys(found))


def _key(name: str) -> str:
    """Return a name in the form in which names are compared."""
    return "".join(character for character in name.lower() if character.isalnum())


def profile_names(text: str) -> tuple[str, ...]:
    """Parse the names of profiles given to ``--profiles``.

    Raises
    ------
    click.BadParameter
        A name is unknown or ambiguous.
    """
    return _names(text, _PROFILES)


def format_names(text: str) -> tuple[str, ...]:
    """Parse the names of foreign formats given to ``--formats``.

    Raises
    ------
    click.BadParameter
        A name is unknown or ambiguous.
    """
    return _names(text, benches.FOREIGN)


def decibels(text: str) -> tuple[float, ...]:
    """Parse nominal qualities such as ``30,35,40``, in dB.

    Raises
    ------
    click.BadParameter
        The text is no list of numbers from 10 to 90.
    """
    try:
        values = tuple(sorted({float(part) for part in text.split(",")}))
    except ValueError:
        values = ()
    if not values or not all(10 <= value <= 90 for value in values):
        raise click.BadParameter(f"{text!r}, expected dB from 10 to 90 such as 30,35,40")
    return values


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat lab bench scene.ply --cameras cameras.json --out figures\n"
    "  cogsplat lab bench scene.ply --cameras cameras.json --ablation"
)
@click.argument("scene", type=INPUT)
@cameras_option(
    "Without it, views to score in are planned, and the test views are eval_cameras.json in "
    "SCENE's folder, else some planned views."
)
@eval_every_option(8, "do not score in it, measure in it.")
@click.option(
    "--out",
    type=WRITTEN_PATH,
    metavar="DIR",
    help="Folder for the results as CSV, JSON and SVG.",
)
@click.option(
    "--profiles",
    type=profile_names,
    default="all",
    show_default=True,
    metavar="NAMES",
    help=f"COGS profiles, separated by commas: {', '.join(_PROFILES)}; all or none.",
)
@click.option(
    "--formats",
    type=format_names,
    default="all",
    show_default=True,
    metavar="NAMES",
    help=f"Other formats, separated by commas: {', '.join(benches.FOREIGN)}; all or none.",
)
@click.option(
    "--qualities",
    type=decibels,
    metavar="DB,…",
    help="Nominal PSNRs of the profiles for viewing, and target PSNRs of tuned files.  "
    "[default: a range for each]",
)
@click.option(
    "--tuned",
    is_flag=True,
    help="Also tune transform and vq to each quality, which takes minutes a file.",
)
@click.option(
    "--images",
    type=PATH,
    metavar="DIR",
    help="Folder of photos named like the cameras: also measure the PSNR lost against them.",
)
@click.option(
    "--ablation",
    is_flag=True,
    help="Instead measure the bytes that each technique of the transform profile saves.",
)
@background_option
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def bench(
    scene: Path,
    cameras: Path | None,
    eval_every: int,
    out: Path | None,
    profiles: tuple[str, ...],
    formats: tuple[str, ...],
    qualities: tuple[float, ...] | None,
    tuned: bool,
    images: Path | None,
    ablation: bool,
    background: Colour,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Compare COGS profiles with foreign formats on SCENE.

    SCENE is written in each format, read back and compared with renders of SCENE in the same views.
    Durations are of one run; those of COGS include scoring. Bytes per splat are per splat of
    SCENE, pruned splats included.
    """
    if ablation and qualities is not None and len(qualities) != 1:
        raise click.UsageError("--ablation measures at one quality, expected one in --qualities")
    if tuned and (ablation or not set(profiles) & set(benches.TUNED)):
        raise click.UsageError("--tuned tunes profiles, expected transform or vq in --profiles")
    if not ablation and not profiles and not formats:
        raise click.UsageError("--profiles none and --formats none: nothing to measure")
    if out is not None:
        # Checked before minutes of work.
        with storage_errors(out):
            out.mkdir(parents=True, exist_ok=True)
        names = _ABLATION_FILES if ablation else _FILES
        check_outputs(*(out / name for name in names), force=force)
    with Stages(shown=not (quiet or as_json)) as stages:

        def work(
            splats: Splats, scored_on: Sequence[Camera], test_views: Sequence[Camera]
        ) -> StageCost:
            if ablation:
                return bench_ablation.stage_cost(len(splats), splats.sh_degree, test_views)
            return benches.stage_cost(
                len(splats),
                scored_on,
                test_views,
                profiles=profiles,
                qualities=qualities,
                formats=formats,
                tuned=tuned,
            )

        given, what = _gather(
            scene, cameras, eval_every, images, background, work, threads=threads, stages=stages
        )
        about = _about(scene, given, what)
        with scratch_folder() as folder:
            if ablation:
                found = bench_ablation.run(
                    given,
                    quality_db=qualities[0] if qualities else _ABLATION_DB,
                    progress=stages,
                )
            else:
                measured = benches.run(
                    given,
                    folder,
                    profiles=profiles,
                    qualities=qualities,
                    formats=formats,
                    tuned=tuned,
                    progress=stages,
                )
    title = display_title(scene, in_folder=True)
    pages = (
        _ablation_pages(found, about, title) if ablation else _bench_pages(measured, about, title)
    )
    if out is not None:
        _write_pages(out, pages, force=force)
    if as_json:
        report = _ablation_report(found, about) if ablation else _bench_report(measured, about)
        seconds = {"seconds": stages.rounded_seconds(), "cpu_seconds": stages.rounded_cpu_seconds()}
        print_json({**report, **seconds})
        return
    _print_about(scene, given, what)
    if ablation:
        _print_ablation(found)
    else:
        _print_rows(measured.rows)
        _print_stages(measured.stages)
        _print_prefixes(measured)
    if not quiet:
        print_line("")
        print_facts(
            ("written", f"{', '.join(pages)} in {out}" if out is not None else ""),
            ("time", stages.summary()),
        )


def _gather(
    scene: Path,
    cameras: Path | None,
    eval_every: int,
    images: Path | None,
    background: Colour,
    work: Callable[[Splats, Sequence[Camera], Sequence[Camera]], StageCost],
    *,
    threads: int,
    stages: Stages,
) -> tuple[BenchInput, str]:
    """Read and score a scene; `work` returns the cost of the later stages from scene and views."""
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.encode.scored_views import score_scene
    from cogsplat.codec.encode.stage_costs import score_cost

    with stages.stage("read"):
        views = scoring_cameras(cameras, eval_every)
        # Most formats hold no extra attributes.
        drawn = read_any(scene, threads=threads).splats.without_extras()
        splats = drop_invalid_splats(drawn, scene)
        if not len(splats):
            raise DataError("no-splats", f"{scene}: 0 splats, expected some to measure")
    planned = None
    tuned_in = views
    if views is None:
        planned = plan_cameras(splats, threads=threads, progress=stages)
        views = hold_out(planned, eval_every)[0] or planned
    test_views, what = evaluation_cameras(scene, splats, cameras, eval_every, planned=planned)
    photos = None
    if images is not None:
        photos = read_photos(images, splats, test_views, background, threads=threads)
    preset = PRESETS[DEFAULT_PRESET]
    config = preset.score_config("transform", threads=threads, colour_sensitivity=True)
    work_after = work(splats, preset.views(views), test_views)
    stages.plan([score_cost(len(splats), preset, views), work_after])
    start = time.perf_counter()
    request = EncodeRequest(
        cameras=views,
        test_views=test_views,
        config=EncodeConfig(threads=threads),
        score_config=config,
    )
    scored = score_scene(splats, request, stages)
    assert scored.scores is not None
    score_s = time.perf_counter() - start
    given = BenchInput(
        splats,
        scored.scores,
        score_s,
        test_views,
        scored.views,
        tuned_in,
        photos,
        background,
        threads,
    )
    return given, what


def _about(scene: Path, given: BenchInput, what: str) -> dict[str, object]:
    """Return the JSON keys about scene, views and machine."""
    return {
        "source": display_name(scene),
        "splats": len(given.splats),
        "sh_degree": given.splats.sh_degree,
        "test_views": {"from": what, "count": len(given.cameras)},
        "scored_views": len(given.scored_on),
        "score_s": round(given.score_s, 3),
        "background": list(given.background),
        "source_photo_db": None if given.photos is None else given.photos.source_db,
        "machine": {
            "platform": platform.platform(),
            "cores": thread_count(0),
            "threads": thread_count(given.threads),
            "python": platform.python_version(),
        },
    }


def _print_about(scene: Path, given: BenchInput, what: str) -> None:
    """Print the scene and its views."""
    splats = given.splats
    print_line(f"{scene}: {len(splats):,} splats, SH degree {splats.sh_degree}")
    photo = "" if given.photos is None else f"{given.photos.source_db:.2f} dB for the source"
    print_facts(
        ("test views", f"{len(given.cameras)} {what}"),
        ("scored", f"on {len(given.scored_on)} views, {given.score_s:.1f} s"),
        ("photos", photo),
    )
    print_line("")


def _print_rows(rows: Sequence[Row]) -> None:
    """Print size, quality and durations of each method."""
    with_photos = any(row.photo_loss_db is not None for row in rows)
    columns = ["", "bytes", "B/splat", "held-out", "worst", "roam", "SSIM"]
    columns += ["lost", "enc s", "dec s"] if with_photos else ["enc s", "dec s"]
    cells: list[list[str]] = []
    for row in rows:
        if row.refused:
            cells.append([row.label, row.refused, *[""] * (len(columns) - 2)])
            continue
        cells.append(
            [
                row.label,
                size_text(row.file_bytes),
                f"{row.bytes_per_splat:.2f}",
                f"{row.held_out_db:.2f}",
                f"{row.worst_db:.2f}",
                f"{row.roam_db:.2f}",
                f"{row.held_out_ssim:.4f}",
                *([] if row.photo_loss_db is None else [f"{row.photo_loss_db:.2f}"]),
                f"{row.encode_s:.1f}",
                f"{row.decode_s:.3f}",
            ]
        )
    print_table(columns, cells)


def _print_prefixes(measured: Bench) -> None:
    """Print the PSNR of prefixes by their bytes."""
    named = list(dict.fromkeys(prefix.label for prefix in measured.prefixes))
    if not named:
        return
    by_size: dict[int, dict[str, str]] = {}
    for prefix in measured.prefixes:
        text = f"{prefix.held_out_db:.2f}"
        by_size.setdefault(prefix.prefix_bytes, {})[prefix.label] = text
    print_line("")
    cells = [
        [size_text(size), *(by_size[size].get(name, "") for name in named)]
        for size in sorted(by_size)
    ]
    print_table(["received", *named], cells)


def _print_stages(stages: Sequence[StageTime]) -> None:
    """Print the seconds of each stage of an encode after scoring."""
    if not stages:
        return
    whole: dict[str, float] = {}
    for stage in stages:
        whole[stage.label] = whole.get(stage.label, 0.0) + stage.wall_s
    print_line("")
    cells = [
        [
            stage.label,
            stage.stage,
            f"{stage.wall_s:.2f}",
            f"{100 * stage.wall_s / whole[stage.label]:.0f} %" if whole[stage.label] else "",
            f"{stage.cpu_s:.2f}",
        ]
        for stage in stages
    ]
    print_table(["", "stage", "s", "share", "CPU s"], cells, left=2)


def _print_ablation(found: AblationTable) -> None:
    """Print the bytes without each technique."""
    print_line(f" bytes at {found.held_out_db:.2f} dB held-out, without")
    cells = [
        [
            row.technique,
            f"{row.bytes_per_splat:.2f}",
            f"{100 * row.more:+.1f} %" if row.more else "",
            f"{row.roam_db:.2f}",
            f"{row.encode_s:.1f}",
        ]
        for row in found.rows
    ]
    print_table(["", "B/splat", "more", "roam", "enc s"], cells)


def _bench_report(measured: Bench, about: Mapping[str, object]) -> dict[str, object]:
    """Return the JSON object of a comparison."""
    return {
        **about,
        "methods": [row.report() for row in measured.rows],
        "prefixes": [prefix.report() for prefix in measured.prefixes],
        "stages": [stage.report() for stage in measured.stages],
    }


def _ablation_report(found: AblationTable, about: Mapping[str, object]) -> dict[str, object]:
    """Return the JSON object of an ablation."""
    rows = [row.report() for row in found.rows]
    return {**about, "held_out_db": found.held_out_db, "without": rows}


def _bench_pages(measured: Bench, about: Mapping[str, object], title: str) -> dict[str, str]:
    """Return the contents of the files of a comparison by file name."""
    report = _bench_report(measured, about)
    pages = (
        _csv([row.report() for row in measured.rows]),
        json.dumps(report, indent=2, allow_nan=False) + "\n",
        _csv([prefix.report() for prefix in measured.prefixes]),
        _rate_distortion(measured, title),
        _received(measured, title),
    )
    return dict(zip(_FILES, pages, strict=True))


def _ablation_pages(
    found: AblationTable, about: Mapping[str, object], title: str
) -> dict[str, str]:
    """Return the contents of the files of an ablation by file name."""
    bars = [(row.technique, 100 * row.more) for row in found.rows[1:]]
    drawn = bar_chart(f"{title}: more bytes at {found.held_out_db:.1f} dB, without", bars, unit="%")
    pages = (
        _csv([row.report() for row in found.rows]),
        json.dumps(_ablation_report(found, about), indent=2, allow_nan=False) + "\n",
        drawn,
    )
    return dict(zip(_ABLATION_FILES, pages, strict=True))


def _style(method: str) -> int:
    """Return the index of the colour and marker of a method in charts."""
    return (*_PROFILES, *benches.FOREIGN, *benches.TUNED.values()).index(method)


def _series(measured: Bench) -> list[Series]:
    """Return a curve of PSNR over bytes per splat for each method, without lossless results."""
    series: list[Series] = []
    for method in dict.fromkeys(row.method for row in measured.rows):
        rows = [row for row in measured.rows if row.method == method and not row.refused]
        points = [(row.bytes_per_splat, row.held_out_db) for row in rows if not row.is_identical]
        if points:
            series.append(Series(method, tuple(points), _style(method), joined=len(points) > 1))
    return series


def _rate_distortion(measured: Bench, title: str) -> str:
    """Return the chart of PSNR over bytes per splat, SVG."""
    identical = [row.label for row in measured.rows if row.is_identical and not row.refused]
    return line_chart(
        f"{title}: quality for size",
        "bytes per splat",
        "PSNR of held-out views, dB",
        _series(measured),
        note=f"Not drawn because lossless: {', '.join(identical)}" if identical else "",
    )


def _received(measured: Bench, title: str) -> str:
    """Return the chart of PSNR over received bytes, SVG."""
    series: list[Series] = []
    for label in dict.fromkeys(prefix.label for prefix in measured.prefixes):
        own = [prefix for prefix in measured.prefixes if prefix.label == label]
        points = tuple((prefix.prefix_bytes, prefix.held_out_db) for prefix in own)
        series.append(Series(label, points, _style(own[0].method)))
    series += [
        Series(row.label, ((row.file_bytes, row.held_out_db),), _style(row.method), joined=False)
        for row in measured.rows
        if not (row.is_cogs or row.refused or row.is_identical)
    ]
    return line_chart(
        f"{title}: quality by bytes received",
        "bytes received",
        "PSNR of held-out views, dB",
        series,
        x_text=lambda x: f"{x / 1024:g} KiB" if x < 1 << 20 else f"{x / (1 << 20):g} MiB",
        note="Single points: other formats show nothing before their last byte.",
    )


def _csv(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV."""
    page = io.StringIO()
    if rows:
        writer = csv.DictWriter(page, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return page.getvalue()


def _write_pages(folder: Path, pages: Mapping[str, str], *, force: bool) -> None:
    for name, text in pages.items():
        with atomic_write(folder / name, force=force) as file:
            file.write(text.encode())
