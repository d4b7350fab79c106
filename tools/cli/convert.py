"""``cogsplat convert``: a scene in another format, or a COGS file as a folder and back."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME, MANIFEST_SUFFIX
from cogsplat.formats.cogs.folder_writer import (
    Unpacked,
    check_manifest_name,
    pack_cogs,
    unpack_cogs,
)
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.scenes.registry import is_cogs
from cogsplat.formats.storage.atomic import is_folder, storage_errors
from cogsplat.formats.storage.scratch_folder import scratch_folder
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import (
    cameras_option,
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
    size_text,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT, OutputPath
from cogsplat.tools.workflow.descriptions import SceneNotes, notes_of
from cogsplat.tools.workflow.inputs import LoadedScene, read_any, scoring_cameras
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_edits import SceneEdits, edit_options
from cogsplat.tools.workflow.scene_output import (
    COGS_NAME,
    OUTPUT_FORMATS,
    WrittenScene,
    output_format,
    require_cogs_for_cameras,
    write_any,
)

_SEPARATORS: Final = tuple(separator for separator in (os.sep, os.altsep) if separator)


class _FileOrFolder(OutputPath):
    """Parameter type of an output path; a folder becomes the path of its manifest."""

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """Return the path of a file, or of the manifest of a folder.

        A path names a folder if it ends in a separator, is an existing folder, or ends in the
        suffix of manifests.
        """
        text = os.fspath(value)
        names_manifest = text.lower().endswith(MANIFEST_SUFFIX)
        if is_url(value):
            if names_manifest or text.endswith("/"):
                self.fail(f"{text}: a folder on a network, expected `cogsplat upload`", param, ctx)
            return super().convert(value, param, ctx)
        if text.endswith(_SEPARATORS) or is_folder(text):
            return Path(text) / MANIFEST_NAME
        if names_manifest:
            try:
                check_manifest_name(Path(text).name)
            except ValueError as error:
                self.fail(str(error), param, ctx)
        return super().convert(value, param, ctx)


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat convert scene.ply scene.spz\n"
    "  cogsplat convert scene.spz upright.sog --rotate 180,0,0 --sh 1\n"
    "  cogsplat convert scene.cogs folder/\n"
    "  cogsplat convert folder/ scene.cogs"
)
@click.argument("source", type=INPUT, metavar="IN")
@click.argument("out", type=_FileOrFolder(), metavar="OUT")
@writing_options(OUTPUT_FORMATS, "Without it, OUT's extension names the format.")
@edit_options
@cameras_option(
    "For COGS output and --bake-kernel. Without it, views are planned around the scene."
)
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

    OUT's extension names the format. Values that it cannot hold are named in a warning.

    OUT/ with a slash, an existing folder, and OUT/NAME.cogsm name a COGS folder: a manifest, and
    segments named by their content, for hosts without byte ranges. Existing segments are kept;
    manifests in one folder share segments.

    From COGS to COGS, without edits and --cameras, segments are copied, not encoded again: a
    folder becomes the file that it was made from, byte by byte. `encode` has all options of
    encoding.
    """
    to_folder = out.name.lower().endswith(MANIFEST_SUFFIX)
    if to_folder and writing.format_name not in (None, COGS_NAME):
        raise click.UsageError(f"--format {writing.format_name} with {out}, expected a file")
    name = COGS_NAME if to_folder else output_format(out, writing)
    require_cogs_for_cameras(cameras, out, name, baked=writing.bake_kernel)
    copied = (
        name == COGS_NAME
        and is_cogs(source)
        and not edits.changes
        and cameras is None
        and writing.extras
    )
    if not to_folder or is_folder(out.parent):
        check_outputs(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        if copied:
            done = _copy(source, out, to_folder=to_folder, force=force, stages=stages)
        else:
            with stages.stage("read"):
                views = scoring_cameras(cameras, 0)
                given = read_any(source, threads=threads, progress=stages)
            with stages.stage("edit"):
                splats = edits.apply(given.splats, source)
            done = _write(
                given,
                splats,
                out,
                name,
                to_folder=to_folder,
                cameras=None if views is None else [edits.camera(view) for view in views],
                writing=writing,
                notes=notes_of(source, edits),
                threads=threads,
                force=force,
                stages=stages,
            )
    if as_json:
        print_json({**_report(done, source, out), "seconds": stages.rounded_seconds()})
    elif not quiet:
        _print_summary(done, out, stages)


@dataclass(frozen=True)
class _Conversion:
    """Facts about a scene that was read and the file or folder that was written.

    Parameters
    ----------
    written : WrittenScene
        Format, size and number of splats of the output.
    source_bytes, source_splats : int
        Size of the source, bytes, and its number of splats.
    edited_splats : int
        Number of splats after the edits.
    sh_degree : int
        SH degree after the edits.
    unpacked : Unpacked or None
        Objects that were written into a folder; None for a file.
    """

    written: WrittenScene
    source_bytes: int
    source_splats: int
    edited_splats: int
    sh_degree: int
    unpacked: Unpacked | None = None


def _copy(source: Path, out: Path, *, to_folder: bool, force: bool, stages: Stages) -> _Conversion:
    """Copy the segments of a COGS file or folder into a file or folder."""
    with cogsplat.open(source, partial=partial_accepted(), limits=current_limits()) as file:
        unpacked = None
        if to_folder:
            unpacked = unpack_cogs(file, out.parent, name=out.name, force=force, progress=stages)
            size = unpacked.manifest_bytes
        else:
            size = pack_cogs(file, out, force=force, progress=stages)
        splats = file.root.splats
        return _Conversion(
            WrittenScene(COGS_NAME, size, splats),
            file.file_length,
            splats,
            splats,
            file.root.sh_degree,
            unpacked,
        )


def _write(
    given: LoadedScene,
    splats: Splats,
    out: Path,
    name: str,
    *,
    to_folder: bool,
    cameras: Sequence[Camera] | None,
    writing: SceneWriting,
    notes: SceneNotes,
    threads: int,
    force: bool,
    stages: Stages,
) -> _Conversion:
    """Write an edited scene as a file, or encode it into a folder."""
    if not to_folder:
        written = write_any(
            splats,
            out,
            name,
            force=force,
            cameras=cameras,
            threads=threads,
            stages=stages,
            writing=writing,
            notes=notes,
        )
        return _Conversion(
            written, given.file_bytes, given.file_splats, len(splats), splats.sh_degree
        )
    with scratch_folder() as folder:
        path = folder / "scene.cogs"
        encoded = write_any(
            splats,
            path,
            name,
            force=False,
            cameras=cameras,
            threads=threads,
            stages=stages,
            writing=writing,
            notes=notes,
        )
        with storage_errors(path), cogsplat.open(path) as file:
            unpacked = unpack_cogs(file, out.parent, name=out.name, force=force, progress=stages)
    return _Conversion(
        WrittenScene(name, unpacked.manifest_bytes, encoded.splats),
        given.file_bytes,
        given.file_splats,
        len(splats),
        splats.sh_degree,
        unpacked,
    )


def _report(done: _Conversion, source: Path, out: Path) -> dict[str, object]:
    """Return the JSON object of a conversion."""
    report = {
        **done.written.report(out),
        "source_splats": done.source_splats,
        "splats_edited_out": done.source_splats - done.edited_splats,
        "sh_degree": done.sh_degree,
        "source": display_name(source),
        "source_bytes": done.source_bytes,
    }
    if done.unpacked is not None:
        report["segments"] = done.unpacked.segments
        report["objects_written"] = done.unpacked.written
        report["object_bytes_written"] = done.unpacked.written_bytes
        report["objects_shared"] = done.unpacked.shared
    return report


def _print_summary(done: _Conversion, out: Path, stages: Stages) -> None:
    """Print the summary of the conversion."""
    stored, given = done.written.splats, done.source_splats
    print_line(f"{done.written.line(out)}, from {size_text(done.source_bytes)}")
    count = f"{stored:,}" if stored == given else f"{stored:,} of {given:,}"
    unpacked = done.unpacked
    if unpacked is None:
        count += f", {done.written.size_bytes / max(stored, 1):.2f} B each"
        objects = ""
    else:
        objects = (
            f"{count_text(unpacked.written, 'object')} written, "
            f"{size_text(unpacked.written_bytes)}; {unpacked.shared:,} there already"
        )
    print_facts(
        ("splats", count),
        ("segments", objects),
        ("SH degree", str(done.sh_degree)),
        ("time", stages.summary()),
    )
