"""``cogsplat convert``: from any format that is read to any that is written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.atomic import check_output
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.options import (
    cameras_option,
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import facts, name_of, say, say_json, size_text
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath

from .inputs import LoadedScene, given_files, read_any, scoring_cameras
from .scene_edits import SceneEdits, edit_options
from .scene_output import (
    OUTPUT_FORMATS,
    WrittenScene,
    output_format,
    require_cogs_for_cameras,
    write_any,
)


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat convert scene.ply scene.spz\n"
    "  cogsplat convert scene.spz upright.sog --rotate 180,0,0 --sh 1"
)
@click.argument("source", type=INPUT, metavar="A")
@click.argument("out", type=OutputPath(), metavar="B")
@writing_options(OUTPUT_FORMATS, "Without it, B's extension says which.")
@edit_options
@cameras_option("For a .cogs only; without it, views are planned around the scene.")
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def convert(
    source: Path,
    out: Path,
    writing: SceneWriting,
    edits: SceneEdits,
    cameras: Path | None,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Convert a scene to another format.

    B's extension names it. COGS files are read and written too; `encode` has all options of
    writing one. What a format cannot hold is said in a warning.
    """
    name = output_format(out, writing)
    require_cogs_for_cameras(cameras, out, name)
    check_output(out, force=force, inputs=given_files(source, cameras))
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, 0)
            given = read_any(source, threads=threads, progress=stages)
        with stages.stage("edit"):
            splats = edits.apply(given.splats, source)
        written = write_any(
            splats,
            out,
            name,
            force=force,
            cameras=None if views is None else [edits.camera(view) for view in views],
            threads=threads,
            stages=stages,
            writing=writing,
        )
    done = _Done(source, out, given, splats, written)
    if as_json:
        say_json({**_report(done), "seconds": stages.rounded()})
    elif not quiet:
        _tell(done, stages)


@dataclass(frozen=True)
class _Done:
    """Result of a conversion: the scene read, the scene written, and the new file."""

    source: Path
    out: Path
    given: LoadedScene
    splats: Splats
    written: WrittenScene


def _report(done: _Done) -> dict[str, object]:
    return {
        **done.written.report(done.out),
        "source_splats": len(done.given.splats),
        "splats_edited_out": len(done.given.splats) - len(done.splats),
        "sh_degree": done.splats.sh_degree,
        "source": name_of(done.source),
        "source_bytes": done.given.file_bytes,
    }


def _tell(done: _Done, stages: Stages) -> None:
    stored, given = done.written.splats, len(done.given.splats)
    say(f"{done.written.line(done.out)}, from {size_text(done.given.file_bytes)}")
    count = f"{stored:,}" if stored == given else f"{stored:,} of {given:,}"
    facts(
        ("splats", f"{count}, {done.written.size_bytes / max(stored, 1):.2f} B each"),
        ("SH degree", str(done.splats.sh_degree)),
        ("time", stages.line()),
    )
