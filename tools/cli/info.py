"""``cogsplat info``: what a file holds, and statistics of its values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.segments.attributes import AttributeType, attribute_types
from cogsplat.codec.splats import SceneInfo, Splats, sh_coefficients
from cogsplat.codec.views.view_text import view_text
from cogsplat.formats.cogs.description_json import to_json
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.registry import format_of
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.evaluation.byte_inventory import (
    ChunkSizes,
    StoredSize,
    chunk_sizes,
    format_version,
    stored_sizes,
)
from cogsplat.tools.evaluation.scene_statistics import statistics as scene_statistics
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import (
    json_option,
    part_options,
    quiet_option,
    threads_option,
)
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
    print_table,
    size_text,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT_BY_RANGES, unfetched_url
from cogsplat.tools.terminal.values import ChunkRange
from cogsplat.tools.workflow.byte_table import print_byte_table
from cogsplat.tools.workflow.description_facts import description_facts
from cogsplat.tools.workflow.inputs import (
    LoadedScene,
    Selection,
    input_source,
    is_cogs_input,
    read_any,
)
from cogsplat.tools.workflow.statistics_table import print_statistics, statistics_report

# Rows of the table of chunks at most; a longer table shows its first and last rows, because most
# chunks of a large scene are alike.
_MOST_ROWS: Final = 40
_FIRST_ROWS, _LAST_ROWS = 24, 8

_ATTRIBUTES: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat info scene.cogs\n"
    "  cogsplat info scene.cogs --json | jq .attributes\n"
    "  cogsplat info scene.cogs --statistics --bytes 20%"
)
@click.argument("path", type=INPUT_BY_RANGES, metavar="SCENE")
@click.option("--all", "all_chunks", is_flag=True, help="List every chunk of a long table.")
@click.option(
    "--statistics",
    is_flag=True,
    help="Also read the splats and show statistics of their values. The options on parts of a file "
    "select what is read.",
)
@part_options
@partial_option
@limits_option
@threads_option
@quiet_option
@json_option
def info(
    path: Path,
    all_chunks: bool,
    statistics: bool,
    chunks: ChunkRange | None,
    least_splats: int | None,
    size: ByteCount | None,
    objects: tuple[int, ...] | None,
    sh_degree: int | None,
    threads: int,
    quiet: bool,
    as_json: bool,
) -> None:
    """Show what a scene file holds.

    For COGS: root, codebooks, chunks, bytes per attribute. For a COGS file on a network, only the
    index is read, which has the bytes per kind of segment. For other formats: splats, SH degree and
    the range of each attribute.

    --statistics adds, per attribute, the range, mean, deviation, a histogram from the 0.5 % to the
    99.5 % quantile, and the count of values that are not finite. Scales are natural logarithms and
    opacities logits; linear scales and unit opacities follow. The fill ratio estimates the number
    of splats that a ray crosses: their total one-sigma area over the mean face area of the box.
    """
    part = Selection(chunks, least_splats, size, sh_degree, objects)
    if part != Selection() and not statistics:
        raise click.UsageError("a part of the file without --statistics, expected both")
    with Stages(shown=statistics and not (quiet or as_json)) as stages:
        is_cogs = is_cogs_input(path)
        scene = None
        if statistics or not is_cogs:
            scene = read_any(path, part, threads=threads, progress=stages)
            stages("read", 1, 1)
        report = _cogs_info(path, all_chunks, as_json) if is_cogs else None
        if report is None:
            assert scene is not None
            report = _scene_info(path, scene, as_json)
        if statistics:
            assert scene is not None
            found = scene_statistics(scene.splats, stages)
            report["statistics"] = statistics_report(found)
            report["seconds"] = stages.rounded_seconds()
            if not as_json:
                print_statistics(found, scene.file_splats)
    if as_json:
        print_json(report)
    elif statistics and not quiet:
        print_line("")
        print_facts(("time", stages.summary()))


def _cogs_info(path: Path, all_chunks: bool, as_json: bool) -> dict[str, object]:
    """Return the contents of a COGS file as a JSON object; also print text unless `as_json`."""
    with cogsplat.open(
        input_source(path), partial=partial_accepted(), limits=current_limits()
    ) as file:
        # Over a network, the index alone is read; streams are listed inside the segments.
        sizes = stored_sizes(file, by_stream=unfetched_url(path) is None)
        version = format_version(file)
        row = file.camera_row
        cameras = len(file.cameras()) if row is None or file.is_present(row) else None
        row = file.view_table_rows.get(())
        view_table = file.view_table() if row is None or file.is_present(row) else None
        viewpoints = None if row is not None else 0
        row_of_table = row
        row = file.description_row
        is_described = row is not None and file.is_present(row)
        description = file.description() if is_described else None
        if view_table is not None:
            viewpoints = len(view_table.positions)
    if not as_json:
        _print_root(path, version, file, cameras)
        if row_of_table is not None:
            length = size_text(int(file.segments.length[row_of_table]))
            there = "not there" if viewpoints is None else count_text(viewpoints, "viewpoint")
            print_facts(("view table", f"{there}, {length}"))
        if description is not None:
            print_facts(*description_facts(description))
        _print_chunks(chunk_sizes(file), all_chunks=all_chunks)
        print_byte_table(sizes, file)
    return {
        **_cogs_report(path, version, file, sizes, cameras),
        "viewpoints": viewpoints,
        "description": None if description is None else to_json(description),
    }


def _scene_info(path: Path, scene: LoadedScene, as_json: bool) -> dict[str, object]:
    """Return the contents of a foreign scene as a JSON object; also print text unless `as_json`."""
    if not as_json:
        _print_scene(path, scene.splats, scene.file_bytes)
    return _scene_report(path, scene.splats, scene.file_bytes)


def _decoded_bytes(file: CogsFile) -> int:
    """Return the total size of a decoded file in memory, bytes."""
    return 4 * (14 + 3 * (sh_coefficients(file.root.sh_degree) - 1)) * file.root.splats


def _cogs_report(
    path: Path, version: str, file: CogsFile, sizes: list[StoredSize], cameras: int | None
) -> dict[str, object]:
    """Return the JSON object of a COGS file."""
    root = file.root
    view = root.first_view
    return {
        "source": display_name(path),
        "format": "cogs",
        "version": version,
        "writer": root.writer,
        "bytes": file.file_length,
        "bytes_read": file.source_bytes,
        "chunks_complete": file.complete_chunks(),
        "splats": root.splats,
        "sh_degree": root.sh_degree,
        "decoded_bytes": _decoded_bytes(file),
        "box": root.box.tolist(),
        "origin": list(root.info.origin),
        "axes": root.info.axes,
        "colour_space": root.info.colour_space,
        "kernel_px": root.info.kernel_px,
        "antialiased": root.info.antialiased,
        "capture": [list(viewpoint) for viewpoint in root.info.capture],
        "first_view": None
        if view is None
        else {
            "width": view.width,
            "height": view.height,
            "fx": view.fx,
            "fy": view.fy,
            "cx": view.cx,
            "cy": view.cy,
            "rotation": view.rotation.tolist(),
            "translation": view.translation.tolist(),
            "target": None if view.target is None else view.target.tolist(),
            "text": None if view.target is None else view_text(view, root.upward),
        },
        "up": None if root.up is None else root.up.tolist(),
        "core_box": None if root.core_box is None else root.core_box.tolist(),
        "codebooks": [{"attribute": book.attribute, "rows": book.rows} for book in root.codebooks],
        "extras": [
            {"name": kind.name, "type": kind.dtype, "components": kind.components}
            for kind in root.attributes
        ],
        "stored_cameras": cameras,
        "levels": [{"chunks": level.chunks, "scale": level.scale} for level in root.levels],
        "index_pages": len(file.page_bytes),
        "segments": len(file.segments),
        "chunks": file.num_chunks,
        "chunk_table": [chunk.report() for chunk in chunk_sizes(file)],
        "attributes": [size.report() for size in sizes],
    }


def _print_root(path: Path, version: str, file: CogsFile, cameras: int | None) -> None:
    """Print the root of a COGS file."""
    root, view = file.root, file.root.first_view
    pages = len(file.page_bytes)
    print_line(f"{path}: COGS {version}, {size_text(file.file_length)}, by {root.writer}")
    each = file.file_length / max(root.splats, 1)
    books = [f"{book.attribute} {book.rows:,}" for book in root.codebooks]
    low, high = root.box[:3], root.box[3:]
    axes = ", ".join(
        f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    smoothing = "antialiased" if root.info.antialiased else "not antialiased"
    print_facts(
        ("there", _received(file)),
        ("splats", f"{root.splats:,} at SH degree {root.sh_degree}, {each:.2f} B each"),
        ("decoded", size_text(_decoded_bytes(file))),
        ("box", axes),
        ("origin", _origin(root.info)),
        ("frame", f"axes {root.info.axes}, colour {root.info.colour_space}"),
        ("kernel", f"{root.info.kernel_px:g} px², {smoothing}"),
        ("trained at", _trained_at(root.info)),
        (
            "first view",
            f"{view.width}x{view.height} px at {_numbers(view.position)}" if view else "none",
        ),
        ("up", _numbers(root.upward)),
        ("cameras", "not there" if cameras is None else f"{cameras:,} stored" if cameras else ""),
        ("codebooks", f"{', '.join(books)} rows" if books else "none"),
        ("attributes", _attributes_text(root.attributes)),
        ("levels", _levels_text(file)),
        ("prefixes", _prefix_chunks(file)),
        ("index", f"{count_text(pages, 'page')} beside the root" if pages else ""),
    )


def _received(file: CogsFile) -> str:
    """Return the received bytes and complete chunks as text; empty for a whole file."""
    if file.source_bytes == file.file_length:
        return ""
    share = f"{size_text(file.source_bytes)} of {size_text(file.file_length)}"
    return f"{share}, {file.complete_chunks()} of {count_text(file.num_chunks, 'chunk')} complete"


def _levels_text(file: CogsFile) -> str:
    """Return picture scale and number of chunks of each level: ``1/8 of 12 chunks``."""
    levels = file.root.levels
    return ", ".join(
        f"1/{level.scale:g} of {count_text(level.chunks, 'chunk')}" for level in levels
    )


def _prefix_chunks(file: CogsFile) -> str:
    """Return as text the counts of chunks and splats that only prefixes draw; empty for none."""
    ending = file.chunks.until > 0
    if not ending.any():
        return ""
    splats = count_text(int(file.chunks.splats[ending].sum()), "splat")
    return f"{count_text(int(ending.sum()), 'chunk')} of {splats}, drawn in prefixes only"


def _attributes_text(types: Sequence[AttributeType]) -> str:
    """Return extra attributes and their types as text, such as ``label u2, normal f4x3``."""
    return ", ".join(
        f"{kind.name} {kind.dtype}" + (f"x{kind.components}" if kind.components else "")
        for kind in types
    )


def _print_chunks(chunks: list[ChunkSizes], *, all_chunks: bool) -> None:
    """Print the table of chunks, cut in the middle unless `all_chunks`."""
    if not chunks:
        return
    rows = [
        (
            str(chunk.number),
            f"{chunk.splats:,}",
            f"{chunk.head_bytes:,}",
            f"{chunk.refinement_bytes:,}" if chunk.refinement_bytes else "-",
            f"{chunk.tail_bytes:,}" if chunk.tail_bytes else "-",
            f"{chunk.head_offset:,}",
            f"{chunk.share_of_contribution:.2%}"
            if chunk.share_of_contribution is not None
            else "-",
            f"{chunk.share_so_far:.2%}" if chunk.share_so_far is not None else "-",
            f"{chunk.object_label}",
            f"{chunk.cell}",
        )
        for chunk in chunks
    ]
    hidden = len(rows) - _FIRST_ROWS - _LAST_ROWS
    if len(rows) > _MOST_ROWS and not all_chunks:
        gap = ("", f"{hidden:,} more", "--all", "lists", "them", "", "", "", "", "")
        rows = [*rows[:_FIRST_ROWS], gap, *rows[-_LAST_ROWS:]]
    heads = (
        "chunk",
        "splats",
        "head B",
        "finer B",
        "tail B",
        "head at",
        "contribution",
        "so far",
        "object",
        "cell",
    )
    # Columns without any value are left out.
    left_out = {
        name
        for name, shown in (
            ("object", any(chunk.object_label for chunk in chunks)),
            ("cell", any(chunk.cell for chunk in chunks)),
        )
        if not shown
    }
    columns = [column for column, name in enumerate(heads) if name not in left_out]
    print_line("")
    shown_rows = [tuple(row[column] for column in columns) for row in rows]
    print_table([heads[column] for column in columns], shown_rows, left=0)


def _ranges(splats: Splats) -> dict[str, tuple[float, float, int]]:
    """Return minimum and maximum of each array's finite values, and the count of the rest."""
    ranges: dict[str, tuple[float, float, int]] = {}
    for name in _ATTRIBUTES:
        values: NDArray[np.float32] = getattr(splats, name)
        finite = values[np.isfinite(values)]
        if finite.size:
            odd = values.size - finite.size
            ranges[name] = (float(finite.min()), float(finite.max()), odd)
    return ranges


