"""``cogsplat convert``: from any format that is read to any that is written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.registry import WRITABLE
from cogsplat.formats.storage.atomic import check_output, storage_errors
from cogsplat.tools.terminal.limits import limits_option
from cogsplat.tools.terminal.options import (
    PATH,
    cameras_option,
    force_option,
    json_option,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import facts, name_of, say, say_json, size_text
from cogsplat.tools.terminal.output_names import format_option, scene_format, written_bytes
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages

from .inputs import LoadedScene, given_files, read_any, scoring_cameras
from .scene_edits import SceneEdits, edit_options

_COGS: Final = "cogs"


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat convert scene.ply scene.spz\n"
    "  cogsplat convert scene.spz upright.sog --rotate 180,0,0 --sh 1"
)
@click.argument("source", type=PATH, metavar="A")
@click.argument("out", type=PATH, metavar="B")
@format_option([_COGS, *WRITABLE], "Without it, B's extension says which.")
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
    format_name: str | None,
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
    to_cogs = format_name == _COGS if format_name else out.name.lower().endswith(f".{_COGS}")
    format_ = None if to_cogs else scene_format(out, format_name)
    if cameras is not None and not to_cogs:
        raise click.UsageError(f"--cameras with {out}, expected an output that ends in .{_COGS}")
    check_output(out, force=force, inputs=given_files(source, cameras))
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, 0)
            given = read_any(source, threads=threads, progress=stages)
        with stages.stage("edit"):
            splats = edits.apply(given.splats, source)
        if to_cogs:
            from cogsplat.codec.encode.config import EncodeConfig

            cogsplat.encode(
                splats,
                out,
                cameras=None if views is None else [edits.camera(view) for view in views],
                config=EncodeConfig(threads=threads),
                force=force,
                progress=stages,
            )
            stages("write", 1, 1)
        else:
            with stages.stage("write"):
                cogsplat.write(splats, out, force=force, format_name=format_name)
    if format_ is None:
        with storage_errors(out):
            written = out.stat().st_size
    else:
        written = written_bytes(out, format_)
    name = _COGS if format_ is None else format_.name
    done = _Done(source, out, name, given, splats, written)
    if as_json:
        say_json({**_report(done), "seconds": stages.rounded()})
    elif not quiet:
        _tell(done, stages)


@dataclass(frozen=True)
class _Done:
    """Result of a conversion: the scene read, the scene written, and the bytes of the new file."""

    source: Path
    out: Path
    format: str
    given: LoadedScene
    splats: Splats
    written: int


def _report(done: _Done) -> dict[str, object]:
    return {
        "output": name_of(done.out),
        "format": done.format,
        "bytes": done.written,
        "splats": _stored(done),
        "splats_in": len(done.given.splats),
        "splats_edited_out": len(done.given.splats) - len(done.splats),
        "sh_degree": done.splats.sh_degree,
        "source": name_of(done.source),
        "source_bytes": done.given.file_bytes,
    }


def _stored(done: _Done) -> int:
    """Return the number of splats in the new file; encoding to COGS may prune some."""
    if done.format != "cogs":
        return len(done.splats)
    with cogsplat.open(done.out) as file:
        return int(file.root.splats)


def _tell(done: _Done, stages: Stages) -> None:
    stored, given = _stored(done), len(done.given.splats)
    say(
        f"{done.out}: {done.format}, {size_text(done.written)}, "
        f"from {size_text(done.given.file_bytes)}"
    )
    count = f"{stored:,}" if stored == given else f"{stored:,} of {given:,}"
    facts(
        ("splats", f"{count}, {done.written / max(stored, 1):.2f} B each"),
        ("SH degree", str(done.splats.sh_degree)),
        ("time", stages.line()),
    )
