"""``cogsplat info``: the contents of a file, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.segments.attributes import AttributeType, types_of
from cogsplat.codec.segments.view_table import ViewTable
from cogsplat.codec.splats import SceneInfo, Splats, sh_coefficients
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.registry import format_of
from cogsplat.tools.evaluation.byte_inventory import (
    ChunkSizes,
    StoredSize,
    chunk_sizes,
    format_version,
    stored_sizes,
)
from cogsplat.tools.terminal.limits import current_limits, limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import counted, facts, name_of, say, say_json, size_text, table
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT_BY_RANGES, url_of

from .inputs import input_source, is_cogs_input, read_any

# A longer table is cut in the middle: most chunks of a large scene look alike.
_MOST_ROWS: Final = 40
_FIRST_ROWS, _LAST_ROWS = 24, 8

_ATTRIBUTES: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat info scene.cogs\n"
    "  cogsplat info scene.cogs --json | jq .attributes"
)
@click.argument("path", type=INPUT_BY_RANGES, metavar="IN")
@click.option("--verify", is_flag=True, help="Check every hash and decode every chunk of it.")
@click.option("--all", "all_chunks", is_flag=True, help="List every chunk, however many.")
@partial_option
@limits_option
@quiet_option
@json_option
def info(path: Path, verify: bool, all_chunks: bool, quiet: bool, as_json: bool) -> None:
    """Show the contents of a file.

    Of a COGS file the root, codebooks, chunks and bytes per attribute; of a scene in another format
    splats, SH degree and ranges. Of a COGS file given by its URL, the index alone is read, which
    says how many bytes each kind of segment takes, not each attribute.
    """
    if verify and partial_accepted():
        raise click.UsageError("--verify and --partial: expected one of them")
    if not is_cogs_input(path):
        if verify:
            raise click.UsageError(f"{path}: is no COGS file, expected one with --verify")
        scene = read_any(path)
        report = _scene_report(path, scene.splats, scene.file_bytes)
        if as_json:
            say_json(report)
        else:
            _tell_scene(path, scene.splats, scene.file_bytes)
        return
    with (
        cogsplat.open(
            input_source(path), partial=partial_accepted(), limits=current_limits()
        ) as file,
        Stages(shown=verify and not (quiet or as_json)) as stages,
    ):
        if verify:
            file.verify(stages)
        # Over a network, the index says enough.
        sizes = stored_sizes(file, by_stream=verify or url_of(path) is None)
        version = format_version(file)
        row = file.camera_row
        cameras = len(file.cameras()) if row is None or file.is_present(row) else None
        row = file.view_table_row
        table = file.view_table() if row is not None and file.is_present(row) else None
        viewpoints = None if table is None and row is not None else _viewpoints(table)
    if as_json:
        report = _cogs_report(path, version, file, sizes, cameras)
        say_json({**report, "viewpoints": viewpoints, "verified": verify})
        return
    _tell_root(path, version, file, cameras)
    if file.view_table_row is not None:
        size = size_text(int(file.segments.length[file.view_table_row]))
        there = "not there" if viewpoints is None else counted(viewpoints, "viewpoint")
        facts(("view table", f"{there}, {size}"))
    if verify:
        facts(("verified", f"{counted(len(file.segments), 'segment')}, all chunks decoded"))
    _tell_chunks(chunk_sizes(file), all_chunks=all_chunks)
    tell_attributes(sizes, file)


def _viewpoints(table: ViewTable | None) -> int:
    """Return how many viewpoints a view table has, 0 without a table."""
    return 0 if table is None else len(table.positions)


def _decoded_bytes(file: CogsFile) -> int:
    return 4 * (14 + 3 * (sh_coefficients(file.root.sh_degree) - 1)) * file.root.splats


def _cogs_report(
    path: Path, version: str, file: CogsFile, sizes: list[StoredSize], cameras: int | None
) -> dict[str, object]:
    root = file.root
    view = root.first_view
    return {
        "source": name_of(path),
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
        },
        "codebooks": [{"attribute": book.attribute, "rows": book.rows} for book in root.codebooks],
        "extras": [
            {"name": kind.name, "type": kind.dtype, "components": kind.components}
            for kind in root.attributes
        ],
        "stored_cameras": cameras,
        "levels": [{"chunks": level.chunks, "scale": level.scale} for level in root.levels],
        "index_pages": len(root.pages),
        "segments": len(file.segments),
        "chunks": file.num_chunks,
        "chunk_table": [chunk.report() for chunk in chunk_sizes(file)],
        "attributes": [size.report() for size in sizes],
    }


def _tell_root(path: Path, version: str, file: CogsFile, cameras: int | None) -> None:
    root, view = file.root, file.root.first_view
    say(f"{path}: COGS {version}, {size_text(file.file_length)}, by {root.writer}")
    each = file.file_length / max(root.splats, 1)
    books = [f"{book.attribute} {book.rows:,}" for book in root.codebooks]
    low, high = root.box[:3], root.box[3:]
    axes = ", ".join(
        f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    smoothing = "antialiased" if root.info.antialiased else "not antialiased"
    facts(
        ("there", _received(file)),
        ("splats", f"{root.splats:,} at SH degree {root.sh_degree}, {each:.2f} B each"),
        ("decoded", size_text(_decoded_bytes(file))),
        ("box", axes),
        ("origin", _origin(root.info)),
        ("frame", f"axes {root.info.axes}, colour {root.info.colour_space}"),
        ("kernel", f"{root.info.kernel_px:g} px², {smoothing}"),
        (
            "first view",
            f"{view.width}x{view.height} px at {_numbers(view.position)}" if view else "none",
        ),
        ("cameras", "not there" if cameras is None else f"{cameras:,} stored" if cameras else ""),
        ("codebooks", f"{', '.join(books)} rows" if books else "none"),
        ("attributes", _kinds(root.attributes)),
        ("levels", _levels(file)),
        ("ends", _ends(file)),
        ("index", f"{counted(len(root.pages), 'page')} beside the root" if root.pages else ""),
    )


def _received(file: CogsFile) -> str:
    """Return what of a file has arrived, nothing where all of it has."""
    if file.source_bytes == file.file_length:
        return ""
    share = f"{size_text(file.source_bytes)} of {size_text(file.file_length)}"
    return f"{share}, {file.complete_chunks()} of {counted(file.num_chunks, 'chunk')} complete"


def _levels(file: CogsFile) -> str:
    """Return the levels with their sizes, such as ``1/8 of 12 chunks, 1/1 of 30 chunks``."""
    levels = file.root.levels
    return ", ".join(f"1/{level.scale:g} of {counted(level.chunks, 'chunk')}" for level in levels)


def _ends(file: CogsFile) -> str:
    """Return how many chunks and splats are for the beginning of the file only."""
    ending = file.chunks.until > 0
    if not ending.any():
        return ""
    splats = counted(int(file.chunks.splats[ending].sum()), "splat")
    return f"{counted(int(ending.sum()), 'chunk')} of {splats}, which the whole file does not draw"


def _kinds(types: Sequence[AttributeType]) -> str:
    """Return extra attributes with their types, such as ``label u2, normal f4x3``."""
    return ", ".join(
        f"{kind.name} {kind.dtype}" + (f"x{kind.components}" if kind.components else "")
        for kind in types
    )


def _tell_chunks(chunks: list[ChunkSizes], *, all_chunks: bool) -> None:
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
    # Most scenes have neither objects nor cells.
    left_out = {
        name
        for name, shown in (
            ("object", any(chunk.object_label for chunk in chunks)),
            ("cell", any(chunk.cell for chunk in chunks)),
        )
        if not shown
    }
    columns = [column for column, name in enumerate(heads) if name not in left_out]
    say("")
    shown_rows = [tuple(row[column] for column in columns) for row in rows]
    table([heads[column] for column in columns], shown_rows, left=0)


def tell_attributes(sizes: list[StoredSize], file: CogsFile) -> None:
    """Print the bytes of every kind of stream."""
    rows = [
        (
            size.segment,
            size.label,
            f"{size.stored_bytes:,}",
            f"{size.stored_bytes / file.file_length:.1%}",
            f"{8 * size.stored_bytes / max(file.root.splats, 1):.2f}",
        )
        for size in sizes
    ]
    total = sum(size.stored_bytes for size in sizes)
    each = f"{8 * total / max(file.root.splats, 1):.2f}"
    rows.append(("", "total", f"{total:,}", f"{total / file.file_length:.1%}", each))
    say("")
    table(("segment", "stream", "bytes", "share", "bits/splat"), rows, left=2)


def _ranges(splats: Splats) -> dict[str, tuple[float, float, int]]:
    """Return the range of the finite values of each array, and the count of the others."""
    ranges: dict[str, tuple[float, float, int]] = {}
    for name in _ATTRIBUTES:
        values: NDArray[np.float32] = getattr(splats, name)
        finite = values[np.isfinite(values)]
        if finite.size:
            odd = values.size - finite.size
            ranges[name] = (float(finite.min()), float(finite.max()), odd)
    return ranges


def _scene_report(path: Path, splats: Splats, file_bytes: int) -> dict[str, object]:
    return {
        "source": name_of(path),
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
        "extras": [
            {"name": kind.name, "type": kind.dtype, "components": kind.components}
            for kind in types_of(splats.extras)
        ],
        "ranges": {
            name: {"min": low, "max": high, "not_finite": odd}
            for name, (low, high, odd) in _ranges(splats).items()
        },
    }


def _tell_scene(path: Path, splats: Splats, file_bytes: int) -> None:
    name = format_of(path).name
    say(f"{path}: {name}, {counted(len(splats), 'splat')} at SH degree {splats.sh_degree}")
    invalid = int(splats.invalid_rows().sum())
    facts(
        ("bytes", f"{size_text(file_bytes)}, {file_bytes / max(len(splats), 1):.2f} B each"),
        ("invalid", f"{counted(invalid, 'splat')}; encode --drop-invalid leaves them out")
        if invalid
        else ("invalid", "none"),
        ("origin", _origin(splats.info)),
        ("attributes", _kinds(types_of(splats.extras))),
    )
    rows = [
        (name, f"{low:.4g}", f"{high:.4g}", f"{odd:,}" if odd else "-")
        for name, (low, high, odd) in _ranges(splats).items()
    ]
    if rows:
        say("")
        table(("attribute", "least", "largest", "not finite"), rows)


def _origin(info: SceneInfo) -> str:
    """Return an origin in full, nothing where it is at zero: on maps, every digit counts."""
    if not any(info.origin):
        return ""
    return "(" + ", ".join(f"{value:.12g}" for value in info.origin) + ")"


def _numbers(values: tuple[float, ...] | NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