def _scene_report(path: Path, splats: Splats, file_bytes: int) -> dict[str, object]:
    """Return the JSON object of a scene of another format."""
    return {
        "source": display_name(path),
        "format": format_of(path).name,
        "bytes": file_bytes,
        "splats": len(splats),
        "sh_degree": splats.sh_degree,
        "invalid_splats": int(splats.invalid_rows().sum()),
        "origin": list(splats.info.origin),
        "axes": splats.info.axes,
        "colour_space": splats.info.colour_space,
        "kernel_px": splats.info.kernel_px,
        "antialiased": splats.info.antialiased,
        "capture": [list(viewpoint) for viewpoint in splats.info.capture],
        "extras": [
            {"name": kind.name, "type": kind.dtype, "components": kind.components}
            for kind in attribute_types(splats.extras)
        ],
        "ranges": {
            name: {"min": low, "max": high, "not_finite": odd}
            for name, (low, high, odd) in _ranges(splats).items()
        },
    }


def _print_scene(path: Path, splats: Splats, file_bytes: int) -> None:
    """Print the contents of a scene of another format."""
    name = format_of(path).name
    print_line(
        f"{path}: {name}, {count_text(len(splats), 'splat')} at SH degree {splats.sh_degree}"
    )
    invalid = int(splats.invalid_rows().sum())
    print_facts(
        ("bytes", f"{size_text(file_bytes)}, {file_bytes / max(len(splats), 1):.2f} B each"),
        ("invalid", f"{count_text(invalid, 'splat')}; encode --drop-invalid leaves them out")
        if invalid
        else ("invalid", "none"),
        ("origin", _origin(splats.info)),
        ("attributes", _attributes_text(attribute_types(splats.extras))),
    )
    rows = [
        (name, f"{low:.4g}", f"{high:.4g}", f"{odd:,}" if odd else "-")
        for name, (low, high, odd) in _ranges(splats).items()
    ]
    if rows:
        print_line("")
        print_table(("attribute", "least", "largest", "not finite"), rows)


def _trained_at(info: SceneInfo) -> str:
    """Return the number of viewpoints of training and their focal lengths, as text."""
    if not info.capture:
        return "not known"
    least, most = (bound(focal for *_, focal in info.capture) for bound in (min, max))
    return f"{len(info.capture)} viewpoints, focal lengths of {least:.5g} to {most:.5g} px"


def _origin(info: SceneInfo) -> str:
    """Return an origin as text with 12 digits, for map coordinates; empty for zero."""
    if not any(info.origin):
        return ""
    return "(" + ", ".join(f"{value:.12g}" for value in info.origin) + ")"


def _numbers(values: tuple[float, ...] | NDArray[np.float64]) -> str:
    """Return numbers as text, 4 digits each."""
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
