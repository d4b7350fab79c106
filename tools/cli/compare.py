"""``cogsplat compare``: PSNR and SSIM of one scene against another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import StageCost
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import at_width
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.measuring_costs import comparison_costs, objects_cost
from cogsplat.tools.evaluation.object_quality import ObjectQuality
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    background_option,
    cameras_option,
    compensate_option,
    eval_every_option,
    force_option,
    json_option,
    part_options,
    quiet_option,
    shown_at_option,
    ssim_border_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
    print_table,
)
from cogsplat.tools.terminal.output_names import PNG, check_name
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, WRITTEN_PATH
from cogsplat.tools.terminal.values import ChunkRange, Colour
from cogsplat.tools.workflow.inputs import (
    LoadedScene,
    Selection,
    evaluation_cameras,
    read_any,
)
from cogsplat.tools.workflow.output_files import check_outputs

if TYPE_CHECKING:
    from cogsplat.codec.scoring.view_quality import ViewQuality


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat compare scene.ply scene.cogs --cameras cameras.json\n"
    "  cogsplat compare scene.ply scene.cogs --bytes 10% --difference tenth.png"
)
@click.argument("reference", type=INPUT, metavar="A")
@click.argument("other", type=INPUT, metavar="B")
@cameras_option(
    "Without it, all of eval_cameras.json in A's folder, else the test views that `encode` plans "
    "for A."
)
@eval_every_option(None, "compare in it alone; 0 compares in all.")
@click.option(
    "--by-object",
    is_flag=True,
    help="Also measure every object of A's attribute `object`, in the pixels where its blending "
    "weight is largest.",
)
@click.option(
    "--difference",
    type=WRITTEN_PATH,
    metavar="OUT.png",
    help="Also write a picture of the worst view: A, B, and their difference times four.",
)
@shown_at_option
@background_option
@ssim_border_option
@part_options
@compensate_option
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def compare(
    reference: Path,
    other: Path,
    cameras: Path | None,
    eval_every: int | None,
    by_object: bool,
    difference: Path | None,
    shown_at: int | None,
    background: Colour,
    ssim_border: str,
    chunks: ChunkRange | None,
    least_splats: int | None,
    size: ByteCount | None,
    objects: tuple[int, ...] | None,
    sh_degree: int | None,
    compensate: bool,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Measure PSNR and SSIM between A and B, or a part of B.

    Both are measured in test views; close up, at 40 % of a test view's distance from what it shows;
    and in roaming views, which step back from the test views and turn away. If one of the two has
    viewpoints of training, both are drawn by them.
    """
    from cogsplat.codec.scoring.view_quality import compare as compare_scenes
    from cogsplat.tools.evaluation import object_quality

    if difference is not None:
        check_name(difference, PNG)
        check_outputs(difference, force=force)
    part = Selection(chunks, least_splats, size, sh_degree, objects, compensate=compensate)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            first = read_any(reference, threads=threads)
            second = read_any(other, part, threads=threads)
        views, what = evaluation_cameras(
            reference, first.splats, cameras, eval_every, threads=threads, progress=stages
        )
        views = at_width(views, shown_at)
        costs = comparison_costs(len(first.splats), views)
        if by_object:
            costs.append(StageCost("objects", objects_cost(len(first.splats), views, 1)))
        stages.plan(costs)
        found = compare_scenes(
            first.splats,
            second.splats,
            views,
            background=background,
            ssim_border=ssim_border,
            threads=threads,
            progress=stages,
        )
        own = None
        if by_object:
            own = object_quality.object_qualities(
                first.splats,
                second.splats,
                views,
                background=background,
                threads=threads,
                progress=stages,
            )
        if difference is not None:
            worst = views[found.test.index(found.worst)]
            with stages.stage("difference"):
                _draw_difference(
                    first.splats, second.splats, worst, background, difference, force, threads
                )
    sets = {"test": found.test, "close": found.close, "roam": found.roaming}
    if as_json:
        print_json(
            {
                "reference": _scene_report(reference, first),
                "other": _scene_report(other, second),
                "test_views": {"from": what, "count": len(views)},
                "background": list(background),
                "ssim_border": ssim_border,
                **{name: _figures(qualities) for name, qualities in sets.items()},
                "per_view": {
                    name: [asdict(quality) for quality in qualities]
                    for name, qualities in sets.items()
                },
                **({} if own is None else {"by_object": [asdict(quality) for quality in own]}),
                **({} if difference is None else {"difference": display_name(difference)}),
                "seconds": stages.rounded_seconds(),
            }
        )
        return
    print_line(f"{other} against {reference}")
    print_facts(
        ("splats", f"{len(second.splats):,} against {len(first.splats):,}"),
        ("by", f"{what}, {_colour_name(background)} background"),
        ("note", _scored_note(eval_every) if cameras is not None else ""),
    )
    print_line("")
    _print_figures(sets)
    if own is not None:
        print_line("")
        _print_objects(own)
    if not quiet:
        print_line("")
        drawn = "" if difference is None else f"{difference}: A, B, difference x4 in the worst view"
        print_facts(("drawn", drawn), ("time", stages.summary()))


