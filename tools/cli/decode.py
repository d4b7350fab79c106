"""``cogsplat decode``: a COGS file, or a part of it, to a scene of another format."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import click

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.progress import Progress
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.ply.ply_scene import write_ply, write_ply_parts
from cogsplat.formats.scenes.registry import WRITABLE
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import (
    compensate_option,
    force_option,
    json_option,
    part_options,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.output_names import scene_format, written_bytes
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting, writing_options
from cogsplat.tools.terminal.standard_streams import INPUT_BY_RANGES, OutputPath
from cogsplat.tools.terminal.values import ChunkRange, FiniteNumber
from cogsplat.tools.workflow.inputs import LoadedScene, Selection, decode_part, decode_part_with
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_output import write_any


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat decode scene.cogs scene.ply\n"
    "  cogsplat decode scene.cogs preview.ply --bytes 20% --sh 0\n"
    "  cogsplat decode scene.cogs vase.ply --object 3"
)
@click.argument("cogs", type=INPUT_BY_RANGES, metavar="IN.cogs")
@click.argument("out", type=OutputPath(".ply"), metavar="OUT.ply")
@part_options
@compensate_option
@click.option(
    "--level",
    type=FiniteNumber(min=0),
    metavar="L",
    help="Level of a scene with levels, 0 the coarsest; 1.5 lies halfway between 1 and 2.",
)
@writing_options(WRITABLE, "Without it, the extension of OUT names the format.")
@click.option(
    "--no-refine", is_flag=True, help="Decode the coarse values of the heads without refinements."
)
@partial_option
@limits_option
@threads_option
@force_option
@quiet_option
@json_option
def decode(
    cogs: Path,
    out: Path,
    chunks: ChunkRange | None,
    least_splats: int | None,
    size: ByteCount | None,
    objects: tuple[int, ...] | None,
    sh_degree: int | None,
    compensate: bool,
    level: float | None,
    writing: SceneWriting,
    no_refine: bool,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Decode a COGS file, or a part of it, to a PLY.

    OUT's extension may name another format. --bytes decodes the complete chunks of a prefix of the
    file. --compensate enlarges the splats of a prefix and raises their opacities in place of the
    missing splats.
    """
    format_ = scene_format(out, writing.format_name)
    writing.require(out, format_.name)
    check_outputs(out, force=force)
    refine = not no_refine
    part = Selection(
        chunks, least_splats, size, sh_degree, objects, refine, compensate, writing.extras, level
    )
    with Stages(shown=not (quiet or as_json)) as stages:
        if format_.name == "ply" and not (compensate or writing.bake_kernel) and level is None:
            scene, decoded = _decode_into_ply(
                cogs, part, out, absolute=writing.absolute, force=force, threads=threads, to=stages
            )
            size_bytes = written_bytes(out, format_)
        else:
            scene = decode_part(cogs, part, threads=threads, progress=stages)
            decoded = len(scene.splats)
            size_bytes = write_any(
                scene.splats,
                out,
                format_.name,
                force=force,
                cameras=None,
                threads=threads,
                stages=stages,
                writing=writing,
            ).size_bytes
    if scene.without_tails:
        first, last = scene.without_tails[0], scene.without_tails[-1]
        span = f"chunk {first}" if first == last else f"chunks {first} to {last}"
        warnings.warn(
            f"{cogs}: {span} decoded without the SH above DC, which lies beyond byte "
            f"{scene.bytes_read}",
            CogsplatWarning,
            stacklevel=1,
        )
    if scene.lost_extras:
        warnings.warn(
            f"{cogs}: decoded without the attributes {', '.join(scene.lost_extras)}, which some "
            "chunks lack",
            CogsplatWarning,
            stacklevel=1,
        )
    if as_json:
        print_json(_report(cogs, scene, decoded, out, size_bytes, stages))
    elif not quiet:
        _print_summary(scene, decoded, out, size_bytes, stages)


def _decode_into_ply(
    cogs: Path,
    part: Selection,
    out: Path,
    *,
    absolute: bool,
    force: bool,
    threads: int,
    to: Progress,
) -> tuple[LoadedScene, int]:
    """Decode a part of a file into a PLY, a few chunks at a time.

    Returns
    -------
    scene : LoadedScene
        Facts about the file, without splats.
    rows : int
        Number of splats written.
    """
    rows = 0

    def stream(file: CogsFile, chunks: Sequence[int]) -> Splats:
        nonlocal rows
        rows = sum(int(file.chunks.splats[chunk]) for chunk in chunks)
        if not rows:
            nothing = file.decode(chunks, sh_degree=part.sh_degree, extras=part.extras)
            write_ply(nothing, out, force=force, absolute=absolute)
            return nothing
        parts = file.decode_parts(
            chunks,
            sh_degree=part.sh_degree,
            refine=part.refine,
            extras=part.extras,
            threads=threads,
            progress=to,
        )
        return write_ply_parts(parts, rows, out, force=force, absolute=absolute)

    return decode_part_with(stream, cogs, part), rows


def _report(
    source: Path, scene: LoadedScene, decoded: int, out: Path, written: int, stages: Stages
) -> dict[str, object]:
    """Return the JSON object of a decoded part."""
    return {
        "output": display_name(out),
        "source": display_name(source),
        "bytes": written,
        "splats": decoded,
        "source_splats": scene.file_splats,
        "sh_degree": scene.splats.sh_degree,
        "chunks": len(scene.chunks),
        "chunk_range": list(_chunk_range(scene.chunks)),
        "source_chunks": scene.file_chunks,
        "source_bytes": scene.file_bytes,
        "bytes_read": scene.bytes_read,
        "chunks_without_tails": list(scene.without_tails),
        "chunks_unrefined": list(scene.unrefined),
        "seconds": stages.rounded_seconds(),
    }


def _chunk_range(chunks: Sequence[int]) -> tuple[int, int]:
    """Return the half-open range of the chunks."""
    return (chunks[0], chunks[-1] + 1) if chunks else (0, 0)


def _print_summary(
    scene: LoadedScene, decoded: int, out: Path, written: int, stages: Stages
) -> None:
    """Print the summary of a decoded part."""
    first, last = _chunk_range(scene.chunks)
    print_line(f"{out}: {decoded:,} of {scene.file_splats:,} splats, {size_text(written)}")
    span = f"{first}:{last} of {scene.file_chunks}"
    if len(scene.chunks) < last - first:
        span = f"{len(scene.chunks)} in {span}"
    if scene.bytes_read < scene.file_bytes:
        span += f" in the first {size_text(scene.bytes_read)} of {size_text(scene.file_bytes)}"
    print_facts(
        ("chunks", span),
        ("SH degree", str(scene.splats.sh_degree)),
        ("time", stages.summary()),
    )
