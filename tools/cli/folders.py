"""``cogsplat unpack`` and ``cogsplat pack``: a file as a folder of objects, and back."""

from __future__ import annotations

from pathlib import Path

import click

import cogsplat
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME
from cogsplat.formats.cogs.folder_writer import check_manifest_name, pack_cogs, unpack_cogs
from cogsplat.formats.cogs.packing import folder_files
from cogsplat.formats.storage.atomic import check_output
from cogsplat.tools.terminal.limits import current_limits, limits_option
from cogsplat.tools.terminal.options import force_option, json_option, quiet_option
from cogsplat.tools.terminal.output import counted, name_of, say, say_json, size_text
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, PATH, OutputPath


def _manifest_name(
    context: click.Context, parameter: click.Parameter, value: str
) -> str:  # click's order of arguments
    try:
        check_manifest_name(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error
    return value


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat unpack scene.cogs scene\n"
    "  cogsplat unpack edited.cogs scene --name edited.cogsm"
)
@click.argument("source", type=INPUT, metavar="IN.cogs")
@click.argument("folder", type=PATH, metavar="FOLDER")
@click.option(
    "--name",
    default=MANIFEST_NAME,
    show_default=True,
    callback=_manifest_name,
    metavar="NAME.cogsm",
    help="Of the manifest; several in one folder are versions that share segments.",
)
@partial_option
@limits_option
@force_option
@quiet_option
@json_option
def unpack(source: Path, folder: Path, name: str, force: bool, quiet: bool, as_json: bool) -> None:
    """Write a COGS file as a folder: a manifest and its objects.

    For hosts without byte ranges, and for scenes of which new versions keep most segments. The
    segments of a chunk are one object. Objects are named by their content, so that they can be
    cached forever; those that are there already are kept. Every command reads such a folder as it
    reads the file.
    """
    with (
        Stages(shown=not (quiet or as_json)) as stages,
        cogsplat.open(source, partial=partial_accepted(), limits=current_limits()) as file,
    ):
        done = unpack_cogs(file, folder, name=name, force=force, progress=stages)
    if as_json:
        say_json(
            {
                "output": str(done.manifest),
                "source": name_of(source),
                "bytes": done.manifest_bytes,
                "segments": done.segments,
                "objects_written": done.written,
                "object_bytes_written": done.written_bytes,
                "objects_shared": done.shared,
                "seconds": stages.rounded(),
            }
        )
    elif not quiet:
        say(
            f"{done.manifest}: {size_text(done.manifest_bytes)}, "
            f"{counted(done.segments, 'segment')}; {counted(done.written, 'object')} written "
            f"({size_text(done.written_bytes)}), {done.shared:,} there already"
        )


@click.command(epilog="\b\nExample:\n  cogsplat pack scene scene.cogs")
@click.argument("source", type=INPUT, metavar="FOLDER")
@click.argument("out", type=OutputPath(".cogs"), metavar="OUT.cogs")
@partial_option
@limits_option
@force_option
@quiet_option
@json_option
def pack(source: Path, out: Path, force: bool, quiet: bool, as_json: bool) -> None:
    """Write a folder, or one of its manifests, as one COGS file.

    The file is the one that was unpacked, byte for byte. Every segment is checked against its
    CRC and its hash. With --partial, the file ends before the first segment that is missing.
    """
    check_output(out, force=force, inputs=folder_files(source))
    with (
        Stages(shown=not (quiet or as_json)) as stages,
        cogsplat.open(source, partial=partial_accepted(), limits=current_limits()) as file,
    ):
        size = pack_cogs(file, out, force=force, progress=stages)
        segments = len(file.segments)
    if as_json:
        say_json(
            {
                "output": name_of(out),
                "source": name_of(source),
                "bytes": size,
                "segments": segments,
                "seconds": stages.rounded(),
            }
        )
    elif not quiet:
        say(f"{name_of(out)}: {size_text(size)}, {counted(segments, 'segment')}")