def _scored_note(every: int | None) -> str:
    """Return a note on the interval of the test views and on the encoder's."""
    if every is None:
        return "the cameras that `encode` and `tune` leave out, or all of fewer than nine"
    if not every:
        return "all cameras, those that the encoder scored among them"
    return f"one camera in {every}; `encode` and `tune` leave out one in 8, or in 4 of 16 to 39"


def _scene_report(path: Path, scene: LoadedScene) -> dict[str, object]:
    """Return the JSON object of one of the two scenes."""
    return {
        "source": display_name(path),
        "splats": len(scene.splats),
        "source_splats": scene.file_splats,
        "sh_degree": scene.splats.sh_degree,
        "bytes_read": scene.bytes_read,
        "source_bytes": scene.file_bytes,
    }


def _figures(qualities: Sequence[ViewQuality]) -> dict[str, object]:
    """Return the JSON object of a set of views; without figures for an empty set."""
    if not qualities:
        return {"views": 0}
    from cogsplat.codec.scoring.view_quality import mean_psnr_db, mean_ssim, worst_view

    return {
        "psnr_db": mean_psnr_db(qualities),
        "ssim": mean_ssim(qualities),
        "views": len(qualities),
        "worst": asdict(worst_view(qualities)),
    }


def _print_figures(sets: Mapping[str, Sequence[ViewQuality]]) -> None:
    """Print mean PSNR and SSIM of each set of views, and its worst view."""
    from cogsplat.codec.scoring.view_quality import mean_psnr_db, mean_ssim, worst_view

    cells = []
    for name, qualities in sets.items():
        if not qualities:
            continue
        worst = worst_view(qualities)
        where = "" if worst.distance is None else f", {worst.distance:.3g} away"
        cells.append(
            (
                name,
                count_text(len(qualities), "view"),
                f"{mean_psnr_db(qualities):.2f}",
                f"{mean_ssim(qualities):.4f}",
                f"{worst.psnr_db:.2f}",
                f"{worst.view}{where}",
            )
        )
    print_table(("", "", "PSNR dB", "SSIM", "worst dB", ""), cells, left=2)


def _print_objects(qualities: Sequence[ObjectQuality]) -> None:
    """Print a table of PSNR by object."""
    cells = [
        (
            str(one.object),
            count_text(one.views, "view"),
            f"{one.pixels:,}",
            "" if one.psnr_db is None else f"{one.psnr_db:.2f}",
            "" if one.worst_db is None else f"{one.worst_db:.2f}",
        )
        for one in qualities
    ]
    print_table(("object", "", "pixels", "PSNR dB", "worst"), cells, left=2)


def _draw_difference(
    first: Splats,
    second: Splats,
    camera: Camera,
    background: Colour,
    out: Path,
    force: bool,
    threads: int,
) -> None:
    """Write a picture of both scenes and their difference in one view."""
    from cogsplat.codec.render.rasteriser import RenderConfig
    from cogsplat.codec.render.rasteriser import render as draw
    from cogsplat.codec.scoring.view_quality import share_capture
    from cogsplat.tools.pictures.difference import difference_image
    from cogsplat.tools.pictures.png import write_png

    config = RenderConfig(background=background, threads=threads)
    pictures = [draw(splats, camera, config) for splats in share_capture(first, second)]
    write_png(difference_image(*pictures), out, force=force)


def _colour_name(colour: Colour) -> str:
    """Return a colour as text."""
    names = {(0.0, 0.0, 0.0): "black", (1.0, 1.0, 1.0): "white"}
    return names.get(colour) or "({:g}, {:g}, {:g})".format(*colour)
