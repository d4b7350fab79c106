"""``cogsplat merge``: several scenes as one, each labelled as an object, or the parts of one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click
import numpy as np

import cogsplat
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.geometry import merging
from cogsplat.codec.order import objects
from cogsplat.codec.splats import Splats
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.terminal.values import Vector, vector
from cogsplat.tools.workflow.descriptions import SceneNotes, notes_of
from cogsplat.tools.workflow.inputs import read_any
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_edits import SceneEdits, scale_factor
from cogsplat.tools.workflow.scene_output import (
    COGS_NAME,
    OUTPUT_FORMATS,
    WrittenScene,
    output_format,
    write_any,
)

Value = TypeVar("Value")

_STILL: Vector = (0.0, 0.0, 0.0)


def _of_scene(parse: Callable[[str], Value]) -> Callable[[str], tuple[int, Value]]:
    """Return a parser of ``N:VALUE``, a value for scene number N, from 1."""

    def numbered(text: str) -> tuple[int, Value]:
        number, _, value = text.partition(":")
        if not (number.isascii() and number.isdigit() and len(number) <= 9 and int(number)):
            raise click.BadParameter(
                f"{text!r}, expected the number of a scene, from 1, a colon and the value"
            )
        return int(number), parse(value)

    return numbered


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat merge garden.ply bench.spz both.cogs --translate 2:1.5,0,-2\n"
    "  cogsplat decode both.cogs bench.ply --object 2\n"
    "  cogsplat merge city/*.cogs city.cogs --parts"
)
@click.argument("sources", type=INPUT, nargs=-1, required=True, metavar="A B…")
@click.argument("out", type=OutputPath(), metavar="OUT")
@writing_options(OUTPUT_FORMATS, "Without it, OUT's extension names the format.")
@click.option(
    "--parts",
    "are_parts",
    is_flag=True,
    help="Join COGS files of the parts of a scene, such as `split` and `batch` make, without "
    "encoding again. They need the same SH degree, axes, origin, colours, attributes and basis "
    "(encode --basis-of). First view, up and description are those of the first one.",
)
@click.option(
    "--scale",
    "scales",
    type=_of_scene(scale_factor),
    multiple=True,
    metavar="N:S",
    help="Scale the N-th scene, from 1, about the origin. Repeat for further scenes.",
)
@click.option(
    "--rotate",
    "turns",
    type=_of_scene(vector),
    multiple=True,
    metavar="N:AX,AY,AZ",
    help="Rotate the scaled scene, degrees about the x, then the y, then the z axis.",
)
@click.option(
    "--translate",
    "shifts",
    type=_of_scene(vector),
    multiple=True,
    metavar="N:X,Y,Z",
    help="Shift the rotated scene, scene units.",
)
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def merge(
    sources: Sequence[Path],
    out: Path,
    writing: SceneWriting,
    are_parts: bool,
    scales: Sequence[tuple[int, float]],
    turns: Sequence[tuple[int, Vector]],
    shifts: Sequence[tuple[int, Vector]],
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Merge scenes, or join the parts of one.

    Without --parts, the attribute `object` labels the splats of the first scene with 1, of the
    second with 2, and so on, for chunks, budgets and decoding by object. Axes and origin are those
    of the first scene.
    Each chunk of a COGS file holds one object, so that an object can be loaded alone.
    """
    if len(sources) < 2 and not are_parts:
        raise click.UsageError(f"{sources[0]} alone, expected two scenes or more, then the output")
    name = output_format(out, writing)
    if are_parts:
        if name != COGS_NAME:
            raise click.UsageError(f"--parts with {out}, expected an output that ends in .cogs")
        if scales or turns or shifts or not writing.extras or partial_accepted():
            raise click.UsageError(
                "--parts with an option that changes or cuts a scene, expected none"
            )
        _join(sources, out, force=force, shown=not (quiet or as_json), as_json=as_json)
        return
    if name == COGS_NAME and not writing.extras:
        raise click.UsageError(
            f"--no-extras with {out}, expected object labels, by which a .cogs is cut into chunks"
        )
    edits = _edits(len(sources), dict(scales), dict(turns), dict(shifts))
    check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            given = [read_any(path, threads=threads).splats for path in sources]
        with stages.stage("merge"):
            labelled = [path for path, part in zip(sources, given, strict=True)
                        if objects.ATTRIBUTE in part.extras]  # fmt: skip
            if labelled:
                warnings.warn(
                    f"{', '.join(map(str, labelled))}: object labels are replaced by one "
                    "label for each scene",
                    CogsplatWarning,
                    stacklevel=1,
                )
            merged = merging.merge(
                [
                    edit.apply(_without_labels(part), path)
                    for edit, part, path in zip(edits, given, sources, strict=True)
                ]
            )
            counts = [len(part) for part in given]
            labels = np.repeat(np.arange(1, len(given) + 1), counts)
            merged = objects.with_labels(merged, labels)
        written = write_any(
            merged,
            out,
            name,
            force=force,
            cameras=None,
            threads=threads,
            stages=stages,
            writing=writing,
            by_object=True,
            notes=_notes(sources, edits[0]),
        )
    if as_json:
        print_json(
            {
                **written.report(out),
                "sh_degree": merged.sh_degree,
                "objects": [
                    {"object": label, "source": display_name(path), "source_splats": count}
                    for label, (path, count) in enumerate(zip(sources, counts, strict=True), 1)
                ],
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{written.line(out)}, {count_text(written.splats, 'splat')}")
        print_facts(
            *(
                (f"object {label}", f"{path}, {count_text(count, 'splat')}")
                for label, (path, count) in enumerate(zip(sources, counts, strict=True), 1)
            ),
            ("time", stages.summary()),
        )


def _join(parts: Sequence[Path], out: Path, *, force: bool, shown: bool, as_json: bool) -> None:
    """Join the files of parts, and print the result."""
    check_outputs(out, force=force)
    with Stages(shown=shown) as stages:
        made = cogsplat.join(parts, out, force=force, limits=current_limits(), progress=stages)
    written = WrittenScene(COGS_NAME, made.size_bytes, made.splats)
    if as_json:
        degree = {"sh_degree": made.sh_degree, "objects": []}
        print_json({**written.report(out), **degree, "seconds": stages.rounded_seconds()})
    elif shown:
        print_line(f"{written.line(out)}, {count_text(made.splats, 'splat')}")
        print_facts(
            ("parts", f"{made.parts:,}"), ("chunks", f"{made.chunks:,}"), ("time", stages.summary())
        )


def _notes(sources: Sequence[Path], edits: SceneEdits) -> SceneNotes:
    """Return the notes of the first scene; warn if a later scene's description is left out."""
    first = notes_of(sources[0], edits)
    left_out = [path for path in sources[1:] if notes_of(path).description is not None]
    if left_out:
        warnings.warn(
            f"{', '.join(map(str, left_out))}: the description is left out; that of "
            f"{sources[0]} is stored",
            CogsplatWarning,
            stacklevel=2,
        )
    return first


def _without_labels(splats: Splats) -> Splats:
    """Return a scene without object labels."""
    others = {name: values for name, values in splats.extras.items() if name != objects.ATTRIBUTE}
    return replace(splats, extras=others)


def _edits(
    count: int,
    scales: Mapping[int, float],
    turns: Mapping[int, Vector],
    shifts: Mapping[int, Vector],
) -> list[SceneEdits]:
    """Return the edits of each scene.

    Raises
    ------
    click.UsageError
        An option names a scene number above `count`.
    """
    named = {"--scale": scales, "--rotate": turns, "--translate": shifts}
    for option, values in named.items():
        beyond = [number for number in values if number > count]
        if beyond:
            raise click.UsageError(
                f"{option} for scene {beyond[0]}, expected a number from 1 to {count}"
            )
    return [
        SceneEdits(
            scale=scales.get(number, 1.0),
            rotate=turns.get(number, _STILL),
            translate=shifts.get(number, _STILL),
        )
        for number in range(1, count + 1)
    ]
